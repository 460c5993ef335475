# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What the launch files share: arguments, how nodes are described, and how a launch ends.

What cannot start is found before anything is started, for launch leaves running what it started
before an action that fails. A node that ends with code 2 was started with what cannot be, and the
launch ends whole. So it does when the planner or the recorder dies, or a simulated plant; with
real plants the trackers go on to hold them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
import json
from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.launch_context import LaunchContext
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from rclpy.logging import get_logging_directory, LoggingSeverity
from rclpy.validate_namespace import validate_namespace
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.runtime import fault_of
from tdm_planner.parameter_files import config_file, read_parameters
from tdm_planner.problems.registry import check_file_is_for
from tdm_planner.starting import executable_of
import yaml

SWITCH = ['true', 'false', 'True', 'False', '1', '0']
# Without this pause Ctrl-C might interrupt a tracker while it restarts.
RESPAWN_DELAY, RESPAWN_RETRIES = 1.0, 3  # s
_VIEW_WIDTH = 640.0  # px that the arena takes in RViz
USAGE = 2  # exit code of a node that was started with what cannot be


class Launch:
    """
    The arguments of a launch under way, and the processes that they describe.

    The planner plans for `problem`, the name of one of ours, or for another package's that the
    parameter file names.

    Raise InvalidProblem if the parameter file cannot be read or is for another problem, or the
    namespace cannot be one.
    """

    def __init__(self, context: LaunchContext, problem: str) -> None:
        self._context = context
        self.file = self['params_file']
        self._namespace = self['namespace'].strip('/')
        # launch_ros puts a namespace that is pushed before the nodes' own; in absolute names we
        # must.
        pushed = context.launch_configurations.get('ros_namespace', '').strip('/')
        self.namespace = joined(pushed, self._namespace)
        if why := fault_of(f'/{self.namespace}', validate_namespace):
            raise InvalidProblem(f"namespace = '{self['namespace']}': {why}")
        self.planning = read_parameters(Path(self.file), namespace=self.namespace)
        # By name: `ros2 launch` runs in an interpreter that need not have what problems import.
        check_file_is_for(problem, self.planning, self.file, 'launch file')
        self._problem = {'problem': self.planning.get('problem', problem)}
        level, known = self['log_level'], ', '.join(LoggingSeverity.__members__).lower()
        if level.rpartition(':=')[2].lower() not in known.split(', '):  # of all, or LOGGER:=LEVEL
            raise InvalidProblem(f"log_level = '{level}' is not allowed: must be one of {known}")
        self._log_level = ['--log-level', level]
        self._clock = [{'use_sim_time': True}] if self.on('use_sim_time') else []

    def __getitem__(self, name: str) -> str:
        return str(LaunchConfiguration(name).perform(self._context))

    def on(self, name: str) -> bool:
        """Whether a switch is on."""
        return self[name].lower() in ('true', '1')

    def node(
        self, executable: str, robot: str = '', parameters: Mapping[str, Any] | None = None
    ) -> Node:
        """Describe a node of ours; `robot` is the namespace below that of all nodes."""
        executable_of('tdm_planner', executable)
        given = {**(self._problem if executable == 'planner' else {}), **(parameters or {})}
        enclave = ['--enclave', '/' + joined(self.namespace, robot, executable)]
        return Node(
            package='tdm_planner',
            executable=executable,
            namespace=joined(self._namespace, robot),
            parameters=[self.file, *([given] if given else []), *self._clock],
            ros_arguments=self._log_level + (enclave if self.on('enclaves') else []),
            output='screen',
            on_exit=self._on_exit(executable, needed=executable != 'tracker'),
            respawn=executable == 'tracker' and self.on('respawn'),
            respawn_delay=RESPAWN_DELAY,
            respawn_max_retries=RESPAWN_RETRIES,
        )

    def foreign_node(
        self, package: str, argument: str, parameters: Mapping[str, Any] | None = None, **more: Any
    ) -> Node:
        """Describe the node of another package; without `argument` it is not needed."""
        try:
            executable_of(package, package)
        except InvalidProblem as error:
            raise InvalidProblem(f'{error}, or launch with {argument}:=false') from None
        return Node(
            package=package,
            executable=package,
            parameters=[*([dict(parameters)] if parameters else []), *self._clock],
            ros_arguments=self._log_level,
            output='screen',
            **more,
        )

    def rviz(
        self, name: str, robots: Sequence[str] = (), length: float = 4.0, width: float = 4.0
    ) -> Node:
        """
        Describe RViz with the view ``config/<name>.rviz``, its topics in our namespace.

        With `robots` each gets a group of displays and a goal tool, and the arena of `length` and
        `width` m is seen from above.
        """
        view = config_file(f'{name}.rviz').read_text(encoding='utf-8')
        if robots:
            view = _view_of_robots(view, robots, length, width)
        view = view.replace(f'Value: /{name}/', f'Value: /{self.namespace}/'.replace('//', '/'))
        file = Path(get_logging_directory(), f'tdm_{self.namespace.replace("/", "_")}.rviz')
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(view, encoding='utf-8')
        return self.foreign_node('rviz2', 'rviz', arguments=['-d', str(file)])

    def recorder(self) -> ExecuteProcess:
        """Describe the process that records all topics of the namespace."""
        named = self.namespace.replace('/', '_') or 'tdm'
        bag = self['bag'] or f'{named}_{datetime.now():%Y_%m_%d-%H_%M_%S}'
        if Path(bag).exists():
            raise InvalidProblem(f"bag = '{bag}' is there already: name another folder")
        tdm, space = executable_of('tdm_planner', 'tdm'), f'/{self.namespace}'
        return ExecuteProcess(
            cmd=[tdm, 'record', '--quiet', '--output', bag, '--namespace', space],
            name='record',
            output='screen',
            on_exit=self._on_exit('recorder', needed=True),
        )

    def _on_exit(self, name: str, needed: bool) -> Any:
        """Return what launch calls when a process ends: it ends the launch by raising."""
        needed &= self.on('plant')

        def on_exit(event: Any, context: LaunchContext) -> None:
            code = event.returncode
            if not context.is_shutdown and (code == USAGE or (code and needed)):
                raise RuntimeError(f'{name} ended with code {code}: the launch ends')

        return on_exit


