# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Planned messages against the rules of ros2_control's controllers and hardware, as documented.

Of joint_trajectory_controller: "validation of trajectories"; of the hardware interface
joint_state_topic_hardware_interface: its two topics.
"""

from __future__ import annotations

import itertools
import math
import re
from typing import Any
from xml.etree import ElementTree

import pytest
from ros_harness import SOURCE
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import plan_message, to_stamp
from tdm_planner.nodes.reading import read_command, read_state
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.problems import PendulumSwingUp
from trajectory_msgs.msg import JointTrajectory
import yaml

PAGE = (SOURCE / 'docs' / 'hardware.md').read_text(encoding='utf-8')
SECOND = 1_000_000_000


def block(language: str) -> str:
    """Return the one code block of the page that is in a language."""
    (text,) = re.findall(rf'^```{language}\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE)
    return text


def seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


@pytest.fixture(
    scope='module', params=[(0.09, 'switching'), (0.02, 'switching'), (0.2, 'smooth')], ids=str
)
def planned(request: pytest.FixtureRequest) -> JointTrajectory:
    torque, method = request.param
    values = {'limits.torque': torque, 'method': method, 'solver.deadline': 10.0}
    problem = PendulumSwingUp.from_parameters(values)
    plan = problem.solve().trajectory
    if plan.rates is None:
        plan = plan.with_rates(problem.plant.derivative)
    return plan_message(PENDULUM, plan, to_stamp(100 * SECOND))


def test_a_joint_trajectory_controller_takes_what_is_planned(
    planned: JointTrajectory, request: pytest.FixtureRequest
):
    """Times increase, all quantities are given for all joints, and it ends at rest."""
    parameters = controller()
    assert sorted(parameters['joints']) == sorted(planned.joint_names)
    assert parameters['interpolation_method'] == 'none'
    assert (parameters['command_joints'], parameters['command_interfaces']) == (
        ['disk'],
        ['effort'],
    )
    assert seconds(planned.header.stamp) == 100.0
    times = [seconds(point.time_from_start) for point in planned.points]
    assert all(after > before for before, after in itertools.pairwise(times))
    for point in planned.points:
        for values in (point.positions, point.velocities, point.accelerations, point.effort):
            assert len(values) == 2
            assert all(map(math.isfinite, values))
        assert point.effort[0] == 0.0
    last = planned.points[-1]
    assert list(last.velocities) == [0.0, 0.0]
    # the last point is kept: of a torque that switches nothing is to be left
    if request.node.callspec.params['planned'][1] == 'switching':
        assert list(last.effort) == [0.0, 0.0]
    assert last.positions[1] == pytest.approx(0.0, abs=1e-4)


def controller() -> dict[str, Any]:
    return dict(yaml.safe_load(block('yaml'))['swing_up']['ros__parameters'])


def hardware() -> list[dict[str, dict[str, list[str]]]]:
    """Return the page's ros2_control components: interfaces of the joints of each."""
    return [
        {
            str(joint.get('name')): {
                kind: [str(item.get('name')) for item in joint.findall(f'{kind}_interface')]
                for kind in ('command', 'state')
            }
            for joint in component.findall('joint')
        }
        for component in ElementTree.fromstring(block('xml')).findall('ros2_control')
    ]


def sent_by(component: dict[str, dict[str, list[str]]], effort: float) -> JointState:
    """Return a command as topic hardware sends it: all names, values where there is a command."""
    commanded = [name for name, found in component.items() if 'effort' in found['command']]
    return JointState(name=list(component), effort=[effort for _ in commanded])


def test_topic_hardware_understands_the_states_it_gets():
    """Its state interfaces are fields of joint_states, joints found by name in any order."""
    joints = [item for component in hardware() for item in component.items()]
    assert sorted(name for name, _ in joints) == sorted(joint.name for joint in PENDULUM.joints)
    for _, interfaces in joints:
        assert set(interfaces['state']) <= {'position', 'velocity', 'effort'}
    state = JointState(
        name=['disk', 'another', 'pendulum'], position=[1.0, 9.0, 2.0], velocity=[3.0, 9.0, 4.0]
    )
    assert read_state(PENDULUM, state).tolist() == [2.0, 1.0, 4.0, 3.0]


def test_plant_obeys_the_commands_that_topic_hardware_and_tracker_send():
    motor, encoder = hardware()
    assert read_command(PENDULUM, sent_by(motor, 0.01)).tolist() == [0.01]
    # As one component the two joints would send a command that nobody can read for sure.
    with pytest.raises(InvalidProblem, match='1 values for 2 named joints'):
        read_command(PENDULUM, sent_by({**motor, **encoder}, 0.01))
