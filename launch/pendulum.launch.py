# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Planner and tracker of the rotary pendulum, and a simulated plant unless a real one is there.

ros2 launch tdm_planner pendulum.launch.py rviz:=true
ros2 service call /pendulum/plan std_srvs/srv/Trigger

Ctrl-C ends all of it. A tracker that dies is restarted: it resumes the active plan if the plant is
on it, and holds otherwise. Planner and simulated plant are not restarted, because they would lose
their parameters and their state: when one of them dies, the launch ends. With a real plant the
tracker goes on to hold it.
"""

from typing import Any

from launch import LaunchContext, LaunchDescription  # type: ignore[attr-defined]
from launch.actions import OpaqueFunction
from launch_ros.parameter_descriptions import ParameterValue
from tdm_planner.launching import argument, common_arguments, Launch, switch
from tdm_planner.parameter_files import config_file
from tdm_planner.parameters import build
from tdm_planner.plants.rotary_pendulum import pendulum_urdf, RotaryPendulum
from tdm_planner.problems.registry import SHORT_NAMES


def start(context: LaunchContext) -> list[Any]:
    """Describe the processes, for the arguments of this launch; other packages' first."""
    launch = Launch(context, SHORT_NAMES['pendulum'])
    described: list[Any] = []
    if launch.on('description'):
        urdf = pendulum_urdf(build(RotaryPendulum, launch.planning, 'plant.'))
        given = {'robot_description': ParameterValue(urdf, value_type=str)}
        space = launch['namespace'].strip('/')
        described.append(
            launch.foreign_node('robot_state_publisher', 'description', given, namespace=space)
        )
    if launch.on('rviz'):
        described.append(launch.rviz('pendulum'))
    described += [launch.node('planner'), launch.node('tracker')]
    if launch.on('plant'):
        described.append(launch.node('pendulum_plant'))
    if launch.on('record'):
        described.append(launch.recorder())
    return described


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the processes depend on them."""
    return LaunchDescription(
        [
            argument(
                'params_file', str(config_file('pendulum.yaml')), 'parameter file of all nodes'
            ),
            argument('namespace', 'pendulum', 'namespace of all nodes'),
            switch(
                'plant',
                'true',
                'simulate the plant; false where the real one publishes joint_states',
            ),
            switch('description', 'true', 'start robot_state_publisher, for RobotModel and tf'),
            switch('rviz', 'false', 'start RViz with everything in place'),
            *common_arguments(),
            OpaqueFunction(function=start),
        ]
    )