def _view_of_robots(view: str, robots: Sequence[str], length: float, width: float) -> str:
    """Return the view of the shipped robots for others, made from the parts of the first."""
    document = yaml.safe_load(view)
    manager = document['Visualization Manager']
    displays, tools = manager['Displays'], manager['Tools']

    def for_each(item: Any) -> list[Any]:
        text = json.dumps(item)
        return [json.loads(text.replace('robot1', robot)) for robot in robots]

    grid, plan, group = displays[:3]
    manager['Displays'] = [grid, plan, *for_each(group)]
    manager['Tools'] = [tool for tool in tools if 'Topic' not in tool]
    manager['Tools'] += for_each(next(tool for tool in tools if 'Topic' in tool))
    grid['Plane Cell Count'] = max(1, round(max(length, width)))  # cells of 1 m
    grid['Offset'].update(X=length / 2, Y=width / 2)
    manager['Views']['Current'].update(
        X=length / 2, Y=width / 2, Scale=_VIEW_WIDTH / max(length, width)
    )
    return str(yaml.safe_dump(document, sort_keys=False, width=1000))


def joined(*parts: str) -> str:
    """Join the parts of a name that are not empty."""
    return '/'.join(part for part in parts if part)


def argument(name: str, default: str, description: str, **more: Any) -> DeclareLaunchArgument:
    """Declare an argument."""
    return DeclareLaunchArgument(name, default_value=default, description=description, **more)


def switch(name: str, default: str, description: str) -> DeclareLaunchArgument:
    """Declare an argument that is true or false."""
    return argument(name, default, description, choices=SWITCH)


def common_arguments() -> list[DeclareLaunchArgument]:
    """Declare the arguments that both launch files have."""
    return [
        switch(
            'record', 'false', 'record all topics of the namespace, and shared ones, to a rosbag2'
        ),
        argument('bag', '', 'folder to record to; empty: named after namespace and time'),
        switch('respawn', 'true', 'restart a tracker that dies, up to three times'),
        switch(
            'use_sim_time',
            'false',
            'let all nodes follow /clock; a plant with publish_clock drives it',
        ),
        switch(
            'enclaves', 'false', 'run every node of this package in the SROS2 enclave of its name'
        ),
        argument('log_level', 'info', 'level of the loggers of all nodes but the recorder'),
    ]
