# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The planner node for robots over real DDS."""

import json
import math

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of
from tdm_planner.nodes.robot_messages import robot_trajectory, to_quaternion
from tdm_planner.problems import RobotFormation
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

MODULE = 'tdm_planner.nodes.planner'
ROBOTS = ['robot1', 'robot2', 'robot3']
SPACE = '/robots'


@pytest.fixture(scope='module')
def planner(ros):
    return ros.start(
        MODULE,
        {'problem': 'robot_formation', 'start.source': 'parameters'},
        namespace=SPACE,
    )


def latched(ros, robot):
    """Return the plan in force of one robot, received by late subscribers."""
    motion = ros.subscribe(f'{SPACE}/{robot}/trajectory', MultiDOFJointTrajectory, LATCHED)
    controls = ros.subscribe(f'{SPACE}/{robot}/controls', JointTrajectory, LATCHED)
    path = ros.subscribe(f'{SPACE}/{robot}/path', Path, LATCHED)
    assert ros.spin_until(lambda: motion and controls and path)
    return motion[-1], controls[-1], path[-1]


def test_a_plan_for_every_robot_is_published(ros, planner):
    success, answer = ros.trigger(f'{SPACE}/plan', timeout=30.0)
    assert success, answer
    assert set(answer) >= {
        'plan_id', 'duration', 'cost', 'penalty', 'solve_time', 'evaluations', 'summary',
    }  # fmt: skip
    task = RobotFormation().task
    starts = set()
    for k, name in enumerate(ROBOTS):
        motion, controls, path = latched(ros, name)
        plan = robot_trajectory(motion, controls, name)
        np.testing.assert_allclose(plan.states[-1, :2], task.goal[k], atol=5e-3)
        np.testing.assert_allclose(plan.states[0, :2], task.start[k], atol=1e-12)
        assert math.remainder(plan.states[-1, 4] - task.goal_yaw[k], 2 * math.pi) == (
            pytest.approx(0, abs=0.01)
        )
        assert path.header.frame_id == motion.header.frame_id == 'arena'
        assert len(path.poses) == plan.times.size
        starts.add(nanoseconds_of(motion.header.stamp))
    assert len(starts) == 1
    markers = ros.subscribe(f'{SPACE}/markers', MarkerArray, LATCHED)
    assert ros.spin_until(lambda: markers)
    assert {m.ns for m in markers[-1].markers} >= {'arena', 'planned_path', 'goal'}


def test_the_summary_tells_of_every_robot(ros, planner):
    success, answer = ros.trigger(f'{SPACE}/plan', timeout=30.0)
    assert success, answer
    received = ros.subscribe(f'{SPACE}/plan_summary', String, LATCHED)
    assert ros.spin_until(lambda: bool(received))
    summary = json.loads(received[-1].data)
    assert summary['plan_id'] == answer['plan_id']
    assert sum(summary['cost_terms'].values()) == pytest.approx(summary['cost'])
    assert list(summary['vehicles']) == ROBOTS
    check = summary['verification']
    assert set(check['worst']) == set(check['worst_times']) == set(check['units'])
    assert {'robot1.walls', 'separation robot1-robot3'} <= set(check['worst'])
    problem = RobotFormation.from_parameters(summary['parameters'])
    np.testing.assert_array_equal(problem.task.goal, RobotFormation().task.goal)
    np.testing.assert_array_equal(problem.task.start, RobotFormation().task.start)


def test_trackers_and_plants_that_are_missing_are_named(ros, planner):
    success, answer = ros.trigger(f'{SPACE}/plan', timeout=30.0)
    assert success
    text = ' '.join(answer['warnings'])
    assert all(f"'{name}'" in text for name in ROBOTS)


def test_the_measured_state_of_every_robot_is_needed(ros, planner):
    assert ros.set_parameters(f'{SPACE}/planner', start__source='measured') == ['']
    try:
        success, answer = ros.trigger(f'{SPACE}/plan')
        assert not success
        assert answer['code'] == 'NO_STATE'
        assert all(name in answer['reason'] for name in ROBOTS)
        publish_states(ros, ROBOTS[:2])
        success, answer = ros.trigger(f'{SPACE}/plan')
        assert not success
        assert 'robot3' in answer['reason']
        assert 'robot1' not in answer['reason']
        publish_states(ros, ROBOTS)
        success, answer = ros.trigger(f'{SPACE}/plan', timeout=30.0)
        assert success, answer
        motion, _, _ = latched(ros, 'robot2')
        assert motion.points[0].transforms[0].translation.x == pytest.approx(2.0)
    finally:
        ros.set_parameters(f'{SPACE}/planner', start__source='parameters')


