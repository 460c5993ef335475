# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the launch files describe, started as launch_ros starts it, and ended by one Ctrl-C."""

from pathlib import Path
import signal

from launch_stand_ins import described, ExecuteProcess, stand_ins  # noqa: F401
import pytest
from ros_harness import MODULES, NodeProcess, Ros, ros_arguments
import yaml

pytestmark = pytest.mark.usefixtures('stand_ins')


def start(ros: Ros, folder: Path, items: list) -> list[NodeProcess]:
    """Start what is described; dictionaries of parameters become files."""
    started: list[NodeProcess] = []
    for item in items:
        if isinstance(item, ExecuteProcess):
            program, *arguments = item.cmd
            assert Path(program).name == 'tdm'
            started.append(ros.run('tdm_planner.cli', arguments))
        elif item.package == 'tdm_planner':
            words = [*ros_arguments({}, item.namespace), *item.ros_arguments]
            for file in item.parameters:
                if isinstance(file, dict):
                    document = {'/**': {'ros__parameters': file}}
                    file = folder / f'parameters_{len(started)}.yaml'
                    file.write_text(yaml.safe_dump(document))
                words += ['--params-file', str(file)]
            started.append(ros.run(MODULES[item.executable], words))
    return started


def test_two_robots_are_launched_planned_for_recorded_and_ended(ros, tmp_path):
    bag = tmp_path / 'bag'
    asked = {'number_of_robots': '2', 'namespace': 'hall', 'record': 'true', 'bag': str(bag)}
    items = described('robots').started(**asked)
    processes = start(ros, tmp_path, items)
    assert len(processes) == 6  # planner, recorder, two plants, two trackers
    patient = {'solver.deadline': 30.0, 'start.delay': 31.0, 'start.max_age': 10.0}
    assert not any(ros.set_parameters('/hall/planner', patient))
    states = ros.subscribe('/hall/robot2/joint_states')
    assert ros.spin_until(lambda: bool(states))
    done, answer = ros.trigger('/hall/plan')
    assert done, answer
    assert answer['summary'].startswith('2 robots')
    # Without anything recorded a recorder ends without a bag.
    assert ros.spin_until(lambda: any(bag.glob('*.mcap')))
    for process in processes:
        assert process.running, process.output
        process.process.send_signal(signal.SIGINT)
    for process in processes:
        assert process.process.wait(60.0) == 0, process.output
        assert 'Traceback' not in process.output, process.output
    assert (bag / 'metadata.yaml').is_file()
