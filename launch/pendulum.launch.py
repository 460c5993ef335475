# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Planner and tracker of the rotary pendulum, and a simulated plant unless a real one is there.

ros2 launch tdm_planner pendulum.launch.py rviz:=true
ros2 service call /pendulum/plan std_srvs/srv/Trigger

Ctrl-C ends all of it. A tracker that dies is started anew: it takes up the plan in force where
the plant is on it, and holds otherwise. The planner is not, which would forget the parameters that
were set meanwhile; nor is the simulated plant, which would jump back to its initial state.
"""

from pathlib import Path
import tempfile
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from tdm_planner.parameter_files import read_parameters
from tdm_planner.parameters import build
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.resources import config_file
from tdm_planner.views.pendulum_urdf import pendulum_urdf
from tdm_planner.views.rviz import pendulum_rviz
from tdm_sim.record_command import record_command

SWITCH = ['true', 'false']
# A second's pause, or Ctrl-C might come upon a tracker that is just being started anew.
RESPAWN = {'respawn': True, 'respawn_delay': 1.0, 'respawn_max_retries': 3}


def start(context: LaunchContext) -> list[Any]:
    """Describe the processes, for the arguments of this launch."""

    def argument(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    namespace = argument('namespace').strip('/')
    # launch_ros puts a namespace that is pushed before the nodes' own; in absolute names we must.
    pushed = context.launch_configurations.get('ros_namespace', '').strip('/')
    whole = joined(pushed, namespace)
    file = argument('params_file')
    log_level = ['--log-level', argument('log_level')]
    clock = [{'use_sim_time': True}] if argument('use_sim_time') == 'true' else []

    def node(executable: str, **more: Any) -> Node:
        in_enclave = ['--enclave', '/' + joined(whole, executable)]
        return Node(
            package='tdm_planner',
            executable=executable,
            namespace=namespace,
            parameters=[file, *clock],
            ros_arguments=log_level + (in_enclave if argument('enclaves') == 'true' else []),
            output='screen',
            **more,
        )

    respawn = RESPAWN if argument('respawn') == 'true' else {}
    described: list[Any] = [node('planner'), node('tracker', **respawn)]
    if argument('plant') == 'true':
        described.append(node('pendulum_plant'))
    if argument('description') == 'true':
        planner = read_parameters(Path(file), namespace=whole)
        described.append(state_publisher(planner, namespace, log_level, clock))
    if argument('rviz') == 'true':
        described.append(rviz(whole, log_level, clock))
    if argument('record') == 'true':
        command = record_command(whole, argument('bag'), bool(clock))
        described.append(ExecuteProcess(cmd=command, name='record', output='screen'))
    return described


def joined(*parts: str) -> str:
    """Join the parts of a name that are not empty."""
    return '/'.join(part for part in parts if part)


def state_publisher(
    planner: dict[str, Any], namespace: str, log_level: list[str], clock: list[dict[str, bool]]
) -> Node:
    """Describe robot_state_publisher for the plant that the planner's parameters have."""
    plant = build(RotaryPendulum, planner, 'plant.')
    description = ParameterValue(pendulum_urdf(plant), value_type=str)
    return Node(
        package='robot_state_publisher',
        executable='robot_state_publisher',
        namespace=namespace,
        parameters=[{'robot_description': description}, *clock],
        ros_arguments=log_level,
        output='screen',
    )


def rviz(namespace: str, log_level: list[str], clock: list[dict[str, bool]]) -> Node:
    """Describe RViz with the topics of the namespace."""
    view = Path(tempfile.mkdtemp(), 'pendulum.rviz')
    view.write_text(pendulum_rviz(namespace), encoding='utf-8')
    return Node(
        package='rviz2',
        executable='rviz2',
        arguments=['-d', str(view)],
        parameters=clock,
        ros_arguments=log_level,
        output='screen',
    )


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the processes depend on them."""
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
                choices=SWITCH,
                description='simulate the plant; false where the real one publishes joint_states',
            ),
            DeclareLaunchArgument(
                'description',
                default_value='true',
                choices=SWITCH,
                description='start robot_state_publisher, for RobotModel and tf',
            ),
            DeclareLaunchArgument(
                'rviz',
                default_value='false',
                choices=SWITCH,
                description='start RViz with everything in place',
            ),
            DeclareLaunchArgument(
                'record',
                default_value='false',
                choices=SWITCH,
                description='record all topics of the namespace, and shared ones, to a rosbag2',
            ),
            DeclareLaunchArgument(
                'bag',
                default_value='',
                description='folder to record to; empty: named after namespace and time',
            ),
            DeclareLaunchArgument(
                'respawn',
                default_value='true',
                choices=SWITCH,
                description='start a tracker that has died anew, up to three times',
            ),
            DeclareLaunchArgument(
                'use_sim_time',
                default_value='false',
                choices=SWITCH,
                description='let all nodes follow /clock; a plant with publish_clock drives it',
            ),
            DeclareLaunchArgument(
                'enclaves',
                default_value='false',
                choices=SWITCH,
                description='run every node of this package in the SROS2 enclave of its name',
            ),
            DeclareLaunchArgument(
                'log_level',
                default_value='info',
                description='level of the loggers of all nodes but the recorder',
            ),
            OpaqueFunction(function=start),
        ]
    )
