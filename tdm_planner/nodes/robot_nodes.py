# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Which nodes a parameter file with several robots needs, for launch files and the demo."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import ros_parameters


@dataclass(frozen=True)
class RobotNode:
    """A node to start: executable, its robot ('' for the planner of all), extra parameters.

    A robot's nodes run in a namespace of its name, below the planner's.
    """

    executable: str
    robot: str = ''
    parameters: dict[str, Any] = field(default_factory=dict)


def robot_nodes(document: Any) -> list[RobotNode]:
    """Return the planner, and plant and tracker of every robot named in a parameter file.

    `document` is the file's content; its section `planner` names the `robots`. The simulated
    robots stand at `<robot>.start` to begin with, unless the file places them otherwise.

    Raises
    ------
    InvalidProblem
        If no robots are named.
    """
    planner = ros_parameters(document, 'planner')
    robots = planner.get('robots')
    if not isinstance(robots, list) or not robots or not all(isinstance(r, str) for r in robots):
        raise InvalidProblem(
            f"parameter 'robots' = {robots} is not allowed: must be a list of the robots' names"
        )
    nodes = [RobotNode('planner')]
    for robot in robots:
        start = f'{robot}.start.'
        initial = {
            f'initial.{name.removeprefix(start)}': float(value)
            for name, value in planner.items()
            if name.startswith(start)
        }
        nodes += [RobotNode('robot_plant', robot, initial), RobotNode('tracker', robot)]
    return nodes
