# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is generated from the declarations is up to date, and as ROS reads it."""

from __future__ import annotations

import json
from pathlib import Path
import subprocess
import sys
from typing import Any

import pytest
from tdm_planner.parameters import ros_parameters
from tdm_planner.problems import PendulumSwingUp, Problem, RobotFormation
from tdm_planner.problems.base import problem_parameters
from tools.node_parameters import parameters_by_node
import yaml

SOURCE = Path(__file__).resolve().parents[2]
FILES = sorted((SOURCE / 'config').glob('*.yaml'), key=lambda path: path.name)
PROBLEMS: dict[str, type[Problem]] = {
    'pendulum.yaml': PendulumSwingUp,
    'robots.yaml': RobotFormation,
}


def sections(path: Path) -> dict[str, dict[str, Any]]:
    """Flat parameters of every node in a parameter file, by the node's name."""
    document = yaml.safe_load(path.read_text(encoding='utf-8'))
    nodes = [str(key).rsplit('/', 1)[-1] for key in document]
    return {node: ros_parameters(document, node) for node in nodes}


def test_what_is_generated_is_up_to_date(ros: Any):
    command = [sys.executable, '-m', 'tools.generate', '--check']
    done = subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, f'run: make config\n{done.stdout}\n{done.stderr}'


@pytest.mark.parametrize('name', PROBLEMS)
def test_files_hold_the_defaults_of_the_problem(name: str):
    values = sections(SOURCE / 'config' / name)['planner']
    assert values['problem'] == PROBLEMS[name].name
    checked = problem_parameters(PROBLEMS[name], values)
    for parameter, spec in PROBLEMS[name].parameter_specifications({}).items():
        unset = spec.default in (None, [])
        assert unset or checked[parameter] == spec.default, parameter
    assert PROBLEMS[name].from_parameters(values).name == PROBLEMS[name].name


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_nodes_agree_on_plant_and_limits(path: Path):
    """Parameter files cannot share values: what stands twice must be the same."""
    nodes = sections(path)
    for name, value in nodes['planner'].items():
        if name.startswith(('plant.', 'limits.')):
            assert all(other.get(name, value) == value for other in nodes.values()), name


@pytest.mark.parametrize('node', parameters_by_node())
def test_ros2_param_dump_can_nest_every_name(node: str):
    """``ros2 param dump`` fails where a parameter is also the group of another."""
    names = parameters_by_node()[node]
    groups = {name[:k] for name in names for k, letter in enumerate(name) if letter == '.'}
    assert not groups & set(names)


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_files_keep_to_what_ros_can_parse(path: Path):
    tokens = list(yaml.scan(path.read_text(encoding='utf-8')))
    assert tokens
    for token in tokens:
        assert not isinstance(token, yaml.AliasToken | yaml.AnchorToken | yaml.TagToken)


READ_BY_ROS = """
import json, sys
import rclpy
namespace, name, file = sys.argv[1:]
rclpy.init(args=['--ros-args', '--params-file', file])
node = rclpy.create_node(
    name, namespace=namespace, automatically_declare_parameters_from_overrides=True,
    start_parameter_services=False, enable_rosout=False,
)
parameters = node.get_parameters_by_prefix('')
print(json.dumps({name: item.value for name, item in parameters.items()}, default=list))
node.destroy_node()
rclpy.shutdown()
"""


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_ros_reads_the_same_values_in_every_namespace(path: Path, ros: Any):
    assert ros
    for node, expected in sections(path).items():
        for namespace in ('/', '/pendulum', '/robots/robot1'):
            done = subprocess.run(
                [sys.executable, '-c', READ_BY_ROS, namespace, node, str(path)],
                capture_output=True,
                text=True,
                check=True,
                timeout=60,
            )
            read = json.loads(done.stdout)
            assert expected.items() <= read.items(), namespace
