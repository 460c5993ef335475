# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nodes write below the ROS log folder, and nowhere else, whatever messages are called."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

from geometry_msgs.msg import PoseStamped
from ros_harness import ENOUGH, NodeProcess, Ros, ros_arguments
from sensor_msgs.msg import JointState

UNHURRIED = {'solver.deadline': ENOUGH}
ROBOTS = {'problem': 'robot_formation', **UNHURRIED}
NODES: dict[str, tuple[str, str, dict[str, Any]]] = {
    'planner': ('tdm_planner.nodes.planner', 'robots', ROBOTS),
    'tracker': ('tdm_planner.nodes.tracker', 'robots/robot1', {'kind': 'robot'}),
    'robot_plant': ('tdm_sim.robot_plant', 'robots/robot1', {}),
    'pendulum_planner': ('tdm_planner.nodes.planner', 'pendulum', UNHURRIED),
    'pendulum_tracker': ('tdm_planner.nodes.tracker', 'pendulum', {}),
    'pendulum_plant': ('tdm_sim.pendulum_plant', 'pendulum', {}),
}


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob('*')}


class ElsewhereProcess(NodeProcess):
    """A node with its working folder elsewhere."""

    def __init__(self, arguments: list[str], environment: dict[str, str], home: Path) -> None:
        module, *rest = arguments
        self.module = module
        self.output_file = Path(tempfile.mkstemp(suffix='.txt')[1])
        with self.output_file.open('w') as output:
            self.process = subprocess.Popen(
                [sys.executable, '-m', module, *rest],
                env=environment,
                cwd=home / 'work',
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )


def test_nodes_write_only_below_the_log_folder(ros: Ros, tmp_path: Path) -> None:
    home = tmp_path / 'home'
    for name in ('work', 'tmp', 'log'):
        (home / name).mkdir(parents=True)
    import os

    environment = {
        **os.environ, **ros.environment,
        'HOME': str(home), 'TMPDIR': str(home / 'tmp'), 'ROS_LOG_DIR': str(home / 'log'),
        'XDG_CACHE_HOME': str(home / 'cache'), 'XDG_CONFIG_HOME': str(home / 'config'),
    }  # fmt: skip
    before = files(home)
    processes = [
        ElsewhereProcess([module, *ros_arguments(parameters, namespace)], environment, home)
        for module, namespace, parameters in NODES.values()
    ]
    try:
        for namespace in ('robots', 'pendulum'):
            ros.set_parameter_mapping(f'/{namespace}/planner', {'start.source': 'parameters'})
            fine, answer = ros.trigger(f'/{namespace}/plan')
            assert fine, answer
        states = ros.publisher('/pendulum/joint_states', JointState)
        goals = ros.publisher('/robots/robot1/goal_pose', PoseStamped)
        for name in ('../../work/owned', str(home / 'owned'), '$(touch owned)', '`touch owned`'):
            state = JointState(name=[name, 'disk'], position=[0.0, 0.0], velocity=[0.0, 0.0])
            state.header.frame_id = name
            states.publish(state)
            goal = PoseStamped()
            goal.header.frame_id = name
            goals.publish(goal)
        ros.spin_for(0.5)
    finally:
        codes = [process.end() for process in processes]
    assert codes == [0] * len(processes)
    written = {name for name in files(home) - before if not name.startswith('log/')}
    assert not written
    assert any(name.startswith('log/') for name in files(home))
