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
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from missions import joint_state, odometry, SECOND, store
import numpy as np
import pytest
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.cdr_columns import columns
from tdm_sim.report.mission import Mission, PlanInForce, Signals, thinned_indices, Vehicle
from tdm_sim.report.recorded_clock import RecordedClock
from tdm_sim.report.recorded_topics import CLOCK, Received, RecordedTopics

JOINT_STATE = 'sensor_msgs/msg/JointState'

names = st.lists(st.text(max_size=8), max_size=4, unique=True)
stamps = st.integers(0, 2**31 * SECOND - 1)


def written(message: Any, little: bool = True) -> bytes:
    return bytes(store().serialize_cdr(message, message.__msgtype__, little_endian=little))


def of(kind: str, messages: list[bytes]) -> list[Any]:
    return list(columns(store().fielddefs, kind, messages))


GOOD = written(joint_state(7, ['a'], position=[1.5]))


@settings(max_examples=40)
@given(st.lists(st.tuples(names, st.booleans(), stamps), max_size=6), st.booleans())
def test_numbers_are_those_of_the_library(rows: list[Any], little: bool) -> None:
    """Messages of mixed layouts, in either order of bytes."""
    made = [
        joint_state(
            at,
            joints,
            position=np.arange(len(joints)) + 0.25 * k,
            effort=np.full(len(joints), float(k)) if full else (),
        )
        for k, (joints, full, at) in enumerate(rows)
    ]
    seen = []
    for found in of(JOINT_STATE, [written(message, little) for message in made]):
        for k, row in enumerate(found.rows.tolist()):
            seen.append(row)
            expected = made[row]
            if '\0' not in ''.join(expected.name):
                assert found.strings['name'] == tuple(expected.name)
            stamp = expected.header.stamp
            assert found.numbers['header.stamp.sec'][k, 0] == stamp.sec
            assert found.numbers['header.stamp.nanosec'][k, 0] == stamp.nanosec
            for quantity in ('position', 'velocity', 'effort'):
                value = found.numbers[quantity][k]
                assert value.tolist() == getattr(expected, quantity).tolist()
    assert sorted(seen) == list(range(len(rows)))


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


def test_an_odometry_and_what_is_cut_short_or_of_absurd_length() -> None:
    message = odometry(5, 'robot1', [1.0, 2.0, 0.5, 0.0, 0.0, 0.25])
    (found,) = of(message.__msgtype__, [written(message)] * 3)
    assert found.rows.tolist() == [0, 1, 2]
    assert found.strings['header.frame_id'] == ('arena',)
    assert found.numbers['pose.pose.position.x'].tolist() == [[1.0]] * 3
    assert found.numbers['twist.twist.angular.z'].tolist() == [[0.25]] * 3
    assert found.numbers['pose.covariance'].shape == (3, 36)
    absurd = GOOD[:20] + b'\xff\xff\xff\x7f' + GOOD[24:]  # number of names
    assert of(JOINT_STATE, [GOOD[:-9], absurd, b'']) == []


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=80), max_size=5))
def test_bytes_that_are_no_message_are_left_out_quietly(data: list[bytes]) -> None:
    assert len(data) in [row for found in of(JOINT_STATE, [*data, GOOD]) for row in found.rows]


def test_a_plan_is_followed_until_the_next_one_starts() -> None:
    motion = Trajectory([0.0, 2.0], [[0.0], [4.0]], [[0.0], [2.0]], ('x',), ('u',), 'linear')
    plan = PlanInForce('1', 1.0, motion)
    assert (plan.end, plan.carried_out_until) == (3.0, 3.0)
    assert replace(plan, until=2.5).carried_out_until == 2.5
    assert plan.states(np.array([1.0, 2.0, 9.0]))[:, 0].tolist() == [0, 2, 4]
    assert plan.controls(np.array([1.0, 2.0]))[:, 0].tolist() == [0, 1]
    states = Signals(np.array([-1.0, 5.0]), np.zeros((2, 1)), ('x',), ('m',))
    mission = Mission('', '', (Vehicle('a', 'other', (plan,), states=states),))
    assert mission.span == (-1.0, 5.0)
    assert mission.was_carried_out
    assert not Mission('', '', (Vehicle('a', 'other', (plan,)),)).was_carried_out


def test_parameters_that_are_no_numbers_are_none() -> None:
    good = Mission('', '', (), parameters={'one': 2, 'list': [1, 2.5]})
    found = good.numbers('list')
    assert found is not None
    assert (good.number('one'), found.tolist()) == (2.0, [1.0, 2.5])
    for value in (None, 'x', True, np.nan, np.inf, ['x'], [np.nan]):
        bad = Mission('', '', (), parameters={'one': value})
        assert (bad.number('one'), bad.numbers('one')) == (None, None)


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
