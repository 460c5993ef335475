# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The nodes that a formation of robots needs, for the launch file and the demo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from tdm_planner.problems.formation.parameters import (
    DEFAULT_ROBOTS,
    formation_specifications,
    with_number_of_robots,
)

_INITIAL = ('x', 'y', 'yaw', 'u', 'v', 'omega', 'alpha')  # start of a plan and of a plant alike


class Part(NamedTuple):
    """
    A node to start: executable, namespace, parameters beside those of the file.

    The namespace is one below the planner's: of a robot's nodes its name, '' of the planner.
    """

    executable: str
    namespace: str = ''
    parameters: Mapping[str, Any] = {}

    @property
    def name(self) -> str:
        """Return the node's full name, in its namespace."""
        return f'{self.namespace}/{self.executable}'


def robot_nodes(
    values: Mapping[str, Any], namespace: str = 'robots', number: int | None = None
) -> list[Part]:
    """
    Return the planner, and plant and tracker of every robot, for the planner's parameters.

    Those name the `robots`. Simulated robots begin at `<robot>.start`, and drift from there if it
    has velocities. `namespace` is the planner's; the trackers ask for new plans there. With a
    `number` that many robots take part, see `with_number_of_robots`.

    Raise InvalidProblem if the names cannot be used, a start is not allowed, or there is no room
    for so many.
    """
    changed = {} if number is None else with_number_of_robots(values, number)
    values = {**values, **changed}
    specifications = formation_specifications(values)
    tracking = {'kind': 'robot', 'planner_service': f'/{namespace}/plan'.replace('//', '/')}
    nodes = [Part('planner', parameters=changed)]
    for robot in values.get('robots', DEFAULT_ROBOTS):
        specs = {name: specifications[f'{robot}.start.{name}'] for name in _INITIAL}
        start = {n: spec.check(values.get(spec.name, spec.default)) for n, spec in specs.items()}
        initial = {f'initial.{name}': v for name, v in start.items() if v is not None}
        nodes += [Part('robot_plant', robot, initial), Part('tracker', robot, tracking)]
    return nodes
