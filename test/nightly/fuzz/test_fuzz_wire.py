# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Simulated plants, and planners on the topics between nodes: nasty messages end none of them."""

from __future__ import annotations

import math
from typing import Any

from fuzz_messages import fill
from fuzz_profiles import cases
from fuzz_strategies import joint_trajectories, robot_plans
from hypothesis import given
from hypothesis import strategies as st
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.planning import CODES
from tdm_planner.parameters import specifications
from tdm_sim.pendulum_plant import PendulumPlantParameters
from tdm_sim.robot_plant import RobotPlantParameters
from test_fuzz_nodes import check_alive
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

FORGED = 'a\n[ERROR] [1.0] [forged]: as if the node had said it'
BIG = 1.7976931348623157e308
SPACES = {'pendulum': 'pendulum', 'robot': 'robots/robot1'}
PLANTS = {
    'pendulum': ('/pendulum/pendulum_plant', PendulumPlantParameters),
    'robot': ('/robots/robot1/robot_plant', RobotPlantParameters),
}
# Commands that can be followed: what the plants are fuzzed with must not keep them from it.
RIGHT: dict[str, dict[str, Any]] = {
    'pendulum': {'name': ['disk'], 'effort': [0.0125]},
    'robot': {
        'name': ['thruster', 'reaction_wheel'],
        'velocity': [0.0, 0.0],
        'effort': [0.25, 0.0125],
    },
}
NAMES: list[list[str]] = [
    [], ['disk'], ['thruster', 'reaction_wheel'], ['reaction_wheel', 'thruster', 'disk'],
    ['disk', 'disk'], ['thruster', 'thruster', 'reaction_wheel'], ['Disk', ' disk', 'disk '],
    [''], [FORGED], ['x' * 100_000, FORGED * 1000], ['disk', FORGED], ['é', '<script>', '%s%n'],
    [str(k) for k in range(2000)],
]  # fmt: skip
VALUES = [math.nan, math.inf, -math.inf, 1e308, -1e308, BIG, 5e-324, -0.0]
COMMANDS: list[dict[str, Any]] = [
    {'name': names, 'velocity': [0.0] * count, 'effort': [0.0] * count}
    for names in NAMES
    for count in {0, 1, len(names), len(names) + 1}
] + [
    {'name': names, 'position': [x], 'velocity': [x] * len(names), 'effort': [x] * len(names)}
    for names in (['disk'], ['thruster', 'reaction_wheel'])
    for x in VALUES
]
KINDS = {
    'nothing': ParameterValue(type=0),
    'yes': ParameterValue(type=1, bool_value=True),
    'integer': ParameterValue(type=2, integer_value=-(2**63)),
    'not a number': ParameterValue(type=3, double_value=math.nan),
    'infinite': ParameterValue(type=3, double_value=math.inf),
    'large': ParameterValue(type=3, double_value=1e308),
    'negative': ParameterValue(type=3, double_value=-1.0),
    'smallest': ParameterValue(type=3, double_value=5e-324),
    'text': ParameterValue(type=4, string_value=FORGED),
    'bytes': ParameterValue(type=5, byte_array_value=[b'\x00', b'\xff']),
    'flags': ParameterValue(type=6, bool_array_value=[True]),
    'integers': ParameterValue(type=7, integer_array_value=[2**63 - 1]),
    'numbers': ParameterValue(type=8, double_array_value=[math.nan, 1e308]),
    'texts': ParameterValue(type=9, string_array_value=['', FORGED]),
    'of no type': ParameterValue(type=99, double_value=1.0),
}
SUMMARIES = [
    '', 'null', 'x', '[]', '"stamp"', '{}', '1e400', '9' * 5000, '[' * 100_000,
    '{"stamp":' * 20_000, '{"stamp": []}', '{"stamp": null}', '{"stamp": "now"}',
    '{"stamp": {"sec": 1e400, "nanosec": 0}}', '{"stamp": {"sec": -1e400, "nanosec": 0}}',
    '{"stamp": {"sec": NaN, "nanosec": NaN}}', '{"stamp": {"sec": Infinity, "nanosec": 1}}',
    '{"stamp": {"sec": [1], "nanosec": {}}}', '{"stamp": {"sec": "1", "nanosec": "x"}}',
    '{"stamp": {"sec": true, "nanosec": null}}', '{"stamp": {"sec": 1}}',
    '{"stamp": {"sec": 1e300, "nanosec": 1e300}}', '{"stamp": {"sec": -1e300, "nanosec": 0}}',
    '{"stamp": {"sec": ' + '9' * 4000 + ', "nanosec": 0}}',
    '{"stamp": {"sec": 9223372036854775808, "nanosec": -1}}',
    '{"stamp": {"sec": 2147483648, "nanosec": 4294967296}, "problem": [[[]]]}',
    '{"stamp": {"sec": 0, "nanosec": 0}, "stamp": {"sec": 1, "nanosec": []}}',
    '\ufeff{"stamp": {"sec": 1, "nanosec": 0}}', '{"\\ud800": 1, "stamp": {"sec": "\\ud800"}}',
]  # fmt: skip
# What is possible for an active node is 4 (deactivate) and 7 (shut down) by number.
IMPOSSIBLE = [
    Transition(id=number, label='')
    for number in (0, 1, 2, 3, 5, 6, 8, 10, 20, 30, 40, 50, 60, 61, 97, 98, 99, 200, 255)
] + [
    Transition(id=number, label=label)
    for number in (0, 4, 7)
    for label in ('take off', 'Deactivate', ' deactivate', '\t', 'é', '%s%n', 'configure')
]
Processes = dict[str, NodeProcess]


