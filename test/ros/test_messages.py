# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math
from typing import Any

from hypothesis import given, settings, strategies
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import (
    joint_motion,
    nanoseconds_of,
    pendulum_message,
    pendulum_trajectory,
    seconds_of,
    to_duration,
    to_stamp,
)
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from trajectory_msgs.msg import JointTrajectory

STAMP = to_stamp(1_700_000_000_123_456_789)


def switched(count: int = 20) -> Trajectory:
    """Consistent enough to be a message: torque jumps in the middle, states are arbitrary."""
    rng = np.random.default_rng(1)
    times = to_nanoseconds(np.concatenate([[0.0], np.cumsum(rng.uniform(1e-3, 5e-3, count - 1))]))
    torque = np.where(np.arange(count) < count // 2, 0.02, -0.02)[:, None]
    return Trajectory(
        times=times,
        states=rng.normal(size=(count, 4)),
        controls=torque,
        state_names=('theta', 'psi', 'theta_dot', 'psi_dot'),
        control_names=('torque',),
    ).with_rates(RotaryPendulum().derivative)


def message(**changes: Any) -> JointTrajectory:
    made = pendulum_message(switched(), STAMP)
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def test_a_trajectory_comes_back_from_the_wire_to_the_last_bit() -> None:
    """But for the last torque, which is held for no time."""
    plan = switched()
    wire = serialize_message(pendulum_message(plan, STAMP))
    read = pendulum_trajectory(deserialize_message(wire, JointTrajectory))
    assert np.array_equal(read.times, plan.times)
    assert np.array_equal(read.states, plan.states)
    assert np.array_equal(read.controls[:-1], plan.controls[:-1])
    assert read.controls[-1, 0] == 0.0
    assert read.interpolation == 'zero_order_hold'
    assert read.state_names == plan.state_names


def test_accelerations_are_those_after_a_jump_of_torque() -> None:
    plan = switched()
    middle = plan.times.size // 2
    made = pendulum_message(plan, STAMP)
    expected = RotaryPendulum().derivative(plan.states, plan.controls)[:, 2:]
    assert np.array_equal([point.accelerations for point in made.points], expected)
    assert made.points[middle - 1].effort[1] != made.points[middle].effort[1]
    assert made.header.stamp == STAMP


def test_a_plan_that_is_not_a_pendulums_is_refused() -> None:
    plan = switched()
    without_rates = Trajectory(
        plan.times, plan.states, plan.controls, plan.state_names, plan.control_names
    )
    with pytest.raises(InvalidProblem, match='needs the states theta, psi'):
        pendulum_message(without_rates, STAMP)


def test_torque_that_varies_everywhere_is_read_as_a_spline() -> None:
    made = message()
    for number, point in enumerate(made.points):
        point.effort = [0.0, math.sin(number)]
    assert pendulum_trajectory(made).interpolation == 'cubic'
    assert pendulum_trajectory(made, 'linear').interpolation == 'linear'


def test_joints_may_come_in_another_order() -> None:
    made = message(joint_names=['disk', 'pendulum'])
    for point in made.points:
        for quantity in ('positions', 'velocities', 'effort'):
            setattr(point, quantity, list(getattr(point, quantity))[::-1])
    assert np.array_equal(pendulum_trajectory(made).states, switched().states)


def refusal(made: JointTrajectory) -> str:
    with pytest.raises(InvalidProblem) as error:
        pendulum_trajectory(made)
    return str(error.value)


def test_malformed_trajectories_are_refused_with_a_reason() -> None:
    assert 'joint(s) disk must be named once' in refusal(message(joint_names=['pendulum', 'a']))
    assert 'names are: none' in refusal(message(joint_names=[]))
    assert 'has 0 points' in refusal(message(points=[]))
    short = message()
    short.points[3].velocities = [0.0]
    assert "'velocities' of point 3 has 1 values for 2 joints" in refusal(short)
    no_effort = message()
    no_effort.points[0].effort = []
    assert "'effort' of point 0 has 0 values" in refusal(no_effort)
    backwards = message()
    backwards.points[5].time_from_start = backwards.points[4].time_from_start
    assert "'times' must increase strictly" in refusal(backwards)
    early = message()
    early.points[0].time_from_start = to_duration(-1.0)
    assert "'time_from_start' of point 0 is -1 s" in refusal(early)
    broken = message()
    broken.points[2].positions = [math.nan, 0.0]
    assert "'states' holds a value that is not finite" in refusal(broken)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(strategies.integers(-(2**31) * 10**9, (2**31 - 1) * 10**9))
def test_instants_are_exact_to_the_nanosecond(nanoseconds: int) -> None:
    assert nanoseconds_of(to_stamp(nanoseconds)) == nanoseconds


@settings(deadline=None, derandomize=True, max_examples=50)
@given(strategies.floats(-1e5, 1e5))
def test_durations_are_rounded_to_the_nanosecond(seconds: float) -> None:
    assert abs(seconds_of(to_duration(seconds)) - seconds) <= 0.5e-9 + 1e-15 * abs(seconds)


def test_the_motion_of_joints_is_picked_by_name() -> None:
    state = JointState(
        name=['wheel', 'disk', 'pendulum'], position=[1.0, 2.0, 3.0], velocity=[4.0, 5.0, 6.0]
    )
    assert joint_motion(state, ('pendulum', 'disk')).tolist() == [3.0, 2.0, 6.0, 5.0]


@pytest.mark.parametrize(
    ('state', 'says'),
    [
        (JointState(name=['disk']), 'joint(s) pendulum must be named once'),
        (JointState(name=['disk', 'pendulum', 'disk']), 'joint(s) disk must be named once'),
        (JointState(name=['disk', 'pendulum']), "'position' has 0 values for 2 named joints"),
        (
            JointState(name=['disk', 'pendulum'], position=[0.0, 0.0], velocity=[math.inf, 0.0]),
            'the velocity of joint disk is inf, not a finite number',
        ),
    ],
)
def test_states_without_the_joints_are_refused(state: JointState, says: str) -> None:
    with pytest.raises(InvalidProblem) as error:
        joint_motion(state, ('pendulum', 'disk'))
    assert says in str(error.value)
