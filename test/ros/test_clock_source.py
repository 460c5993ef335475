# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A plant that drives `/clock`, and nodes that follow it, over DDS."""

from __future__ import annotations

from pathlib import Path
import re

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from ros_harness import Ros
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of
from tdm_planner.parameter_files import parse_yaml
from tdm_planner.parameters import build, ros_parameters
from tdm_sim.robot_plant import RobotPlantParameters
from trajectory_msgs.msg import JointTrajectory

STEP = 10_000_000  # ns
SOURCE = Path(__file__).resolve().parents[2]


@pytest.fixture(scope='module')
def plant(ros: Ros) -> str:
    parameters = {'publish_clock': True, 'real_time_factor': 0.5, 'rate': 100.0}
    # With use_sim_time as well, as where all nodes are given it, it still is the one that tells.
    ros.start(
        'tdm_sim.pendulum_plant',
        {**parameters, 'command_timeout': 1.0, 'use_sim_time': True},
        namespace='slow',
    )
    return '/slow/pendulum_plant'


def test_the_clock_goes_on_in_whole_steps_and_stamps_are_its_instants(
    ros: Ros, plant: str
) -> None:
    clocks = ros.subscribe('/clock', Clock, 100)
    states = ros.subscribe('/slow/joint_states', JointState, 100)
    assert ros.spin_until(lambda: len(clocks) > 50, 60.0)
    shown = np.array([nanoseconds_of(clock.clock) for clock in clocks])
    steps = np.diff(shown)
    assert (steps > 0).all()
    assert not (steps % STEP).any()
    assert np.median(steps) == STEP
    stamps = np.array([nanoseconds_of(state.header.stamp) for state in states])
    assert not ((stamps - shown[0]) % STEP).any()
    # Half the speed of real time, or less where the computer is busy.
    elapsed = ros.node.get_clock().now().nanoseconds - shown[0]
    assert shown[-1] - shown[0] < 0.75 * elapsed + 10 * STEP


def test_planner_and_tracker_follow_the_clock(ros: Ros, plant: str) -> None:
    tracking = {'use_sim_time': True, 'rate': 100.0, 'state_timeout': 1.0}
    planning = {'use_sim_time': True, 'start.delay': 3.0, 'start.max_age': 5.0}
    ros.start('tdm_planner.nodes.tracker', tracking, namespace='slow')
    ros.start('tdm_planner.nodes.planner', planning, namespace='slow')
    clocks = ros.subscribe('/clock', Clock, 10)
    commands = ros.subscribe('/slow/joint_command', JointState, 10)
    plans = ros.subscribe('/slow/trajectory', JointTrajectory, LATCHED)
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 50)
    assert ros.spin_until(lambda: len(commands) > 5, 60.0)
    assert not (nanoseconds_of(commands[-1].header.stamp) - nanoseconds_of(clocks[0].clock)) % STEP
    before = nanoseconds_of(clocks[-1].clock)
    done, answer = ros.trigger('/slow/plan', timeout=60.0)
    assert done, answer
    assert ros.spin_until(lambda: bool(plans))
    after = nanoseconds_of(clocks[-1].clock)
    start = nanoseconds_of(plans[-1].header.stamp)
    assert before <= start - 3_000_000_000 <= after
    assert ros.spin_until(
        lambda: any(
            status.name == '/slow/tracker: tracking' and status.message.startswith('holding')
            for array in diagnostics
            for status in array.status
        ),
        60.0,
    )


def test_the_speed_may_be_changed_on_the_way(ros: Ros, plant: str) -> None:
    clocks = ros.subscribe('/clock', Clock, 100)
    assert ros.set_parameters(plant, real_time_factor=2.0) == ['']
    clocks.clear()
    assert ros.spin_until(lambda: len(clocks) > 50, 30.0)
    steps = np.diff([nanoseconds_of(clock.clock) for clock in clocks])
    assert (steps > 0).all()
    assert not (steps % STEP).any()


def test_a_second_clock_is_told_of(ros: Ros, plant: str) -> None:
    told = '2 nodes publish /clock: '
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 50)

    def tells(name: str) -> bool:
        """Whether the plant's newest status warns of another clock."""
        texts = [
            status.message
            for array in diagnostics
            for status in array.status
            if status.name == f'{name}: simulation'
        ]
        return bool(texts) and told in texts[-1]

    other = ros.start('tdm_sim.robot_plant', {'publish_clock': True}, namespace='other')
    assert ros.spin_until(lambda: tells(plant) and tells('/other/robot_plant'), 60.0)
    assert told in other.output
    other.end_cleanly()
    assert ros.spin_until(lambda: not tells(plant), 30.0)


def test_one_plant_of_several_drives_the_clock_as_the_page_says() -> None:
    page = (SOURCE / 'docs' / 'nodes' / 'simulated_time.md').read_text(encoding='utf-8')
    (appended,) = re.findall(r'^```yaml\n(.*?)^```$', page, re.DOTALL | re.MULTILINE)
    file = (SOURCE / 'config' / 'robots.yaml').read_text(encoding='utf-8') + appended
    drives = {}
    for robot in ('robot1', 'robot2', 'robot3'):
        values = ros_parameters(parse_yaml(file), 'robot_plant', f'/robots/{robot}')
        drives[robot] = build(RobotPlantParameters, values).publish_clock
    assert drives == {'robot1': True, 'robot2': False, 'robot3': False}
