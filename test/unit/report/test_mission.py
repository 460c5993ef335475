# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.mission import Mission, PlanInForce, Signals, thinned_indices, Vehicle


def signals() -> Signals:
    times = np.array([0.0, 1.0, 2.0])
    return Signals(times, np.array([[0, 5], [2, np.nan], [4, 7.0]]), ('a', 'b'), ('m', 's'))


def test_histories_by_name():
    found = signals()
    assert 'a' in found
    assert 'c' not in found
    assert found.unit('b') == 's'
    assert found.column('a').tolist() == [0, 2, 4]
    chosen = found.select('b', 'a')
    assert chosen.names == ('b', 'a')
    assert chosen.units == ('s', 'm')
    assert chosen.values[2].tolist() == [7, 4]
    assert found.between(0.5, 2.0).times.tolist() == [1, 2]


def test_values_between_samples_and_none_outside():
    found = signals().at(np.array([-1.0, 0.5, 1.5, 3.0]))
    np.testing.assert_array_equal(found[:, 0], [np.nan, 1.0, 3.0, np.nan])
    assert np.isnan(found[2, 1])
    assert Signals(np.zeros(0), np.zeros((0, 1)), ('a',), ('',)).at(np.zeros(3)).shape == (3, 1)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.integers(0, 3000), st.integers(1, 3), st.integers(10, 400), st.integers(0, 2**31))
def test_thinning_keeps_extremes_ends_and_gaps(n: int, m: int, most: int, seed: int):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n, m))
    values[rng.random((n, m)) < 0.1] = np.nan
    kept = thinned_indices(values, most)
    assert (np.diff(kept) > 0).all()
    assert kept.size <= max(most, 2 + 2 * m)
    if n:
        assert kept[0] == 0
        assert kept[-1] == n - 1
        for k in range(m):
            if np.isfinite(values[:, k]).any():
                assert np.nanmin(values[kept, k]) == np.nanmin(values[:, k])
                assert np.nanmax(values[kept, k]) == np.nanmax(values[:, k])


def plan(start: float, until: float | None = None) -> PlanInForce:
    motion = Trajectory(
        np.array([0.0, 2.0]), np.array([[0.0], [4.0]]), np.zeros((2, 1)), ('x',), ('u',)
    )
    return PlanInForce('1', start, motion, until)


def test_a_plan_is_followed_until_the_next_one_starts():
    assert plan(1.0).end == 3.0
    assert plan(1.0).carried_out_until == 3.0
    assert plan(1.0, 2.5).carried_out_until == 2.5
    assert plan(1.0).states(np.array([1.0, 2.0, 9.0]))[:, 0].tolist() == [0, 2, 4]


def test_span_covers_plans_and_measurements():
    states = Signals(np.array([-1.0, 5.0]), np.zeros((2, 1)), ('x',), ('m',))
    mission = Mission('', '', (Vehicle('a', 'other', (plan(1.0),), states=states),))
    assert mission.span == (-1.0, 5.0)
    assert mission.was_carried_out
    assert not Mission('', '', (Vehicle('a', 'other', (plan(1.0),)),)).was_carried_out


@pytest.mark.parametrize('value', [None, 'x', True, np.nan, np.inf, [1.0]])
def test_a_parameter_that_is_no_number_is_none(value: object):
    assert Mission('', '', (), parameters={'a': value}).number('a') is None
    assert Mission('', '', (), parameters={'a': 2}).number('a') == 2.0


@pytest.mark.parametrize('value', [None, 1.0, ['x'], [np.nan]])
def test_a_parameter_that_is_no_list_of_numbers_is_none(value: object):
    assert Mission('', '', (), parameters={'a': value}).numbers('a') is None
    found = Mission('', '', (), parameters={'a': [1, 2.5]}).numbers('a')
    assert found is not None
    assert found.tolist() == [1.0, 2.5]