def publish_states(ros, names):
    """Robots at rest in a row, y = 0.5 m, x = 1, 2, 3 m."""
    publishers = {}
    for name in names:
        publishers[name] = (
            ros.publisher(f'{SPACE}/{name}/odom', Odometry),
            ros.publisher(f'{SPACE}/{name}/joint_states', JointState),
        )
    ages = ros.subscribe('/diagnostics', DiagnosticArray)
    assert ages is not None
    for k, name in enumerate(names):
        odom, joints = publishers[name]
        stamp = ros.node.get_clock().now().to_msg()
        message = Odometry()
        message.header.stamp, message.header.frame_id = stamp, 'arena'
        message.pose.pose.position.x, message.pose.pose.position.y = 1.0 + k, 0.5
        message.pose.pose.orientation = to_quaternion(0.3)
        odom.publish(message)
        state = JointState(name=['thruster', 'reaction_wheel'], position=[0.0, 0.0])
        state.velocity = state.effort = [0.0, 0.0]
        state.header.stamp = stamp
        joints.publish(state)
    ros.spin_for(0.1)


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'robot1.start.x': -0.5}, ['robot1', '-0.5']),
        ({'robot1.start.x': 3.3, 'robot1.start.y': 0.8}, ['robot1', 'robot2']),
        ({'formation.robot1': [9.0, 0.0, 0.0]}, ['robot1']),
        ({'formation.robot1': [-0.2, 0.39, 0.0]}, ['robot1', 'robot2']),
        ({'arena.length': 0.3}, ['arena.length', '0.3']),
        ({'weights.time': 0.0, 'weights.sequence': 0.0, 'weights.gas': 0.0}, ['weights']),
    ],
)
def test_contradictions_are_named_and_the_node_keeps_serving(ros, planner, changes, words):
    node = f'{SPACE}/planner'
    before = RobotFormation.parameter_specifications({})
    assert set(ros.set_parameter_mapping(node, changes)) == {''}
    try:
        success, answer = ros.trigger(f'{SPACE}/plan')
        assert not success
        assert answer['code'] == 'INVALID_PROBLEM'
        assert all(word in answer['reason'] for word in words), answer
    finally:
        ros.set_parameter_mapping(node, {name: before[name].default for name in changes})
    assert ros.trigger(f'{SPACE}/plan', timeout=30.0)[0]


@pytest.mark.parametrize(
    ('name', 'value', 'words'),
    [
        ('arrival_interval', -1.0, ['arrival_interval', '-1', '[0, 1e+12] s']),
        ('weights.gas', -0.1, ['weights.gas', '-0.1']),
        ('arena.minimum_separation', math.nan, ['arena.minimum_separation', 'nan']),
        ('limits.thrust', 0.0, ['limits.thrust', '(0, 1e+12] N']),
        ('robots', ['robot1', 'robot1'], ['robots']),
        ('robot9.start.x', 1.0, ['robot9.start.x', 'unknown']),
    ],
)
def test_values_that_are_not_allowed_are_refused_when_set(ros, planner, name, value, words):
    (reason,) = ros.set_parameter_mapping(f'{SPACE}/planner', {name: value})
    assert all(word in reason for word in words), reason


@pytest.mark.parametrize('robots', ['[]', '[a, a]', '[1st]', '[limits]'])
def test_wrong_names_at_the_start_are_answered(ros, robots):
    node = ros.start(
        MODULE,
        {'problem': 'robot_formation', 'start.source': 'parameters'},
        namespace='/wrong',
        arguments=['-p', f'robots:={robots}'],
    )
    success, answer = ros.trigger('/wrong/plan')
    assert not success
    assert answer['code'] == 'INVALID_PROBLEM'
    assert 'robots' in answer['reason']
    ros.set_parameters('/wrong/planner', solver__deadline=1.0)
    assert not ros.trigger('/wrong/plan')[0]
    node.end_cleanly()


def test_robots_with_names_of_their_own_are_told_when_their_state_is_missing(ros):
    node = ros.start(
        MODULE,
        {'problem': 'robot_formation', 'formation.alice': [0.4, 0.0, 0.0]},
        namespace='/own',
        arguments=['-p', 'robots:=[alice, bob]', '-p', 'formation.bob:=[-0.4, 0.0, 0.0]'],
    )
    success, answer = ros.trigger('/own/plan')
    assert not success
    assert answer['code'] == 'NO_STATE'
    assert "robot 'alice'" in answer['reason']
    assert "robot 'bob'" in answer['reason']
    node.end_cleanly()
