# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Replanning for robots over DDS: the formation is moved while they are under way."""

from __future__ import annotations

import time
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_harness import Ros
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, to_stamp
from tdm_planner.nodes.robot_messages import robot_trajectory, to_quaternion
from tdm_planner.problems import RobotFormation
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

ROBOTS = ['robot1', 'robot2', 'robot3']
MOVED = [2.3, 1.8, 0.7]


class Followers:
    """Robots that are exactly where the plan in force has them."""

    def __init__(self, ros: Ros) -> None:
        self.ros = ros
        self.motions, self.controls, self.odometry, self.joints = {}, {}, {}, {}
        for name in ROBOTS:
            space = f'/fleet/{name}'
            self.motions[name] = ros.subscribe(
                f'{space}/trajectory', MultiDOFJointTrajectory, LATCHED
            )
            self.controls[name] = ros.subscribe(f'{space}/controls', JointTrajectory, LATCHED)
            self.odometry[name] = ros.publisher(f'{space}/odom', Odometry)
            self.joints[name] = ros.publisher(f'{space}/joint_states', JointState)

    def plan(self, name: str) -> tuple[Trajectory, int]:
        """Return the newest plan of a robot and the instant it starts [ns]."""
        motion, controls = self.motions[name][-1], self.controls[name][-1]
        return robot_trajectory(motion, controls, name), nanoseconds_of(motion.header.stamp)

    def count(self) -> int:
        """Return how many plans there were for every robot."""
        return min(len(x[name]) for x in (self.motions, self.controls) for name in ROBOTS)

    def follow(self, plans: dict[str, tuple[Trajectory, int]]) -> None:
        """Publish where the robots are now."""
        now = time.time_ns()
        for name, (trajectory, start) in plans.items():
            x, y, u, v, yaw, omega, alpha = trajectory.sample((now - start) * 1e-9).state.tolist()
            odometry = Odometry()
            odometry.header.stamp = to_stamp(now)
            odometry.header.frame_id, odometry.child_frame_id = 'arena', name
            odometry.pose.pose.position.x, odometry.pose.pose.position.y = x, y
            odometry.pose.pose.orientation = to_quaternion(yaw)
            cosine, sine = np.cos(yaw), np.sin(yaw)
            odometry.twist.twist.linear.x = float(cosine * u + sine * v)
            odometry.twist.twist.linear.y = float(cosine * v - sine * u)
            odometry.twist.twist.angular.z = omega
            joints = JointState(
                name=['thruster', 'reaction_wheel'], position=[alpha, 0.0], velocity=[0.0, 0.0]
            )
            joints.header.stamp = to_stamp(now)
            self.joints[name].publish(joints)
            self.odometry[name].publish(odometry)
        self.ros.spin_for(0.03)


@pytest.fixture(scope='module')
def fleet(ros: Ros) -> Followers:
    parameters: dict[str, Any] = {
        'problem': 'robot_formation',
        'start.source': 'parameters',
        'replan.rate': 5.0,
        'replan.delay': 1.5,
    }
    ros.start('tdm_planner.nodes.planner', parameters, namespace='fleet')
    return Followers(ros)


def test_robots_are_planned_for_anew_when_the_formation_moves(ros: Ros, fleet: Followers) -> None:
    done, answer = ros.trigger('/fleet/plan', timeout=60.0)
    assert done, answer
    assert ros.spin_until(lambda: fleet.count() == 1)
    plans = {name: fleet.plan(name) for name in ROBOTS}
    under_way = plans['robot1'][1] + 3 * 10**9
    while time.time_ns() < under_way:
        fleet.follow(plans)
    assert fleet.count() == 1  # followed, it is kept
    assert ros.set_parameter_mapping('/fleet/planner', {'formation.anchor': MOVED}) == ['']
    end = time.monotonic() + 20.0
    while fleet.count() == 1 and time.monotonic() < end:
        fleet.follow(plans)
    assert fleet.count() > 1
    goals = RobotFormation.from_parameters({'formation.anchor': MOVED}).task.goal
    for name, goal in zip(ROBOTS, goals, strict=True):
        new, start = fleet.plan(name)
        np.testing.assert_allclose(new.states[-1, :2], goal, atol=5e-3)
        old, before = plans[name]
        expected = old.sample((start - before) * 1e-9).state
        np.testing.assert_allclose(new.states[0], expected, atol=0.02)
