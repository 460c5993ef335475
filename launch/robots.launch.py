# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""One planner for all robots, a tracker for each, and simulated plants unless real ones are there.

Start with ``ros2 launch tdm_planner robots.launch.py rviz:=true``, then ask for a plan with
``ros2 service call /robots/plan std_srvs/srv/Trigger``.

The robots are those that the parameter file's section `planner` names in `robots`; the simulated
ones stand at its `<robot>.start` to begin with.
"""

from pathlib import Path
import tempfile
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from tdm_planner.nodes.robot_nodes import robot_nodes
from tdm_planner.parameters import build, ros_parameters
from tdm_planner.problems.formation_parameters import FormationParameters
from tdm_planner.resources import config_file
from tdm_planner.views.rviz import robots_rviz
import yaml


def start_nodes(context: LaunchContext) -> list[Node]:
    """Describe the nodes, for the arguments of this launch."""

    def argument(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    file, namespace = argument('params_file'), argument('namespace').strip('/')
    document = yaml.safe_load(Path(file).read_text(encoding='utf-8'))
    nodes = robot_nodes(document, namespace)
    simulated = argument('plant') == 'true'
    described = [
        Node(
            package='tdm_planner',
            executable=node.executable,
            namespace='/'.join(part for part in (namespace, node.robot) if part),
            parameters=[file, node.parameters],
            ros_arguments=['--log-level', argument('log_level')],
            output='screen',
        )
        for node in nodes
        if simulated or node.executable != 'robot_plant'
    ]
    if argument('rviz') == 'true':
        described.append(rviz(document, namespace))
    return described


def rviz(document: Any, namespace: str) -> Node:
    """Describe RViz for the robots and the arena that a parameter file has."""
    given = build(FormationParameters, ros_parameters(document, 'planner'))
    view = Path(tempfile.mkdtemp(), 'robots.rviz')
    text = robots_rviz(given.robots, namespace, given.arena.length, given.arena.width)
    view.write_text(text, encoding='utf-8')
    return Node(package='rviz2', executable='rviz2', arguments=['-d', str(view)], output='screen')


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the nodes depend on them."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file',
                default_value=str(config_file('robots.yaml')),
                description='parameter file of all nodes',
            ),
            DeclareLaunchArgument(
                'namespace', default_value='robots', description='namespace of all robots'
            ),
            DeclareLaunchArgument(
                'plant',
                default_value='true',
                choices=['true', 'false'],
                description='simulate the robots; false where the real ones publish odom',
            ),
            DeclareLaunchArgument(
                'rviz',
                default_value='false',
                choices=['true', 'false'],
                description='start RViz with everything in place, a goal tool for each robot',
            ),
            DeclareLaunchArgument(
                'log_level', default_value='info', description='level of all loggers'
            ),
            OpaqueFunction(function=start_nodes),
        ]
    )
