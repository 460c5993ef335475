# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plans as files: every bit of them is kept, and what is no plan is refused."""

from __future__ import annotations

from collections.abc import Mapping
import csv
from pathlib import Path

import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plan_files import check_path, load_plan, save_plan
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Verification

NUMBERS = ((0.1, 2.0), (1 / 3, -1e-17), (3.0, 4.0))


def trajectory(values: object = NUMBERS) -> Trajectory:
    times, torque = np.array([0.0, 0.1, 0.30000000000000004]), np.array([[1.0], [-1.0], [0.0]])
    return Trajectory(times, np.array(values), torque, ('theta', 'psi'), ('torque',))


def solution(trajectories: Mapping[str, Trajectory]) -> Solution:
    check = Verification(True, np.zeros(2), {'torque': 0.1}, {'torque': 0.2})
    checks = dict.fromkeys(trajectories, check) if len(trajectories) > 1 else {}
    return Solution(trajectories, check, 1.5, np.zeros(2), 0.0, {}, checks, 'example', 7, 0.01)


def test_json_csv_and_npz_keep_every_bit(tmp_path: Path) -> None:
    original = trajectory()
    for ending in ('json', 'csv', 'npz'):
        save_plan(solution({'pendulum': original}).to_dict(), tmp_path / f'plan.{ending}')
    plan = load_plan(tmp_path / 'plan.json')
    again = Trajectory.from_dict(plan)
    for name in ('times', 'states', 'controls'):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
    assert plan['interpolation'] == 'zero_order_hold'
    assert plan['verification']['worst'] == {'torque': 0.1}
    assert set(plan) >= {'problem', 'duration', 'cost', 'penalty', 'solve_time', 'evaluations'}
    head, *rows = csv.reader((tmp_path / 'plan.csv').open())
    assert head == ['time', 'theta', 'psi', 'torque']
    np.testing.assert_array_equal(np.array(rows, dtype=float)[:, 1:3], original.states)
    with np.load(tmp_path / 'plan.npz') as arrays:
        np.testing.assert_array_equal(arrays['times'], original.times)
        np.testing.assert_array_equal(arrays['theta'], original.states[:, 0])


def test_several_vehicles(tmp_path: Path) -> None:
    both = solution({'a': trajectory(), 'b': trajectory()})
    plan = both.to_dict()
    assert set(plan['robots']) == {'a', 'b'}
    save_plan(plan, tmp_path / 'plan.csv')
    rows = list(csv.reader((tmp_path / 'plan.csv').open()))
    assert [row[0] for row in rows] == ['robot', *'aaabbb']
    save_plan(plan, tmp_path / 'plan.json')
    assert set(load_plan(tmp_path / 'plan.json')['robots']) == {'a', 'b'}
    assert both.trajectory.state_names == ('a.theta', 'a.psi', 'b.theta', 'b.psi')


def test_what_cannot_be_written_or_is_no_plan_is_refused(tmp_path: Path) -> None:
    for name in ('plan.txt', 'plan', 'missing/plan.json', ''):
        with pytest.raises(InvalidProblem):
            check_path(tmp_path / name)
    path = tmp_path / 'plan.json'
    with pytest.raises(InvalidProblem, match='cannot be read'):
        load_plan(path)
    for text in ('', '{', '[]', '{"problem": "x"}', '{"problem":"x","times":[1]}'):
        path.write_text(text)
        with pytest.raises(InvalidProblem):
            load_plan(path)
