# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the launch files describe, started as launch_ros starts it, and ended by one Ctrl-C."""

from __future__ import annotations

from pathlib import Path
import signal
from typing import Any

from launch_stand_ins import description, ExecuteProcess, Node, stand_ins  # noqa: F401
from nav_msgs.msg import Path as PlannedPath
import pytest
from ros_harness import MODULES, NodeProcess, Ros
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import LATCHED
import yaml


def start(ros: Ros, folder: Path, described: list[Any]) -> list[NodeProcess]:
    """Start what is described; dictionaries of parameters become files for all nodes."""
    started = []
    for k, item in enumerate(described):
        if isinstance(item, ExecuteProcess):
            program, *arguments = item.cmd
            assert Path(program).name == 'tdm'
            started.append(ros.run('tdm_planner.cli', arguments))
        elif isinstance(item, Node) and item.package == 'tdm_planner':
            words = list(item.ros_arguments)
            for parameters in item.parameters:
                file = parameters
                if isinstance(parameters, dict):
                    file = str(folder / f'parameters_{k}.yaml')
                    document = {'/**': {'ros__parameters': parameters}}
                    Path(file).write_text(yaml.safe_dump(document))
                words += ['--params-file', file]
            module = MODULES[item.executable]
            started.append(ros.start(module, namespace=item.namespace, arguments=words))
    return started


def end(processes: list[NodeProcess]) -> None:
    """Ctrl-C reaches all at once, and again those that launch finds still running."""
    for process in processes:
        assert process.running, process.output
        process.process.send_signal(signal.SIGINT)
    for process in processes:
        process.end_cleanly()


@pytest.mark.usefixtures('stand_ins')
def test_four_robots_are_launched_planned_for_recorded_and_ended(ros: Ros, tmp_path: Path):
    bag = tmp_path / 'bag'
    described = description('robots.launch.py').started(
        number_of_robots='4', namespace='hall', record='true', bag=str(bag)
    )
    processes = start(ros, tmp_path, described)
    assert len(processes) == 10  # planner, recorder, four plants, four trackers
    reasons = ros.set_parameters('/hall/planner', solver__deadline=30.0, start__delay=31.0)
    reasons += ros.set_parameters('/hall/planner', start__max_age=10.0)
    assert reasons == ['', '', '']
    states = ros.subscribe('/hall/robot4/joint_states', JointState)
    assert ros.spin_until(lambda: bool(states), 30.0)
    paths = ros.subscribe('/hall/robot4/path', PlannedPath, LATCHED)
    done, answer = ros.trigger('/hall/plan', 60.0)
    assert done, answer
    assert answer['summary'].startswith('4 robots')
    assert ros.spin_until(lambda: bool(paths))
    # The recorder may be the last of ten to have started; without a bag it ends without one.
    assert ros.spin_until(lambda: any(bag.glob('*.mcap')), 30.0)
    end(processes)
    assert (bag / 'metadata.yaml').is_file()


@pytest.mark.usefixtures('stand_ins')
def test_a_pendulum_without_its_plant_waits_for_the_real_one(ros: Ros, tmp_path: Path):
    described = description('pendulum.launch.py').started(plant='false', namespace='rig')
    processes = start(ros, tmp_path, described)
    assert len(processes) == 2
    commands = ros.subscribe('/rig/joint_command', JointState)
    done, answer = ros.trigger('/rig/plan')
    assert not done
    assert answer['code'] == 'NO_STATE'
    assert ros.spin_until(lambda: bool(commands), 30.0)
    assert list(commands[-1].effort) == [0.0]
    end(processes)
