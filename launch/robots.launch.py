# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
One planner for all robots, a tracker for each, and simulated plants unless real ones are there.

Start with ``ros2 launch tdm_planner robots.launch.py rviz:=true``, then ask for a plan with
``ros2 service call /robots/plan std_srvs/srv/Trigger``.

The robots are those that the parameter file's section `planner` names in `robots`; the simulated
ones begin at its `<robot>.start`, and drift from there if it has velocities, until a plan starts.
``number_of_robots:=2`` takes the first two of them, a larger number adds more, with places of
their own.

Ctrl-C ends all of it. A tracker that dies is restarted: it resumes the active plan if the robot is
on it, and holds otherwise. Planner and simulated plants are not restarted, because they would lose
their parameters and their state: when one of them dies, the launch ends. With real robots the
trackers go on to hold them.
"""

from typing import Any

from launch import LaunchContext, LaunchDescription  # type: ignore[attr-defined]
from launch.actions import OpaqueFunction
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.launching import argument, common_arguments, Launch, switch
from tdm_planner.parameter_files import config_file
from tdm_planner.parameters import build
from tdm_planner.problems.formation.parameters import FormationParameters
from tdm_planner.problems.registry import SHORT_NAMES
from tdm_planner.robot_nodes import robot_nodes


def start(context: LaunchContext) -> list[Any]:
    """Describe the processes, for the arguments of this launch; other packages' first."""
    launch = Launch(context, SHORT_NAMES['robots'])
    nodes = robot_nodes(launch.planning, launch.namespace, how_many(launch['number_of_robots']))
    described: list[Any] = []
    if launch.on('rviz'):
        arena = build(FormationParameters, launch.planning).arena
        robots = [node.namespace for node in nodes if node.executable == 'tracker']
        described.append(launch.rviz('robots', robots, arena.length, arena.width))
    described += [
        launch.node(node.executable, node.namespace, node.parameters)
        for node in nodes
        if node.executable != 'robot_plant' or launch.on('plant')
    ]
    if launch.on('record'):
        described.append(launch.recorder())
    return described


def how_many(text: str) -> int | None:
    """Return the number of robots that is asked for; None for those of the parameter file."""
    if text == 'all':
        return None
    if not text.isdecimal():
        raise InvalidProblem(f"number_of_robots = {text!r} must be a whole number, or 'all'")
    return int(text)


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the processes depend on them."""
    return LaunchDescription(
        [
            argument(
                'params_file', str(config_file('robots.yaml')), 'parameter file of all nodes'
            ),
            argument('namespace', 'robots', 'namespace of all robots'),
            argument(
                'number_of_robots',
                'all',
                'how many take part; all: those that the parameter file names',
            ),
            switch('plant', 'true', 'simulate the robots; false where the real ones publish odom'),
            switch(
                'rviz', 'false', 'start RViz with everything in place, a goal tool for each robot'
            ),
            *common_arguments(),
            OpaqueFunction(function=start),
        ]
    )
