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
from mission_bags import joint_state, odometry, store
import numpy as np
from tdm_sim.report.cdr_columns import columns

JOINT_STATE, ODOMETRY = 'sensor_msgs/msg/JointState', 'nav_msgs/msg/Odometry'
TYPES = store()

names = st.lists(st.text(max_size=8), max_size=4, unique=True)
stamps = st.integers(0, 2**31 * 10**9 - 1)


def of(kind: str, messages: list[bytes]):
    return list(columns(TYPES.fielddefs, kind, messages))


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.lists(st.tuples(names, st.booleans(), stamps), max_size=6), st.booleans())
def test_numbers_are_those_of_the_library(rows, little: bool):
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
    data = [bytes(TYPES.serialize_cdr(m, JOINT_STATE, little_endian=little)) for m in made]
    seen = []
    for found in of(JOINT_STATE, data):
        for k, row in enumerate(found.rows.tolist()):
            seen.append(row)
            expected = made[row]
            assert found.strings['name'] == tuple(n.split('\0')[0] for n in expected.name) or (
                '\0' in ''.join(expected.name)
            )
            assert found.numbers['header.stamp.sec'][k, 0] == expected.header.stamp.sec
            assert found.numbers['header.stamp.nanosec'][k, 0] == expected.header.stamp.nanosec
            for quantity in ('position', 'velocity', 'effort'):
                value = found.numbers[quantity][k]
                assert value.tolist() == getattr(expected, quantity).tolist()
    assert sorted(seen) == list(range(len(rows)))


def test_an_odometry():
    message = odometry(5, 'robot1', [1.0, 2.0, 0.5, 0.0, 0.0, 0.25])
    (found,) = of(ODOMETRY, [bytes(TYPES.serialize_cdr(message, ODOMETRY))] * 3)
    assert found.rows.tolist() == [0, 1, 2]
    assert found.strings['header.frame_id'] == ('arena',)
    assert found.numbers['pose.pose.position.x'].tolist() == [[1.0]] * 3
    assert found.numbers['twist.twist.angular.z'].tolist() == [[0.25]] * 3
    assert found.numbers['pose.covariance'].shape == (3, 36)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.lists(st.binary(max_size=80), max_size=5))
def test_bytes_that_are_no_message_are_left_out_quietly(data: list[bytes]):
    for found in of(JOINT_STATE, data):
        assert found.numbers['position'].ndim == 2
    good = bytes(TYPES.serialize_cdr(joint_state(7, ['a'], position=[1.5]), JOINT_STATE))
    rows = [row for found in of(JOINT_STATE, [*data, good]) for row in found.rows]
    assert len(data) in rows


def test_a_message_cut_short_or_of_absurd_length_is_left_out():
    good = bytes(TYPES.serialize_cdr(joint_state(7, ['a'], position=[1.5]), JOINT_STATE))
    absurd = bytearray(good)
    absurd[20:24] = b'\xff\xff\xff\x7f'  # number of names
    assert of(JOINT_STATE, [good[:-9], bytes(absurd), b'']) == []
