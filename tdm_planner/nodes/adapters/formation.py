# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A formation of robots for the planner node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from tdm_planner.nodes.adapters.base import Adapter, PlanRequest
from tdm_planner.nodes.adapters.goal_tool import GoalTool
from tdm_planner.nodes.adapters.vehicle import Vehicle
from tdm_planner.nodes.formation_markers import formation_markers
from tdm_planner.nodes.messages import LATCHED, path_message, plan_message, to_stamp
from tdm_planner.nodes.robot_markers import RobotLook, RobotPicture
from tdm_planner.parameters import build
from tdm_planner.plant_kind import ROBOT
from tdm_planner.problems.base import Solution
from tdm_planner.problems.formation_parameters import Arena, place_in_arena
from tdm_planner.problems.robot_formation import RobotFormation
from tdm_planner.replanning import FormationExecution
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters
from tdm_planner.trajectory import Trajectory
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

# Deviations of a robot that follows its plan; the thruster's angle may be anything.
_TRACKED = np.array([0.15, 0.15, 0.1, 0.1, 0.3, 0.3, np.inf])
_CARRIED = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
_TRAIL = 60.0  # s
_BODY = 0.375  # radius of the body as a share of the minimum separation: the planner has no other


class FormationAdapter(Adapter):
    """A plan for every robot; between plans robots drift."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        self._pictures = {
            name: RobotPicture(RobotLook(name, 0.15, 0.4, 1.0), _TRAIL)
            for name in values['robots']
        }
        super().__init__(
            node,
            [
                Vehicle(node, name, f'{name}/', ROBOT, RobotTrackerParameters, picture)
                for name, picture in self._pictures.items()
            ],
        )
        self._paths = {
            name: node.create_publisher(Path, f'{name}/path', LATCHED) for name in self.vehicles
        }
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)
        self._goal_tools: list[GoalTool] = []
        self._drawn = False
        self.values_changed(values)

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Draw the set-up as the parameters have it; an active plan is drawn as it was made."""
        self._values = dict(values)
        separation, thrust = values['arena.minimum_separation'], values['limits.thrust']
        for name, picture in self._pictures.items():
            picture.set_up(RobotLook(name, _BODY * separation, separation, thrust), _TRAIL)
        if self._drawn:
            return
        places = {name: values.get(f'formation.{name}') for name in self.vehicles}
        anchor = values['formation.anchor']
        goals = {
            name: np.array(place_in_arena(anchor, place))
            for name, place in places.items()
            if place is not None
        }
        self._markers.publish(formation_markers(build(Arena, values, 'arena.'), goals))

    def accept_requests(self, request: PlanRequest) -> None:
        """Let goal tools move the robots' places in the formation."""
        self._goal_tools = [
            GoalTool(self.node, name, lambda: self._values, request, vehicle.markers.publish)
            for name, vehicle in self.vehicles.items()
        ]

    def tracked(self, vehicle: Vehicle, plan: Trajectory) -> Array:
        """Return the largest deviations (7,) of a robot that follows its plan."""
        return _TRACKED

    def free(self, values: Mapping[str, Any], state: Array, duration: float) -> Array:
        """Return the state (7,) `duration` s later without thrust or torque."""
        return drifted(state, duration)

    def carried(self, away: Array, duration: float) -> Array:
        """Return a deviation (7,), drifting: the feedback is slow."""
        return np.asarray(drifted(away, duration) * _CARRIED)

    def with_rates(self, problem: RobotFormation, trajectory: Trajectory) -> Trajectory:
        """Return a planned motion with the rates of its states."""
        return trajectory.with_rates(problem.plant.derivative)

    def publish_motion(
        self, problem: RobotFormation, vehicle: Vehicle, trajectory: Trajectory, start: int
    ) -> None:
        """Publish the plan, with the change of the wheel's speed since the start, and the path."""
        omega = trajectory.state('omega')
        wheel = problem.plant.wheel_speed(omega, initial_omega=float(omega[0]))
        vehicle.trajectory.publish(
            plan_message(vehicle.kind, trajectory, to_stamp(start), {'wheel_speed': wheel})
        )
        self._paths[vehicle.name].publish(path_message(vehicle.kind, trajectory, start))

    def draw(self, problem: RobotFormation, solution: Solution) -> None:
        """Show paths and goals."""
        self._drawn = True
        ends = {name: plan.states[-1, [0, 1, 4]] for name, plan in solution.trajectories.items()}
        paths = {name: plan.states[:, :2] for name, plan in solution.trajectories.items()}
        self._markers.publish(formation_markers(problem.arena, ends, paths))

    def execution(self, problem: RobotFormation) -> FormationExecution:
        """Return the trackers' feedback as a model."""
        return FormationExecution(problem, self.tracker_parameters)


def drifted(state: Array, duration: float) -> Array:
    """State (7,) after `duration` s without thrust or torque."""
    x, y, u, v, yaw, omega, alpha = state
    moved = [x + u * duration, y + v * duration, u, v, yaw + omega * duration, omega, alpha]
    return np.array(moved)
