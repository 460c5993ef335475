# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What kind of process this is, told from its command line, and which ROS it would load."""

from __future__ import annotations

from pathlib import Path
import sys

import pytest
from tdm_planner import starting

RECORD = ['tdm', 'record', '-o', 'bag']


@pytest.mark.parametrize(
    ('line', 'command', 'node'),
    [
        ('python -m tdm_planner.cli record -o bag', RECORD, False),
        ('python /opt/bin/tdm record -o bag', RECORD, False),
        ('python /opt/bin/other record', [], False),
        ('python -m pytest record', [], False),
        ('python -m pytest planner', [], False),
        ('python -m nav.planner', [], False),
        ('python -c 1', [], False),
        ('python -m tdm_planner.nodes.planner --ros-args', [], True),
        ('python -X dev -m tdm_sim.robot_plant', [], True),
        ('python -m tdm_sim.stated_plant', [], True),
        ('python /opt/lib/tdm_planner/tracker', [], True),
    ],
)
def test_processes_of_ones_own_are_told_from_others(
    line: str, command: list[str], node: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = line.split()
    monkeypatch.setattr('sys.orig_argv', words)
    monkeypatch.setattr('sys.argv', words[1:] if words[1][0] == '/' else ['-m'])
    assert starting.command() == command
    assert starting.is_node() is node


@pytest.mark.parametrize('wheels', [True, False])
def test_wheels_beside_a_sourced_installation_are_refused(
    wheels: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'opt/ros/lib/python3.12/site-packages/rclpy').mkdir(parents=True)
    (tmp_path / 'workspace').mkdir()
    monkeypatch.setattr(starting, 'find_spec', lambda name: wheels or None)
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')
    starting.require_one_ros()
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/workspace:{tmp_path}/opt/ros')
    if not wheels:
        starting.require_one_ros()
        return
    with pytest.raises(ImportError) as error:
        starting.require_one_ros()
    assert f'{tmp_path}/opt/ros' in str(error.value)
    assert sys.prefix in str(error.value)
