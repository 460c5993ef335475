# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Planner and tracker of the rotary pendulum, and a simulated plant unless a real one is there.

ros2 launch tdm_planner pendulum.launch.py
ros2 service call /pendulum/plan std_srvs/srv/Trigger
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from tdm_planner.resources import config_file


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
                'log_level', default_value='info', description='level of all loggers'
            ),
            Node(executable='planner', **options),
            Node(executable='tracker', **options),
            Node(
                executable='pendulum_plant',
                condition=IfCondition(LaunchConfiguration('plant')),
                **options,
            ),
        ]
    )
