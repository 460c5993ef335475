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
One planner for all robots, a tracker for each, and simulated plants unless real ones are there.

Start with ``ros2 launch tdm_planner robots.launch.py rviz:=true``, then ask for a plan with
``ros2 service call /robots/plan std_srvs/srv/Trigger``.

The robots are those that the parameter file's section `planner` names in `robots`; the simulated
ones stand at its `<robot>.start` to begin with. ``number_of_robots:=2`` takes the first two of
them, a larger number adds more, with places of their own.

Ctrl-C ends all of it. A tracker that dies is started anew: it takes up the plan in force where
the robot is on it, and holds otherwise. The planner is not, which would forget the parameters that
were set meanwhile; nor are simulated plants, which would jump back to their initial states.
"""

from pathlib import Path
import tempfile
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.robot_nodes import robot_nodes
from tdm_planner.parameter_files import parse_yaml
from tdm_planner.parameters import build, ros_parameters
from tdm_planner.problems.formation_parameters import FormationParameters
from tdm_planner.resources import config_file
from tdm_planner.views.rviz import robots_rviz
from tdm_sim.record_command import record_command

SWITCH = ['true', 'false']
# A second's pause, or Ctrl-C might come upon a tracker that is just being started anew.
RESPAWN = {'respawn': True, 'respawn_delay': 1.0, 'respawn_max_retries': 3}


def start(context: LaunchContext) -> list[Any]:
    """Describe the processes, for the arguments of this launch."""

    def argument(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    file, namespace = argument('params_file'), argument('namespace').strip('/')
    # launch_ros puts a namespace that is pushed before the nodes' own; in absolute names we must.
    pushed = context.launch_configurations.get('ros_namespace', '').strip('/')
    whole = joined(pushed, namespace)
    document = parse_yaml(Path(file).read_text(encoding='utf-8'))
    log_level = ['--log-level', argument('log_level')]
    clock = [{'use_sim_time': True}] if argument('use_sim_time') == 'true' else []
    nodes = robot_nodes(document, whole, how_many(argument('number_of_robots')))
    simulated = argument('plant') == 'true'
    respawn = RESPAWN if argument('respawn') == 'true' else {}
    described: list[Any] = []
    for node in nodes:
        if node.executable == 'robot_plant' and not simulated:
            continue
        space = joined(namespace, node.robot)
        in_enclave = ['--enclave', '/' + joined(whole, node.robot, node.executable)]
        described.append(
            Node(
                package='tdm_planner',
                executable=node.executable,
                namespace=space,
                parameters=[file, *([node.parameters] if node.parameters else []), *clock],
                ros_arguments=[
                    *log_level,
                    *(in_enclave if argument('enclaves') == 'true' else []),
                ],
                output='screen',
                **(respawn if node.executable == 'tracker' else {}),
            )
        )
    if argument('rviz') == 'true':
        robots = [node.robot for node in nodes if node.executable == 'tracker']
        described.append(rviz(document, whole, robots, log_level, clock))
    if argument('record') == 'true':
        command = record_command(whole, argument('bag'), bool(clock))
        described.append(ExecuteProcess(cmd=command, name='record', output='screen'))
    return described


def joined(*parts: str) -> str:
    """Join the parts of a name that are not empty."""
    return '/'.join(part for part in parts if part)


def how_many(text: str) -> int | None:
    """Return the number of robots that is asked for; None for those of the parameter file."""
    if text == 'all':
        return None
    if not text.isdecimal():
        raise InvalidProblem(f"number_of_robots = {text!r} must be a whole number, or 'all'")
    return int(text)


def rviz(
    document: Any,
    namespace: str,
    robots: list[str],
    log_level: list[str],
    clock: list[dict[str, bool]],
) -> Node:
    """Describe RViz for the robots, and the arena that a parameter file has."""
    arena = build(FormationParameters, ros_parameters(document, 'planner', namespace)).arena
    view = Path(tempfile.mkdtemp(), 'robots.rviz')
    text = robots_rviz(robots, namespace, arena.length, arena.width)
    view.write_text(text, encoding='utf-8')
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
                default_value=str(config_file('robots.yaml')),
                description='parameter file of all nodes',
            ),
            DeclareLaunchArgument(
                'namespace', default_value='robots', description='namespace of all robots'
            ),
            DeclareLaunchArgument(
                'number_of_robots',
                default_value='all',
                description='how many take part; all: those that the parameter file names',
            ),
            DeclareLaunchArgument(
                'plant',
                default_value='true',
                choices=SWITCH,
                description='simulate the robots; false where the real ones publish odom',
            ),
            DeclareLaunchArgument(
                'rviz',
                default_value='false',
                choices=SWITCH,
                description='start RViz with everything in place, a goal tool for each robot',
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
