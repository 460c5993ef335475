# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Which sections of a parameter file a node takes: `ros_parameters` and rcl are of one opinion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.node import Node
from ros_harness import Ros
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import parse_yaml
from tdm_planner.parameters import ros_parameters
import yaml

OF_RCLPY = {'use_sim_time', 'start_type_description_service'}


def section(value: int) -> dict[str, Any]:
    return {'ros__parameters': {'a': {'b': value}}}


DOCUMENTS: list[dict[str, Any]] = [
    {'planner': section(1)},
    {'/planner': section(1)},
    {'/**/planner': section(1)},
    {'/pendulum/planner': section(1)},
    {'pendulum/planner': section(1)},
    {'/other/planner': section(1)},
    {'/other/planner': section(1), '/pendulum/planner': section(2)},
    {'/pendulum/planner': section(1), '/**/planner': section(2)},
    {'/**/planner': section(1), '/pendulum/planner': section(2)},
    {'/*/planner': section(1)},
    {'/*/*/planner': section(1)},
    {'/pendulum/*': section(1)},
    {'/pendulum/**': section(1)},
    {'/pendulum/planner/**': section(1)},
    {'/**/pendulum/**/planner': section(1)},
    {'/**': section(1)},
    {'**': section(1)},
    {'/*': section(1)},
    {'/pendulum': {'planner': section(1)}},
    {'/pendulum/': {'planner': section(1)}},
    {'pendulum': {'planner': section(1), 'tracker': section(2)}},
    {'/**': {'planner': section(1)}},
    {'/**': {'planner': section(1), **section(2)}},
    {'/hall': {'pendulum': {'planner': section(1)}}},
]


def taken_by_rcl(ros: Ros, file: Path, namespace: str) -> Mapping[str, Any]:
    """Return the parameters that a node `planner` gets from a file."""
    context = rclpy.Context()
    arguments = ['--ros-args', '--params-file', str(file)]
    rclpy.init(args=arguments, context=context, domain_id=ros.domain)
    try:
        node = Node(
            'planner',
            namespace=namespace,
            context=context,
            automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False,
            enable_rosout=False,
        )
        # rclpy declares that these are values.
        found: dict[str, Any] = node.get_parameters_by_prefix('')
        node.destroy_node()
    finally:
        context.try_shutdown()
    return {name: item.value for name, item in found.items() if name not in OF_RCLPY}


@pytest.mark.parametrize('document', DOCUMENTS, ids=str)
def test_sections_are_matched_as_rcl_does(
    document: dict[str, Any], ros: Ros, tmp_path: Path
) -> None:
    file = tmp_path / 'some.yaml'
    file.write_text(yaml.safe_dump(document, sort_keys=False))
    for namespace in ('/pendulum', '/', '/hall/pendulum'):
        read = parse_yaml(file.read_text())
        taken = ros_parameters(read, 'planner', namespace, required=False)
        assert taken == taken_by_rcl(ros, file, namespace), namespace


@pytest.mark.parametrize(
    ('namespace', 'full_name'),
    [('pendulum', '/pendulum/planner'), ('/a/b/', '/a/b/planner'), ('', '/planner')],
)
def test_who_has_no_section_is_told_the_full_names(namespace: str, full_name: str) -> None:
    document = {'/other/planner': section(1), 'tracker': section(1)}
    with pytest.raises(InvalidProblem) as refused:
        ros_parameters(document, 'planner', namespace)
    assert str(refused.value).endswith(f"'{full_name}', only for /other/planner, /tracker")
