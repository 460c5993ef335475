# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Planner and tracker of the rotary pendulum, and a simulated plant unless a real one is there.

ros2 launch tdm_planner pendulum.launch.py rviz:=true
ros2 service call /pendulum/plan std_srvs/srv/Trigger
"""

from pathlib import Path
import tempfile

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from tdm_planner.parameters import build, ros_parameters
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.resources import config_file
from tdm_planner.views.pendulum_urdf import pendulum_urdf
from tdm_planner.views.rviz import pendulum_rviz
import yaml


def start_viewers(context: LaunchContext) -> list[Node]:
    """Describe what draws the plant that the parameter file's section `planner` has."""

    def argument(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    namespace = argument('namespace').strip('/')
    nodes = []
    if argument('description') == 'true':
        text = Path(argument('params_file')).read_text(encoding='utf-8')
        plant = build(RotaryPendulum, ros_parameters(yaml.safe_load(text), 'planner'), 'plant.')
        description = ParameterValue(pendulum_urdf(plant), value_type=str)
        nodes.append(
            Node(
                package='robot_state_publisher',
                executable='robot_state_publisher',
                namespace=namespace,
                parameters=[{'robot_description': description}],
                ros_arguments=['--log-level', argument('log_level')],
                output='screen',
            )
        )
    if argument('rviz') == 'true':
        view = Path(tempfile.mkdtemp(), 'pendulum.rviz')
        view.write_text(pendulum_rviz(namespace), encoding='utf-8')
        nodes.append(
            Node(
                package='rviz2',
                executable='rviz2',
                arguments=['-d', str(view)],
                output='screen',
            )
        )
    return nodes


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes."""
    options = {
        'package': 'tdm_planner',
        'namespace': LaunchConfiguration('namespace'),
        'parameters': [LaunchConfiguration('params_file')],
        'ros_arguments': ['--log-level', LaunchConfiguration('log_level')],
        'output': 'screen',
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file',
                default_value=str(config_file('pendulum.yaml')),
                description='parameter file of all nodes',
            ),
            DeclareLaunchArgument(
                'namespace', default_value='pendulum', description='namespace of all nodes'
            ),
            DeclareLaunchArgument(
                'plant',
                default_value='true',
                choices=['true', 'false'],
                description='simulate the plant; false where the real one publishes joint_states',
            ),
            DeclareLaunchArgument(
                'description',
                default_value='true',
                choices=['true', 'false'],
                description='start robot_state_publisher, for RobotModel and tf',
            ),
            DeclareLaunchArgument(
                'rviz',
                default_value='false',
                choices=['true', 'false'],
                description='start RViz with everything in place',
            ),
            DeclareLaunchArgument(
                'log_level', default_value='info', description='level of all loggers'
            ),
            Node(executable='planner', **options),
            Node(executable='tracker', **options),
            Node(
                executable='pendulum_plant',
                condition=IfCondition(LaunchConfiguration('plant')),
                **options,
            ),
            OpaqueFunction(function=start_viewers),
        ]
    )
