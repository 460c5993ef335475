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

import os
from pathlib import Path
from typing import Any

import pytest
from ros_harness import Ros, SOURCE
from tdm_planner.parameter_files import ros_parameters
from tdm_planner.problems import PendulumSwingUp, Problem, RobotFormation
import yaml

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


def test_generated_anew_nothing_differs(ros: Ros):
    """Parameter files, views, descriptions, the policy, the tables of the pages: `make config`."""
    generate = pytest.importorskip('tools.generate')
    before = dict(os.environ)
    wanted = generate.generated()
    assert dict(os.environ) == before  # or nodes of later tests would not find each other
    assert {path: path.read_text(encoding='utf-8') for path in wanted} == wanted


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_nodes_agree_on_plant_and_limits(path: Path):
    """Parameter files cannot share values: what stands twice must be the same."""
    nodes = sections(path)
    for name, value in nodes['planner'].items():
        if name.startswith(('plant.', 'limits.')):
            assert all(other.get(name, value) == value for other in nodes.values()), name


def test_ros2_param_dump_can_nest_every_name():
    """It fails where a parameter is also the group of another."""
    parameters = pytest.importorskip('tools.node_tables').parameters_by_node()
    for node, names in parameters.items():
        groups = {name[:k] for name in names for k, letter in enumerate(name) if letter == '.'}
        assert not groups & set(names), node


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_ros_reads_the_same_values_in_every_namespace(path: Path, ros: Ros):
    from rclpy.node import Node

    for token in yaml.scan(path.read_text(encoding='utf-8')):
        assert not isinstance(token, yaml.AliasToken | yaml.AnchorToken | yaml.TagToken)
    for name, expected in sections(path).items():
        for namespace in ('/', '/robots/robot1'):
            node = Node(
                name,
                namespace=namespace,
                context=ros.node.context,
                cli_args=['--ros-args', '--params-file', str(path)],
                automatically_declare_parameters_from_overrides=True,
                start_parameter_services=False,
                enable_rosout=False,
            )
            read = {key: node.get_parameter(key).value for key in expected}
            node.destroy_node()
            plain = {k: list(v) if hasattr(v, 'tolist') else v for k, v in read.items()}
            assert plain == expected, namespace
