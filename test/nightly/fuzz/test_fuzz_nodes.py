# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Real planners and trackers under a rain of messages and parameters: they go on serving."""

from __future__ import annotations

import math
from typing import Any

from fuzz_messages import fill
from fuzz_profiles import cases
from fuzz_strategies import (
    anything,
    goal_poses,
    joint_states,
    joint_trajectories,
    odometries,
    parameter_sets,
    quiet_plans,
    robot_plans,
)
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.planning import CODES
from tdm_planner.nodes.tracker import tracker_specifications
from tdm_planner.parameters import specifications
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.request import RequestParameters
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

DEADLINE = 0.1
REQUEST = specifications(RequestParameters)
SPECIFICATIONS = {
    '/pendulum/planner': {**REQUEST, **PendulumSwingUp.parameter_specifications({})},
    '/robots/planner': {**REQUEST, **RobotFormation.parameter_specifications({})},
    '/pendulum/tracker': tracker_specifications('pendulum'),
    '/robots/robot1/tracker': tracker_specifications('robot'),
}
TOPICS: dict[str, tuple[Any, Any, Any]] = {
    '/pendulum/joint_states': (JointState, joint_states(), 10),
    '/pendulum/trajectory': (
        JointTrajectory, st.one_of(joint_trajectories(), quiet_plans('pendulum')), LATCHED,
    ),
    '/robots/robot1/odom': (Odometry, odometries, 10),
    '/robots/robot1/joint_states': (JointState, joint_states(), 10),
    '/robots/robot1/goal_pose': (PoseStamped, goal_poses, 10),
    '/robots/robot1/trajectory': (
        MultiDOFJointTrajectory, robot_plans().map(lambda plan: plan[0]), LATCHED,
    ),
    '/robots/robot1/controls': (
        JointTrajectory, robot_plans().map(lambda plan: plan[1]), LATCHED,
    ),
}  # fmt: skip
TYPES = {bool: 1, int: 2, float: 3, str: 4}


def value_message(value: Any, kind: int | None = None) -> ParameterValue:
    """Return a value as a parameter's message; `kind` claims another type for it."""
    message = ParameterValue(type=0)
    if isinstance(value, bool):
        message = ParameterValue(type=1, bool_value=value)
    elif isinstance(value, int) and abs(value) < 2**63:
        message = ParameterValue(type=2, integer_value=value)
    elif isinstance(value, float):
        message = ParameterValue(type=3, double_value=value)
    elif isinstance(value, str):
        text = value.replace('\x00', '').encode('utf-8', 'ignore').decode()
        message = ParameterValue(type=4, string_value=text)
    elif isinstance(value, list) and all(isinstance(item, float) for item in value):
        message = ParameterValue(type=8, double_array_value=value)
    elif isinstance(value, list) and all(isinstance(item, str) for item in value):
        message = ParameterValue(type=9, string_array_value=value)
    if kind is not None:
        message.type = kind
    return message


@pytest.fixture(scope='module')
def nodes(ros: Ros) -> dict[str, NodeProcess]:
    """Two planners, and two trackers."""
    start = {'start.source': 'parameters', 'solver.deadline': DEADLINE}
    planner, tracker = 'tdm_planner.nodes.planner', 'tdm_planner.nodes.tracker'
    robots = {'problem': 'robot_formation', **start}
    return {
        '/pendulum/planner': ros.start(planner, start, namespace='pendulum'),
        '/robots/planner': ros.start(planner, robots, namespace='robots'),
        '/pendulum/tracker': ros.start(tracker, {}, namespace='pendulum'),
        '/robots/robot1/tracker': ros.start(tracker, {'kind': 'robot'}, namespace='robots/robot1'),
    }


@pytest.fixture(scope='module')
def publishers(ros: Ros, nodes: dict[str, NodeProcess]) -> dict[str, Any]:
    """Return a publisher of every topic that a node listens to."""
    return {
        topic: ros.publisher(topic, message, qos) for topic, (message, _, qos) in TOPICS.items()
    }


def check_alive(nodes: dict[str, NodeProcess]) -> None:
    for name, process in nodes.items():
        assert process.running, f'{name}:\n{process.output[-3000:]}'
        assert 'Traceback' not in process.output, process.output[-3000:]


@st.composite
def requests(draw: Any, node: str) -> list[tuple[str, Any, int | None]]:
    """Parameters to be set: names, values, and for some a type that is another, or none at all."""
    chosen = draw(parameter_sets(SPECIFICATIONS[node]))
    kinds = st.sampled_from([None] * 8 + [0, 3, 5, 7, 10, 99, 255])
    found = [(name, value, draw(kinds)) for name, value in chosen.items()]
    if draw(st.integers(0, 5)) == 0:
        names = st.sampled_from(['use_sim_time', '', 'qos_overrides.a', 'start', 'a b', '.'])
        found.append((draw(names), draw(anything), draw(kinds)))
    # The deadline asked for is kept: it must stay one that a test can wait for.
    return [item for item in found if item[0] not in ('solver.deadline', 'robot_name')]


@st.composite
def parameter_requests(draw: Any) -> tuple[str, bool, list[tuple[str, Any, int | None]]]:
    """Return a node, whether all are set or none, and what is set."""
    node = draw(st.sampled_from(sorted(SPECIFICATIONS)))
    return node, draw(st.booleans()), draw(requests(node))


