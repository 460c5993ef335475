# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nodes as processes of their own: signals, exit codes, a solve under way when they end."""

from __future__ import annotations

import os
from pathlib import Path
import signal
from typing import Any

import pytest
from ros_harness import NodeProcess, Ros
from std_srvs.srv import Trigger

NODES: dict[str, dict[str, Any]] = {
    'tdm_planner.nodes.planner': {},
    'tdm_planner.nodes.tracker': {'kind': 'robot'},
    'tdm_sim.pendulum_plant': {},
}
SLOW = """
import time
from dataclasses import dataclass
from typing import ClassVar
from tdm_planner.problems import PendulumSwingUp

@dataclass(frozen=True)
class Slow(PendulumSwingUp):
    name: ClassVar[str] = 'slow'
    def solve(self, *args, **kwargs):
        time.sleep(60.0)
"""


def begun(process: NodeProcess) -> bool:
    """Whether the package has been imported: SIGTERM is handled, which Python does not do."""
    status = Path(f'/proc/{process.process.pid}/status')
    (line,) = (line for line in status.read_text().splitlines() if line.startswith('SigCgt'))
    return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def says_nothing_of_python(process: NodeProcess) -> None:
    assert 'Traceback' not in process.output, process.output
    assert 'fatal' not in process.output, process.output


@pytest.mark.parametrize('module', NODES)
def test_a_signal_ends_a_node_with_code_0_however_early_it_comes(ros: Ros, module: str) -> None:
    process = ros.start(module, NODES[module])
    assert ros.spin_until(lambda: begun(process), 20.0), process.output
    assert process.end(signal.SIGINT) == 0, process.output
    says_nothing_of_python(process)
    space = f'/{module.rpartition(".")[2]}_later'
    process = ros.start(module, NODES[module], namespace=space)
    known = ros.node.get_node_names_and_namespaces
    assert ros.spin_until(lambda: space in dict(known()).values(), 20.0), process.output
    assert process.end(signal.SIGTERM) == 0, process.output
    says_nothing_of_python(process)


def test_a_solve_under_way_does_not_hold_the_end_up(ros: Ros, tmp_path: Path) -> None:
    (tmp_path / 'slow_problem.py').write_text(SLOW)
    metadata = tmp_path / 'slow_problem-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: slow\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text('[tdm_planner.problems]\nslow=slow_problem:Slow\n')
    path = os.pathsep.join([str(tmp_path), ros.environment['PYTHONPATH']])
    process = ros.start(
        'tdm_planner.nodes.planner',
        {'problem': 'slow', 'start.source': 'parameters'},
        environment={'PYTHONPATH': path},
    )
    ros.request('plan', Trigger)
    assert ros.spin_until(lambda: ros.trigger('plan')[1]['code'] == 'BUSY')
    assert process.end() == 0
    says_nothing_of_python(process)


@pytest.mark.parametrize(
    ('problem', 'file', 'code'),
    [('pendulum_swingup', '', 2), ('pendulum_swing_up', '/nowhere.yaml', 1)],
)
def test_what_cannot_be_is_one_sentence_and_a_code(
    ros: Ros, problem: str, file: str, code: int
) -> None:
    arguments = ['--params-file', file] if file else []
    process = ros.start('tdm_planner.nodes.planner', {'problem': problem}, arguments=arguments)
    assert process.process.wait(30.0) == code
    last = process.output.splitlines()[-1]
    assert last.startswith('fatal: ')
    assert (file or problem) in last
    assert 'Traceback' not in process.output
