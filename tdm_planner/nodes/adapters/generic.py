# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Any other problem for the planner node: what it states, or the names of states and controls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.nodes.adapters.base import Adapter, Found
from tdm_planner.nodes.adapters.vehicle import Vehicle
from tdm_planner.nodes.drawn_markers import drawn_plan, DrawnPicture, has_drawing
from tdm_planner.nodes.messages import LATCHED, plan_message, to_stamp
from tdm_planner.nodes.tracked_plants import tracked_problem
from tdm_planner.plant_kind import named_kind, plan_kind, PlantKind
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_planner.problems.registry import load_problem
from tdm_planner.replanning import GenericExecution
from tdm_planner.replanning.generic_execution import ranges_of, VEHICLE
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

_START = 'start.'
_OF_THE_NODE = ('start.source', 'start.max_age', 'start.delay')


class GenericAdapter(Adapter):
    """
    Serves a problem of which no more is known than what every problem has.

    The joints of a plan on `trajectory` (`<vehicle>/trajectory` where a solution holds several)
    are those of the stated problem, or the names of states (positions) and controls (effort). The
    measured state is a JointState on `joint_states` with the same joints, or with the numbers X of
    the parameters `start.X` for joints. A problem without such parameters has nothing to measure
    and is planned for from its parameters, whatever `start.source` says.
    """

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        self._wanted = [
            name.removeprefix(_START)
            for name, value in values.items()
            if name.startswith(_START) and name not in _OF_THE_NODE and isinstance(value, float)
        ]
        problem, kind, parameters = load_problem(values['problem']), named_kind(self._wanted), None
        if issubclass(problem, DirectProblem):
            tracked = tracked_problem(problem)
            parameters = tracked.parameters
            if set(self._wanted) <= set(tracked.kind.state_names):
                known = [name for name in tracked.kind.state_names if name in self._wanted]
                kind = replace(tracked.kind, state_names=tuple(known))
        picture = _picture(problem, kind)
        super().__init__(node, [Vehicle(node, VEHICLE, '', kind, parameters, picture)])
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)
        self._several: dict[str, Any] = {}
        self._execution: GenericExecution | None = None
        self.values_changed(values)

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Follow what counts as leaving a plan."""
        self._deviation = values['replan.deviation']
        if self._execution is not None:
            self._execution.tolerance = self._deviation

    @property
    def measures(self) -> bool:
        """Whether the problem has numbers `start.X`."""
        return bool(self._wanted)

    def missing(self) -> list[str]:
        """Say where no state was received yet."""
        return super().missing() if self.measures else []

    def tracked(self, vehicle: Vehicle, plan: Trajectory) -> Array:
        """Return the deviations (nx,) beyond which a plan was left."""
        return np.asarray(self._deviation * ranges_of(plan))

    def free(self, values: Mapping[str, Any], state: Array, duration: float) -> Array:
        """Return the state as it is: until a plan begins its tracker holds it where it can."""
        return state

    def rests(self, now: int) -> bool:
        """Whether no plan is under way; the state then counts as staying as it is."""
        plans = [self._followed(vehicle, now) for vehicle in self.vehicles.values()]
        return all(plan is None or plan.end <= 0.0 for plan in plans)

    def carried(self, away: Array, duration: float) -> Array:
        """Return a deviation as it is: how well it is taken away is not known."""
        return away

    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish every vehicle's plan."""
        (vehicle,) = self.vehicles.values()
        several = len(solution.trajectories) > 1
        for name, trajectory in solution.trajectories.items():
            kind = plan_kind(problem, trajectory)
            publisher = self._publisher(f'{name}/trajectory') if several else vehicle.trajectory
            publisher.publish(plan_message(kind, trajectory, to_stamp(start)))
            if trajectory.state_names == vehicle.kind.state_names and not several:
                self.note(vehicle, trajectory, start)
        if isinstance(problem, DirectProblem) and has_drawing(type(problem)):
            self._markers.publish(drawn_plan(problem, solution.trajectory))

    def _publisher(self, topic: str) -> Any:
        if topic not in self._several:
            self._several[topic] = self.node.create_publisher(JointTrajectory, topic, LATCHED)
        return self._several[topic]

    def watch_plans_followed(self, found: Found) -> None:
        """Recover nothing: such a problem cannot assess plans made before."""

    def execution(self, problem: Problem) -> GenericExecution:
        """Return how plans are carried out: by a controller of which nothing is known."""
        (vehicle,) = self.vehicles.values()
        self._execution = GenericExecution(vehicle.kind.state_names, self._deviation)
        return self._execution


def _picture(problem: type[Problem], kind: PlantKind) -> DrawnPicture | None:
    """Return the picture of a problem that has one, where all of its state is measured."""
    if not (issubclass(problem, DirectProblem) and has_drawing(problem)):
        return None
    made = problem()
    whole = kind.state_names == tuple(made.state_names)
    return DrawnPicture(made, np.nan_to_num(CheckedFormulation(made).start())) if whole else None