@cases(30)
@given(data=st.data())
def test_no_message_ends_a_node(
    ros: Ros, nodes: dict[str, NodeProcess], publishers: dict[str, Any], data: Any
) -> None:
    """Messages by the handful on one topic, then on the next."""
    topic = data.draw(st.sampled_from(sorted(TOPICS)))
    kind, strategy, _ = TOPICS[topic]
    for message in data.draw(st.lists(strategy, min_size=1, max_size=3)):
        publishers[topic].publish(fill(kind(), message))
    ros.spin_for(0.02)
    check_alive(nodes)


@cases(30)
@given(request=parameter_requests())
def test_no_parameter_ends_a_node(
    ros: Ros, nodes: dict[str, NodeProcess], request: tuple[str, bool, list[Any]]
) -> None:
    """Parameters of any value and any type; then a plan, or a reason for none, all the same."""
    node, atomically, items = request
    parameters = [
        Parameter(
            name=name.replace('\x00', '').encode('utf-8', 'ignore').decode(),
            value=value_message(value, kind),
        )
        for name, value, kind in items
    ]
    if atomically:
        service, of = f'{node}/set_parameters_atomically', SetParametersAtomically
        results = [ros.call(service, of, of.Request(parameters=parameters)).result]
    else:
        service, of = f'{node}/set_parameters', SetParameters
        results = ros.call(service, of, of.Request(parameters=parameters)).results
        assert len(results) == len(parameters)
    for result in results:
        assert result.successful or result.reason
        assert 'internal error' not in result.reason, (items, result.reason)
    if node.endswith('planner'):
        fine, answer = ros.trigger(f'{node.rsplit("/", 1)[0]}/plan', timeout=10.0)
        if not fine:
            assert answer['code'] in CODES
            assert 'internal error' not in answer['reason'], answer
    check_alive(nodes)


@cases(10)
@given(
    topic=st.sampled_from(['/pendulum/joint_states', '/robots/robot1/odom']),
    data=st.data(),
    delay=st.sampled_from([0.0, 0.2, 1.0, 3600.0]),
    age=st.sampled_from([1e-9, 0.5, 1e12]),
)
def test_a_plan_from_what_was_measured_is_answered(
    ros: Ros,
    nodes: dict[str, NodeProcess],
    publishers: dict[str, Any],
    topic: str,
    data: Any,
    delay: float,
    age: float,
) -> None:
    """Whatever states come in: a plan or one of the codes, in time."""
    kind, strategy, _ = TOPICS[topic]
    publishers[topic].publish(fill(kind(), data.draw(strategy)))
    if kind is Odometry:
        joints = JointState(name=['thruster', 'reaction_wheel'], position=[0.0, 0.0])
        publishers['/robots/robot1/joint_states'].publish(joints)
    space = f'/{topic.split("/")[1]}'
    measured = {'start.source': 'measured', 'start.delay': delay, 'start.max_age': age}
    assert not any(ros.set_parameter_mapping(f'{space}/planner', measured))
    fine, answer = ros.trigger(f'{space}/plan', timeout=10.0)
    if not fine:
        assert answer['code'] in CODES
        assert 'internal error' not in answer['reason'], answer
    check_alive(nodes)


@pytest.mark.parametrize('namespace', ['pendulum', 'robots'])
def test_afterwards_a_planner_plans(
    ros: Ros, nodes: dict[str, NodeProcess], namespace: str
) -> None:
    """With the defaults set again, a request is met as if nothing had been."""
    node = f'/{namespace}/planner'
    defaults = {
        name: spec.default
        for name, spec in SPECIFICATIONS[node].items()
        if not spec.read_only and spec.default is not None
    }
    unset = {
        name: None
        for name, spec in SPECIFICATIONS[node].items()
        if spec.optional and not spec.default
    }
    wanted = {**defaults, **unset, 'start.source': 'parameters', 'solver.deadline': 3.0}
    for _ in range(2):  # values that depend on one another
        refused = [reason for reason in ros.set_parameter_mapping(node, wanted) if reason]
    assert not refused, refused
    fine, answer = ros.trigger(f'/{namespace}/plan')
    assert fine, answer
    check_alive(nodes)


@pytest.mark.parametrize('tracker', ['/pendulum', '/robots/robot1'])
def test_afterwards_a_tracker_commands(
    ros: Ros, nodes: dict[str, NodeProcess], tracker: str
) -> None:
    """Commands go on, all of finite numbers."""
    commands = ros.subscribe(f'{tracker}/joint_command', JointState)
    assert ros.spin_until(lambda: len(commands) > 20)
    assert all(math.isfinite(x) for message in commands for x in message.effort)
    check_alive(nodes)


@pytest.mark.parametrize('kind', [10, 99, 255])
@pytest.mark.parametrize('service', ['set_parameters', 'set_parameters_atomically'])
def test_a_type_that_does_not_exist_is_refused(
    ros: Ros, nodes: dict[str, NodeProcess], kind: int, service: str
) -> None:
    """It once ended the node: rclpy raises out of the callback."""
    of = {'set_parameters': SetParameters, 'set_parameters_atomically': SetParametersAtomically}
    item = Parameter(name='start.psi', value=ParameterValue(type=kind))
    for node in sorted(SPECIFICATIONS):
        request = of[service].Request(parameters=[item])
        response = ros.call(f'{node}/{service}', of[service], request)
        (result,) = getattr(response, 'results', None) or [response.result]
        assert not result.successful
        assert result.reason
    check_alive(nodes)
