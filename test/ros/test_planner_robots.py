# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The planner of robots over DDS: plans for all of them, and a formation that moves."""

from functools import partial
import json
import math
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_harness import Space
from sensor_msgs.msg import JointState
from stepped_ros import Stepped
from tdm_planner.nodes.messages import to_quaternion, to_stamp
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.plant_kind import ROBOT
from tdm_planner.problems import RobotFormation
from tdm_planner.trajectory import Trajectory

FORMATION = {'problem': 'robot_formation'}
ROBOTS = ['robot1', 'robot2', 'robot3']
MOVED = [2.3, 1.8, 0.7]


class Fleet(Space):
    """A planner in a namespace, and robots that are where the test says."""

    def __init__(self, ros: Stepped, name: str, **parameters: Any) -> None:
        super().__init__(ros, name)
        self.here = self.start('planner', {**FORMATION, **parameters})
        self.motions = {name: self.hear(f'{name}/trajectory') for name in ROBOTS}
        self.paths = {name: self.hear(f'{name}/path') for name in ROBOTS}
        self.odometry = {name: self.publisher(f'{name}/odom') for name in ROBOTS}
        self.joints = {name: self.publisher(f'{name}/joint_states') for name in ROBOTS}

    def motion(self, name: str) -> tuple[Trajectory, int]:
        motion = self.motions[name][-1]
        return read_plan(ROBOT, motion), nanoseconds_of(motion.header.stamp)

    def count(self) -> int:
        return min(len(self.motions[name]) for name in ROBOTS)

    def measure(self, name: str, state: list[float]) -> None:
        """Publish a robot's state [x, y, u, v, yaw, omega, alpha]."""
        x, y, u, v, yaw, omega, alpha = state
        message = Odometry()
        message.header.stamp = to_stamp(self.ros.now)
        message.header.frame_id, message.child_frame_id = 'arena', name
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation = to_quaternion(yaw)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        message.twist.twist.linear.x = cosine * u + sine * v
        message.twist.twist.linear.y = cosine * v - sine * u
        message.twist.twist.angular.z = omega
        joints = JointState(name=['thruster', 'reaction_wheel'], position=[alpha, 0.0])
        joints.velocity = joints.effort = [0.0, 0.0]
        joints.header.stamp = message.header.stamp
        self.joints[name].publish(joints)
        self.odometry[name].publish(message)
        self.ros.settle()

    def follow(self, plans: dict[str, tuple[Trajectory, int]]) -> None:
        for name, (plan, start) in plans.items():
            self.measure(name, plan.sample((self.ros.now - start) * 1e-9).state.tolist())


@pytest.fixture(scope='module')
def fleet(ros: Stepped) -> Fleet:
    return Fleet(ros, 'robots', **{'start.source': 'parameters'})


def test_a_plan_for_every_robot_is_published_and_told_of(ros, fleet):
    answer = fleet.plan()
    task, starts = RobotFormation().task, set()
    for k, name in enumerate(ROBOTS):
        plan, start = fleet.motion(name)
        starts.add(start)
        np.testing.assert_allclose(plan.states[-1, :2], task.goal[k], atol=5e-3)
        np.testing.assert_allclose(plan.states[0, :2], task.start[k], atol=1e-12)
        turned = math.remainder(plan.states[-1, 4] - task.goal_yaw[k], math.tau)
        assert turned == pytest.approx(0, abs=0.01)
        path = fleet.paths[name][-1]
        assert path.header.frame_id == fleet.motions[name][-1].header.frame_id == 'arena'
        assert len(path.poses) == plan.times.size
    assert len(starts) == 1
    markers = fleet.latched('markers').markers
    assert {marker.ns for marker in markers} >= {'limit', 'planned_path', 'goal', 'reach'}
    summary = json.loads(fleet.latched('plan_summary').data)
    assert summary['plan_id'] == answer['plan_id']
    assert sum(summary['cost_terms'].values()) == pytest.approx(summary['cost'])
    assert list(summary['vehicles']) == ROBOTS
    check = summary['verification']
    assert set(check['worst']) == set(check['worst_times']) == set(check['units'])
    assert {'robot1.walls', 'separation robot1-robot3'} <= set(check['worst'])
    planned = RobotFormation.from_parameters(summary['parameters']).task
    np.testing.assert_array_equal([*planned.goal, *planned.start], [*task.goal, *task.start])


def test_the_measured_state_of_every_robot_is_needed(fleet):
    fleet.set('planner', start__source='measured')
    for known in (0, 2, 3):
        for k, name in enumerate(ROBOTS[:known]):
            fleet.measure(name, [1.0 + k, 0.5, 0.0, 0.0, 0.3, 0.0, 0.0])
        if known < 3:
            code, reason = fleet.refusal()
            assert code == 'NO_STATE'
            assert [name for name in ROBOTS if f"'{name}'" in reason] == ROBOTS[known:]
    fleet.plan()
    assert fleet.motions['robot2'][-1].points[0].positions[0] == pytest.approx(2.0)
    fleet.set('planner', start__source='parameters')


def test_robots_with_names_of_their_own_are_told_when_their_state_is_missing(ros):
    names = ['-p', 'robots:=[alice, bob]', '-p', 'formation.bob:=[-0.4, 0.0, 0.0]']
    given = {**FORMATION, 'formation.alice': [0.4, 0.0, 0.0]}
    space = Space(ros)
    space.start('planner', given, names)
    code, reason = space.refusal()
    assert code == 'NO_STATE'
    assert all(f"robot '{name}'" in reason for name in ('alice', 'bob'))


def test_robots_are_planned_for_anew_when_the_formation_moves(ros):
    parameters = {'start.source': 'parameters', 'replan.rate': 5.0, 'replan.delay': 1.5}
    fleet = Fleet(ros, 'fleet', **parameters)
    fleet.plan()
    plans = {name: fleet.motion(name) for name in ROBOTS}
    under_way = plans['robot1'][1] + 1_500_000_000

    follow = partial(fleet.follow, plans)
    assert ros.publish_until(follow, lambda: ros.now >= under_way, every=0.05)
    assert fleet.count() == 1  # followed, it is kept
    fleet.set('planner', formation__anchor=MOVED)
    assert ros.publish_until(follow, lambda: fleet.count() > 1, every=0.05)
    goals = RobotFormation.from_parameters({'formation.anchor': MOVED}).task.goal
    for name, goal in zip(ROBOTS, goals, strict=True):
        new, start = fleet.motion(name)
        np.testing.assert_allclose(new.states[-1, :2], goal, atol=5e-3)
        old, before = plans[name]
        expected = old.sample((start - before) * 1e-9).state
        np.testing.assert_allclose(new.states[0], expected, atol=0.02)
