# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The tracker of a robot over real DDS, with the simulated robot."""

from __future__ import annotations

import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import LATCHED, to_stamp
from tdm_planner.nodes.robot_messages import robot_controls_message, robot_trajectory_message
from tdm_planner.problems import RobotFormation
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

SPACE = '/fleet/scout'
PARAMETERS = {
    'robots': ['scout'],
    'scout.start.x': 1.0,
    'scout.start.y': 1.0,
    'scout.start.yaw': 3.0,
    'formation.anchor': [1.6, 1.3, 0.0],
    'formation.scout': [0.0, 0.0, -2.5],
    'weights.gas': 0.05,
}


@pytest.fixture(scope='module')
def problem() -> RobotFormation:
    made = RobotFormation.from_parameters(PARAMETERS)
    assert isinstance(made, RobotFormation)
    return made


@pytest.fixture(scope='module')
def plan(problem: RobotFormation) -> Trajectory:
    trajectory = problem.solve(deadline=5.0).trajectories['scout']
    return trajectory.with_rates(problem.plant.derivative)


class Rig:
    """Tracker and plant of one robot, and what they say."""

    def __init__(self, ros: Ros) -> None:
        self.ros = ros
        initial = {'x': 1.0, 'y': 1.0, 'yaw': 3.0, 'alpha': 1.0}
        noise = {'position': 0.002, 'velocity': 0.002, 'yaw': 0.005, 'omega': 0.005}
        ros.start(
            'tdm_sim.robot_plant',
            {
                'mismatch': 0.05,
                **{f'initial.{key}': value for key, value in initial.items()},
                **{f'noise.{key}': value for key, value in noise.items()},
            },
            namespace=SPACE,
        )
        self.tracker: NodeProcess = ros.start(
            'tdm_planner.nodes.tracker', {'kind': 'robot'}, namespace=SPACE
        )
        self.odom = ros.subscribe(f'{SPACE}/odom', Odometry)
        self.commands = ros.subscribe(f'{SPACE}/joint_command', JointState)
        self.errors = ros.subscribe(f'{SPACE}/tracking_error', JointState)
        self.diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 50)
        self.motions = ros.publisher(f'{SPACE}/trajectory', MultiDOFJointTrajectory, LATCHED)
        self.controls = ros.publisher(f'{SPACE}/controls', JointTrajectory, LATCHED)

    def says(self, text: str, timeout: float = 10.0) -> bool:
        def newest() -> bool:
            name = f'{SPACE}/tracker: tracking'
            messages = [s.message for a in self.diagnostics for s in a.status if s.name == name]
            return bool(messages) and text in messages[-1]

        return self.ros.spin_until(newest, timeout)


@pytest.fixture(scope='module')
def rig(ros: Ros) -> Rig:
    return Rig(ros)


def messages(problem: RobotFormation, plan: Trajectory, robot: str = 'scout') -> tuple[Any, Any]:
    stamp = to_stamp(time.time_ns() + 10**9)
    return (
        robot_trajectory_message(robot, plan, stamp),
        robot_controls_message(plan, problem.plant, stamp),
    )


def test_halves_of_different_plans_are_not_put_together(
    ros: Ros, rig: Rig, problem: RobotFormation, plan: Trajectory
) -> None:
    assert rig.says('idle')
    rig.motions.publish(messages(problem, plan)[0])
    ros.spin_for(0.2)
    rig.controls.publish(messages(problem, plan)[1])
    ros.spin_for(0.5)
    assert 'accepted' not in rig.tracker.output
    assert rig.says('idle')


def begin_elsewhere(motion: Any, controls: Any) -> None:
    for point in motion.points:
        point.transforms[0].translation.x = 3.0


@pytest.mark.parametrize(
    ('spoil', 'reason'),
    [
        (lambda motion, controls: setattr(motion, 'joint_names', ['other']), 'scout'),
        (lambda motion, controls: controls.points.pop(), 'points'),
        (lambda motion, controls: setattr(controls, 'joint_names', ['a', 'b']), 'thruster'),
        (lambda motion, controls: setattr(motion.points[5], 'velocities', []), 'point 5'),
        (begin_elsewhere, 'tolerance.start'),
    ],
)
def test_plans_are_refused_with_a_reason(
    rig: Rig, problem: RobotFormation, plan: Trajectory, spoil: Any, reason: str
) -> None:
    motion, controls = messages(problem, plan)
    spoil(motion, controls)
    rig.motions.publish(motion)
    rig.controls.publish(controls)
    assert rig.says(reason)
    assert rig.says('refused')


def test_refused_plans_do_not_keep_the_thruster_from_turning_in_time(
    ros: Ros, rig: Rig, problem: RobotFormation, plan: Trajectory
) -> None:
    """However many were looked at before, a plan is looked at while there is time to turn."""
    for _ in range(4):
        motion, controls = messages(problem, plan)
        for point in motion.points:
            point.transforms[0].translation.x = 3.0
        rig.controls.publish(controls)
        rig.motions.publish(motion)
        ros.spin_for(0.05)
    ros.spin_for(1.5)  # what of them is looked at just before its start
    assert 'tolerance.start' in rig.tracker.output


def test_the_robot_arrives_and_keeps_station(
    ros: Ros, rig: Rig, problem: RobotFormation, plan: Trajectory
) -> None:
    motion, controls = messages(problem, plan)
    rig.controls.publish(controls)
    rig.motions.publish(motion)
    assert rig.says('waiting')
    assert rig.says('tracking')
    assert rig.says('holding', timeout=plan.duration + 5.0)
    ros.spin_for(1.0)
    place = rig.odom[-1].pose.pose.position
    assert math.hypot(place.x - 1.6, place.y - 1.3) < 0.03
    turn = rig.odom[-1].pose.pose.orientation
    assert abs(math.remainder(2 * math.atan2(turn.z, turn.w) + 2.5, math.tau)) < 0.04
    command = rig.commands[-1]
    assert list(command.name) == ['thruster', 'reaction_wheel']
    assert list(rig.errors[-1].name) == ['x', 'y', 'yaw', 'thruster', 'reaction_wheel']
    assert np.hypot(*np.array([e.position[:2] for e in rig.errors]).T).max() < 0.05


def test_a_state_without_thruster_is_not_used(ros: Ros, rig: Rig) -> None:
    rig.tracker.end_cleanly()
    tracker = ros.start('tdm_planner.nodes.tracker', {'kind': 'robot'}, namespace='/lonely')
    publisher = ros.publisher('/lonely/odom', Odometry)
    commands = ros.subscribe('/lonely/joint_command', JointState)

    def publish() -> None:
        odometry = Odometry()
        odometry.header.stamp = to_stamp(time.time_ns())
        odometry.pose.pose.orientation.w = 1.0
        publisher.publish(odometry)
        ros.spin_for(0.01)

    assert ros.publish_until(publish, lambda: bool(commands))
    for _ in range(20):
        publish()
    assert not any(command.effort[0] for command in commands)
    assert ros.spin_until(lambda: 'no state has been received' in tracker.output)
    tracker.end_cleanly()
