# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from collections.abc import Callable
import math
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_harness import Ros
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

MODULE = 'tdm_sim.robot_plant'
INITIAL = {
    'initial.x': 1.0,
    'initial.y': 2.5,
    'initial.yaw': 0.6,
    'initial.u': 0.2,
    'initial.v': -0.1,
    'initial.alpha': 0.3,
    'initial.wheel_speed': 5.0,
}


class Robot:
    """A robot in a namespace of its own, and everything it publishes."""

    def __init__(self, ros: Ros, name: str, parameters: dict[str, Any]) -> None:
        self.ros = ros
        self.name = name
        self.odom = ros.subscribe(f'/arena/{name}/odom', Odometry, 1000)
        self.joints = ros.subscribe(f'/arena/{name}/joint_states', JointState, 1000)
        self.process = ros.start(
            MODULE, {'command_timeout': 30.0, **parameters}, namespace=f'arena/{name}'
        )
        assert ros.spin_until(lambda: bool(self.odom and self.joints), 20.0), self.process.output
        self.commands = ros.publisher(f'/arena/{name}/joint_command', JointState)
        assert ros.commands_act(
            lambda thrust: self.command(thrust, 0.0, 0.0), lambda: self.joints[-1].effort[0]
        ), self.process.output
        del self.joints[:-1]

    def command(self, thrust: float, rate: float, torque: float) -> None:
        self.commands.publish(
            JointState(
                name=['reaction_wheel', 'thruster'],
                velocity=[0.0, rate],
                effort=[torque, thrust],
            )
        )

    def until(self, condition: Any) -> bool:
        """Wait for joint states that fulfil `condition`, from now on."""
        self.joints.clear()
        return self.ros.spin_until(lambda: any(condition(s) for s in self.joints))

    def trigger(self, service: str) -> Any:
        return self.ros.call(f'/arena/{self.name}/{service}', Trigger)


def stamp(message: Any) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def position(message: Odometry) -> np.ndarray:
    return np.array([message.pose.pose.position.x, message.pose.pose.position.y])


def yaw(message: Odometry) -> float:
    q = message.pose.pose.orientation
    return 2.0 * math.atan2(q.z, q.w)


def velocity_in_arena(message: Odometry) -> np.ndarray:
    """Read the twist as every user of odometry does: it is in the child's frame."""
    cosine, sine = math.cos(yaw(message)), math.sin(yaw(message))
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    return rotation @ [message.twist.twist.linear.x, message.twist.twist.linear.y]


def rate_of(messages: list[Any], quantity: Callable[[Any], np.ndarray]) -> np.ndarray:
    """Typical rate of change; the median, since a stalled process leaves time out."""
    values = np.array([quantity(message) for message in messages])
    times = np.array([stamp(message) for message in messages])
    return np.median(np.diff(values, axis=0) / np.diff(times)[:, None], axis=0)


@pytest.fixture(scope='module')
def drifting(ros: Ros) -> Robot:
    return Robot(ros, 'drifter', INITIAL)


def test_odometry_and_joints_of_a_drifting_robot(drifting: Robot) -> None:
    drifting.odom.clear()
    drifting.joints.clear()
    assert drifting.ros.spin_until(lambda: len(drifting.odom) >= 100 and len(drifting.joints) > 99)
    first = drifting.odom[0]
    assert (first.header.frame_id, first.child_frame_id) == ('arena', 'drifter')
    assert yaw(first) == pytest.approx(0.6)
    np.testing.assert_allclose(velocity_in_arena(first), [0.2, -0.1], atol=1e-9)
    np.testing.assert_allclose(rate_of(drifting.odom, position), [0.2, -0.1], rtol=1e-3)
    joints = drifting.joints[0]
    assert list(joints.name) == ['thruster', 'reaction_wheel']
    assert joints.position[0] == pytest.approx(0.3)
    assert list(joints.velocity) == [0.0, 5.0]
    assert list(joints.effort) == [0.0, 0.0]
    turning = rate_of(drifting.joints, lambda s: np.array([s.position[1]]))
    np.testing.assert_allclose(turning, [5.0], rtol=1e-3)


def test_commands_act_and_saturate(drifting: Robot) -> None:
    drifting.command(0.5, 0.2, 0.001)
    assert drifting.until(
        lambda s: (
            list(s.effort) == [0.5, 0.001]
            and s.velocity[0] == 0.2
            and s.position[0] > 0.31
            and s.velocity[1] < 4.9
        )
    )
    drifting.command(9.0, -9.0, 9.0)
    assert drifting.until(lambda s: list(s.effort) == [1.05, 0.02] and s.velocity[0] == -2.0)
    drifting.command(-1.0, 0.0, 0.0)
    assert drifting.until(lambda s: s.effort[0] == 0.0)


def test_acceleration_is_along_the_thrust(ros: Ros) -> None:
    robot = Robot(ros, 'pushed_by_thrust', {'initial.yaw': 0.5, 'initial.alpha': 1.0})
    robot.command(1.0, 0.0, 0.0)
    assert robot.until(lambda s: s.effort[0] == 1.0)
    ros.spin_until(lambda: len(robot.joints) > 20)
    robot.odom.clear()
    assert ros.spin_until(lambda: len(robot.odom) > 60)
    expected = 1.0 / 10.5 * np.array([math.cos(1.5), math.sin(1.5)])
    np.testing.assert_allclose(rate_of(robot.odom, velocity_in_arena), expected, rtol=1e-3)
    robot.process.end_cleanly()


def test_push_reset_and_a_command_that_names_no_wheel(ros: Ros) -> None:
    robot = Robot(
        ros, 'robot9', {'disturbance.impulse': 2.1, 'disturbance.direction': 0.0, 'rate': 100}
    )
    response = robot.trigger('push')
    assert response.message == 'pushed robot9 with 2.1 N s towards 0.000 rad'
    robot.odom.clear()
    assert ros.spin_until(lambda: bool(robot.odom))
    np.testing.assert_allclose(velocity_in_arena(robot.odom[-1]), [0.2, 0.0], atol=1e-9)
    assert robot.trigger('reset').success
    robot.odom.clear()
    assert ros.spin_until(lambda: bool(robot.odom))
    np.testing.assert_allclose(position(robot.odom[-1]), [2.0, 2.0])
    robot.commands.publish(JointState(name=['thruster'], velocity=[0.0], effort=[1.0]))
    words = "joint_command ignored: it must name joint 'reaction_wheel' once"
    assert ros.spin_until(lambda: words in robot.process.output)
    assert robot.joints[-1].effort[0] == 0.0
    assert robot.process.end(signal.SIGTERM) == 0


def test_walls_and_name(ros: Ros) -> None:
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 100)
    robot = Robot(
        ros,
        'bouncer',
        {'robot_name': 'ball', 'arena.walls': True, 'initial.x': 3.7, 'initial.u': 1.0},
    )
    assert robot.odom[0].child_frame_id == 'ball'
    assert ros.spin_until(
        lambda: any(
            '1 collisions with a wall' in status.message
            for array in diagnostics
            for status in array.status
        )
    )
    assert max(position(o)[0] for o in robot.odom) <= 3.85 + 1e-9
    assert velocity_in_arena(robot.odom[-1])[0] == pytest.approx(-1.0)
    assert 'ball hit a wall with 1 m/s along x' in robot.process.output
    (reason,) = ros.set_parameters('/arena/bouncer/robot_plant', arena__robot_radius=2.0)
    assert "'arena.robot_radius' = 2 is not allowed: must be in [0, 2) m" in reason
    robot.process.end_cleanly()