@pytest.fixture(scope='module')
def nodes(ros: Ros) -> Processes:
    """Two plants and two planners, which have a plan in force reviewed."""
    planner = {'start.source': 'parameters', 'solver.deadline': 0.1, 'replan.rate': 2.0}
    robots = {'problem': 'robot_formation', 'robots': '[robot1]', **planner}
    start = ros.start
    return {
        'pendulum': start('tdm_sim.pendulum_plant', {}, namespace=SPACES['pendulum']),
        'robot': start('tdm_sim.robot_plant', {}, namespace=SPACES['robot']),
        '/pendulum': start('tdm_planner.nodes.planner', planner, namespace='pendulum'),
        '/robots': start('tdm_planner.nodes.planner', robots, namespace='robots'),
    }


def check_driven(ros: Ros, plant: str) -> None:
    """Check that a plant publishes states of finite numbers, and does what it is told."""
    space = SPACES[plant]
    name, number = RIGHT[plant]['name'][-1], RIGHT[plant]['effort'][-1]
    states = ros.subscribe(f'/{space}/joint_states', JointState)
    command = ros.publisher(f'/{space}/joint_command', JointState)

    def obeys() -> bool:
        command.publish(fill(JointState(), RIGHT[plant]))
        ros.spin_for(0.05)
        return any(
            message.effort[list(message.name).index(name)] == pytest.approx(number)
            for message in states[-3:]
        )

    assert ros.spin_until(obeys, 20.0), states[-1:]
    count = len(states)
    assert ros.spin_until(lambda: len(states) > count + 20, 20.0)
    for message in states[count:]:
        assert all(map(math.isfinite, [*message.position, *message.velocity, *message.effort]))
    ros.node.destroy_publisher(command)


def check_silent(nodes: Processes) -> None:
    """Check that the nodes live, and that nothing was written into the log in their name."""
    check_alive(nodes)
    for process in nodes.values():
        assert not any(line.startswith('[ERROR] [1.0]') for line in process.output.splitlines())


@pytest.mark.parametrize('plant', sorted(PLANTS))
def test_no_command_ends_a_plant(ros: Ros, nodes: Processes, plant: str) -> None:
    """What cannot be followed is ignored, and said; what can be drives the plant as before."""
    publisher = ros.publisher(f'/{SPACES[plant]}/joint_command', JointState)
    for command in COMMANDS:
        publisher.publish(fill(JointState(), command))
        ros.spin_for(0.005)
    for service in ('push', 'reset', 'push', 'reset'):
        answer = ros.call(f'/{SPACES[plant]}/{service}', Trigger)
        assert answer.success
        assert answer.message
    ros.node.destroy_publisher(publisher)
    check_driven(ros, plant)
    assert ros.spin_until(lambda: 'joint_command ignored: ' in nodes[plant].output)
    check_silent(nodes)


