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

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from ros_harness import SOURCE
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import command_message, plan_message, to_stamp
from tdm_planner.nodes.reading import nanoseconds_of, read_command, read_joints
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.problems import PendulumSwingUp
import yaml

PAGE = (SOURCE / 'docs' / 'hardware.md').read_text(encoding='utf-8')


def block(language: str) -> str:
    """Return the one code block of the page that is in a language."""
    (text,) = re.findall(rf'^```{language}\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE)
    return text


@pytest.mark.parametrize(
    ('torque', 'method'), [(0.09, 'switching'), (0.02, 'switching'), (0.2, 'smooth')]
)
def test_a_joint_trajectory_controller_takes_what_is_planned(torque: float, method: str) -> None:
    """Times increase, all quantities are given for all joints, and it ends at rest."""
    values = {'limits.torque': torque, 'method': method, 'solver.deadline': 10.0}
    problem = PendulumSwingUp.from_parameters(values)
    plan = problem.solve().trajectory
    if plan.rates is None:
        plan = plan.with_rates(problem.plant.derivative)
    planned = plan_message(PENDULUM, plan, to_stamp(100 * 10**9))
    parameters = yaml.safe_load(block('yaml'))['swing_up']['ros__parameters']
    assert sorted(parameters['joints']) == sorted(planned.joint_names)
    wanted = {'interpolation_method': 'none', 'command_joints': ['disk']}
    assert parameters.items() >= {**wanted, 'command_interfaces': ['effort']}.items()
    assert nanoseconds_of(planned.header.stamp) == 100 * 10**9
    times = [nanoseconds_of(point.time_from_start) for point in planned.points]
    assert times == sorted({*times})
    for point in planned.points:
        for given in (point.positions, point.velocities, point.accelerations, point.effort):
            assert len(given) == 2
            assert np.isfinite(given).all()
        assert point.effort[0] == 0.0
    last = planned.points[-1]
    assert list(last.velocities) == [0.0, 0.0]
    # the last point is kept: of a torque that switches nothing is to be left
    assert method != 'switching' or list(last.effort) == [0.0, 0.0]
    assert last.positions[1] == pytest.approx(0.0, abs=1e-4)


Component = dict[str, dict[str, list[str]]]  # kinds and names of the interfaces, by joint


def hardware() -> list[Component]:
    """Return the page's ros2_control components."""
    found: list[Component] = []
    for component in ElementTree.fromstring(block('xml')).iterfind('ros2_control'):
        found.append({})
        for joint in component.iterfind('joint'):
            kinds = {kind: joint.iterfind(f'{kind}_interface') for kind in ('command', 'state')}
            names = {kind: [item.attrib['name'] for item in all_] for kind, all_ in kinds.items()}
            found[-1][joint.attrib['name']] = names
    return found


def test_topic_hardware_and_nodes_understand_each_other() -> None:
    """State interfaces are fields of joint_states; commands have all names, values for some."""
    motor, encoder = hardware()
    both = {**motor, **encoder}
    assert sorted(both) == sorted(joint.name for joint in PENDULUM.joints)
    for interfaces in both.values():
        assert set(interfaces['state']) <= {'position', 'velocity', 'effort'}
    state = JointState(
        name=['disk', 'another', 'pendulum'], position=[1.0, 9.0, 2.0], velocity=[3.0, 9.0, 4.0]
    )
    read_states = read_joints(PENDULUM.measured, state, PENDULUM.state_names)
    assert read_states == {'theta': 2.0, 'psi': 1.0, 'theta_dot': 4.0, 'psi_dot': 3.0}

    def read(component: Component) -> list[float]:
        commanded = [name for name, found in component.items() if 'effort' in found['command']]
        sent = JointState(name=list(component), effort=[0.01 for _ in commanded])
        return list(read_command(PENDULUM, sent))

    assert read(motor) == [0.01]
    # As one component the two joints would send a command that nobody can read for sure.
    with pytest.raises(InvalidProblem, match='1 values for 2 named joints'):
        read(both)
    message = command_message(PENDULUM, np.array([0.012]))
    assert (list(message.name), list(message.effort)) == (['disk'], [0.012])
