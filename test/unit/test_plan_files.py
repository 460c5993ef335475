# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import csv
import json

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plan_files import check_path, load_plan, save_plan, to_json
from tdm_planner.problems.base import Solution
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Verification

FINITE = st.floats(allow_nan=False, allow_infinity=False)


def trajectory(values=((0.1, 2.0), (1 / 3, -1e-17), (3.0, 4.0))):
    return Trajectory(
        np.array([0.0, 0.1, 0.30000000000000004]),
        np.array(values),
        np.array([[1.0], [-1.0], [0.0]]),
        ('theta', 'psi'),
        ('torque',),
    )


def solution(trajectories, verifications=()):
    return Solution(
        'example', trajectories, 1.5, 0.0, np.zeros(2), 7, 0.01,
        Verification(True, np.zeros(2), {'torque': 0.1}, {'torque': 0.2}),
        dict(verifications),
    )  # fmt: skip


def test_json_keeps_every_bit(tmp_path):
    original = trajectory()
    save_plan(solution({'pendulum': original}).to_dict(), tmp_path / 'plan.json')
    plan = load_plan(tmp_path / 'plan.json')
    again = Trajectory.from_dict(plan)
    for name in ('times', 'states', 'controls'):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
    assert plan['interpolation'] == 'zero_order_hold'
    assert plan['verification']['worst'] == {'torque': 0.1}
    assert set(plan) >= {'problem', 'duration', 'cost', 'penalty', 'solve_time', 'evaluations'}


@given(st.lists(st.tuples(FINITE, FINITE), min_size=3, max_size=3))
@settings(deadline=None, max_examples=50, derandomize=True)
def test_any_finite_state_survives_json(values):
    plan = json.loads(to_json(solution({'pendulum': trajectory(values)}).to_dict()))
    np.testing.assert_array_equal(Trajectory.from_dict(plan).states, np.array(values))


def test_csv_and_npz_hold_the_same_samples(tmp_path):
    original = trajectory()
    plan = solution({'pendulum': original}).to_dict()
    save_plan(plan, tmp_path / 'plan.csv')
    save_plan(plan, tmp_path / 'plan.npz')
    rows = list(csv.reader((tmp_path / 'plan.csv').open()))
    assert rows[0] == ['time', 'theta', 'psi', 'torque']
    table = np.array(rows[1:], dtype=float)
    np.testing.assert_array_equal(table[:, 1:3], original.states)
    with np.load(tmp_path / 'plan.npz') as arrays:
        np.testing.assert_array_equal(arrays['times'], original.times)
        np.testing.assert_array_equal(arrays['theta'], original.states[:, 0])


def test_several_vehicles(tmp_path):
    both = {'a': trajectory(), 'b': trajectory()}
    checks = {name: Verification(True, np.zeros(2)) for name in both}
    plan = solution(both, checks).to_dict()
    assert set(plan['robots']) == {'a', 'b'}
    save_plan(plan, tmp_path / 'plan.csv')
    rows = list(csv.reader((tmp_path / 'plan.csv').open()))
    assert rows[0][0] == 'robot'
    assert [row[0] for row in rows[1:]] == ['a'] * 3 + ['b'] * 3
    save_plan(plan, tmp_path / 'plan.json')
    assert set(load_plan(tmp_path / 'plan.json')['robots']) == {'a', 'b'}
    joint = solution(both, checks).trajectory
    assert joint.state_names == ('a.theta', 'a.psi', 'b.theta', 'b.psi')


@pytest.mark.parametrize('name', ['plan.txt', 'plan', 'missing/plan.json', ''])
def test_paths_that_cannot_be_written_are_refused(tmp_path, name):
    with pytest.raises(InvalidProblem):
        check_path(tmp_path / name)


@pytest.mark.parametrize(
    'text', ['', '{', '[]', '{"problem": "x"}', '{"problem":"x","times":[1]}']
)
def test_files_that_are_no_plans_are_refused(tmp_path, text):
    path = tmp_path / 'plan.json'
    path.write_text(text)
    with pytest.raises(InvalidProblem):
        load_plan(path)
    with pytest.raises(InvalidProblem, match='cannot be read'):
        load_plan(tmp_path / 'absent.json')
