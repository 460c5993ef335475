# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Numbers out of recorded bytes, histories of them by name, and the clock they were stamped by."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
from missions import SECOND
import numpy as np
import pytest
from tdm_planner.plant_views import kind_by_names, PlantView
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.mission import FollowedPlan, Mission, Signals, thinned_indices, Vehicle
from tdm_sim.report.recorded_events import RecordedClock
from tdm_sim.report.recorded_topics import CLOCK, Received, RecordedTopics


def test_histories_by_name() -> None:
    values = np.array([[0, 5], [2, np.nan], [4, 7.0]])
    found = Signals(np.array([0.0, 1.0, 2.0]), values, ('a', 'b'), ('m', 's'))
    assert 'a' in found
    assert 'c' not in found
    assert found.unit('b') == 's'
    assert found.column('a').tolist() == [0, 2, 4]
    chosen = found.select('b', 'a')
    assert (chosen.names, chosen.units) == (('b', 'a'), ('s', 'm'))
    assert chosen.values[2].tolist() == [7, 4]
    assert found.between(0.5, 2.0).times.tolist() == [1, 2]
    between = found.at(np.array([-1.0, 0.5, 1.5, 3.0]))
    np.testing.assert_array_equal(between[:, 0], [np.nan, 1.0, 3.0, np.nan])
    assert np.isnan(between[2, 1])
    assert Signals(np.zeros(0), np.zeros((0, 1)), ('a',), ('',)).at(np.zeros(3)).shape == (3, 1)


@settings(max_examples=40)
@given(st.integers(0, 3000), st.integers(1, 3), st.integers(10, 400), st.integers(0, 2**31))
def test_thinning_keeps_extremes_ends_and_gaps(n: int, m: int, most: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n, m))
    values[rng.random((n, m)) < 0.1] = np.nan
    kept = thinned_indices(values, most)
    assert (np.diff(kept) > 0).all()
    assert kept.size <= max(most, 2 + 2 * m)
    if n:
        assert (kept[0], kept[-1]) == (0, n - 1)
    for k in range(m):
        if np.isfinite(values[:, k]).any():
            assert np.nanmin(values[kept, k]) == np.nanmin(values[:, k])
            assert np.nanmax(values[kept, k]) == np.nanmax(values[:, k])


def test_a_plan_is_followed_until_the_next_one_starts() -> None:
    t = np.array([0.0, 2.0])
    motion = Trajectory(t, 2.0 * t[:, None], t[:, None], ('x',), ('u',), 'linear')
    plan = FollowedPlan(motion, 1.0, '1')
    assert (plan.end, plan.carried_out_until) == (3.0, 3.0)
    assert replace(plan, until=2.5).carried_out_until == 2.5
    assert plan.sample(np.array([1.0, 2.0, 9.0])).state[:, 0].tolist() == [0, 2, 4]
    assert plan.sample(np.array([1.0, 2.0])).control[:, 0].tolist() == [0, 1]
    states = Signals(np.array([-1.0, 5.0]), np.zeros((2, 1)), ('x',), ('m',))
    mission = Mission(
        '', '', (Vehicle('a', PlantView(kind_by_names(motion)), (plan,), states=states),)
    )
    assert mission.span == (-1.0, 5.0)
    assert mission.was_carried_out
    assert not Mission(
        '', '', (Vehicle('a', PlantView(kind_by_names(motion)), (plan,)),)
    ).was_carried_out


@pytest.mark.parametrize('speed', [0.5, 1.0, 4.0])
def test_the_speed_and_instants_of_a_simulated_clock(speed: float) -> None:
    def clock(count: int) -> RecordedClock | None:
        messages = []
        for k in range(count):
            second, nanosecond = divmod(round(k * speed * SECOND), SECOND)
            shown = SimpleNamespace(sec=100 + second, nanosec=nanosecond)
            messages.append(Received(SimpleNamespace(clock=shown), (50 + k) * SECOND))
        told, types = {'/clock': messages}, {'/clock': CLOCK}
        return RecordedClock.of(RecordedTopics({}, told, types, malformed={}, not_finite={}))

    found = clock(20)
    assert found is not None
    assert found.speed == pytest.approx(speed)
    for recorded in (40.0, 50.0, 52.25, 69.0, 80.0):
        expected = 100 + (recorded - 50) * speed
        assert found.instant(round(recorded * SECOND)) / SECOND == pytest.approx(expected)
    assert (clock(0), clock(1)) == (None, None)