@pytest.mark.parametrize('plant', sorted(PLANTS))
def test_no_parameter_ends_a_plant(ros: Ros, nodes: Processes, plant: str) -> None:
    """Every parameter is given values of every kind; with the defaults all is as before."""
    node, parameters = PLANTS[plant]
    known = specifications(parameters)
    taken = 0
    for kind, value in KINDS.items():
        names = [*known, 'use_sim_time_', '', FORGED]
        items = [Parameter(name=name, value=value) for name in names]
        request = SetParameters.Request(parameters=items)
        results = ros.call(f'{node}/set_parameters', SetParameters, request, 60.0).results
        assert len(results) == len(items)
        for name, result in zip(names, results, strict=True):
            assert result.successful or result.reason, (kind, name)
            assert 'internal error' not in result.reason, (kind, name, result.reason)
            assert '\n' not in result.reason, (kind, name)
            assert not (result.successful and kind in ('not a number', 'bytes', 'of no type'))
        taken += sum(result.successful for result in results)
        for service in ('push', 'reset'):
            assert ros.call(f'/{SPACES[plant]}/{service}', Trigger).success, kind
        check_silent(nodes)
    assert taken > 0
    defaults = {name: spec.default for name, spec in known.items() if not spec.read_only}
    for _ in range(2):  # values that depend on one another
        refused = [r for r in ros.set_parameter_mapping(node, defaults) if r]
    assert not refused
    assert ros.call(f'/{SPACES[plant]}/reset', Trigger).success
    check_driven(ros, plant)
    check_silent(nodes)


def check_answers(ros: Ros, space: str) -> None:
    fine, answer = ros.trigger(f'{space}/plan', timeout=20.0)
    assert fine or answer['code'] in CODES
    assert fine or 'internal error' not in answer['reason'], answer


@pytest.mark.parametrize('space', ['/pendulum', '/robots'])
def test_no_summary_ends_a_planner(ros: Ros, nodes: Processes, space: str) -> None:
    """Whoever publishes as planners do may publish anything."""
    check_answers(ros, space)
    publisher = ros.publisher(f'{space}/plan_summary', String, LATCHED)
    for data in SUMMARIES:
        publisher.publish(String(data=data.encode('utf-8', 'ignore').decode()))
        ros.spin_for(0.02)
        check_alive(nodes)
    check_answers(ros, space)
    ros.node.destroy_publisher(publisher)
    check_silent(nodes)


TRAJECTORY, CONTROLS = '/robots/robot1/trajectory_in_force', '/robots/robot1/controls_in_force'


@cases(8)
@given(joints=joint_trajectories(), halves=robot_plans(), again=st.booleans())
def test_no_plan_in_force_ends_a_planner(
    ros: Ros, nodes: Processes, joints: Any, halves: Any, again: bool
) -> None:
    """What trackers are said to follow, from the start of a planner or later, may be anything."""
    messages = {
        '/pendulum/trajectory_in_force': fill(JointTrajectory(), joints),
        TRAJECTORY: fill(MultiDOFJointTrajectory(), halves[0]),
        CONTROLS: fill(JointTrajectory(), halves[1]),
    }
    publishers = []
    for topic, message in messages.items():
        publishers.append(ros.node.create_publisher(type(message), topic, LATCHED))
        publishers[-1].publish(message)
    for space in ('/pendulum', '/robots'):
        for transition in (4, 2, 1, 3) if again else ():
            request = ChangeState.Request(transition=Transition(id=transition))
            assert ros.call(f'{space}/planner/change_state', ChangeState, request).success
    ros.spin_for(1.3 if again else 0.1)  # longer than recovery.GRACE
    for publisher in publishers:
        ros.node.destroy_publisher(publisher)
    check_silent(nodes)


@pytest.mark.parametrize('space', ['/pendulum', '/robots'])
def test_no_request_of_a_transition_ends_a_planner(ros: Ros, nodes: Processes, space: str) -> None:
    """What is not possible in the state, or unknown, is refused, and the node stays active."""
    for transition in IMPOSSIBLE:
        request = ChangeState.Request(transition=transition)
        answer = ros.call(f'{space}/planner/change_state', ChangeState, request)
        assert not answer.success, transition
    assert ros.call(f'{space}/planner/get_state', GetState).current_state.label == 'active'
    check_answers(ros, space)
    check_silent(nodes)


def test_no_label_of_a_transition_forges_the_log(ros: Ros, nodes: Processes) -> None:
    """The last test here: what is in the log stays there."""
    request = ChangeState.Request(transition=Transition(label=FORGED))
    assert not ros.call('/pendulum/planner/change_state', ChangeState, request).success
    assert ros.spin_until(lambda: 'no transition' in nodes['/pendulum'].output)
    check_silent(nodes)
