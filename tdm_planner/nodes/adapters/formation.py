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

"""Robots for the planner node: `<robot>/odom` and `<robot>/joint_states` in, their plans out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from nav_msgs.msg import Odometry, Path
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import NoState
from tdm_planner.nodes.adapters.base import Adapter, Found, PlanRequest
from tdm_planner.nodes.adapters.followed_plans import FollowedPlans
from tdm_planner.nodes.adapters.goal_tool import GoalTool, place_in_arena
from tdm_planner.nodes.adapters.measurement import NewestMeasurement
from tdm_planner.nodes.adapters.plan_in_force import PlanInForce, PlansInForce, predicted_start
from tdm_planner.nodes.adapters.robot_stand_in import RobotStandIn
from tdm_planner.nodes.adapters.tracker_watch import TrackerWatch
from tdm_planner.nodes.formation_markers import formation_markers
from tdm_planner.nodes.messages import LATCHED, to_stamp
from tdm_planner.nodes.robot_messages import (
    odometry_state,
    robot_controls_message,
    robot_path_message,
    ROBOT_STATES,
    robot_trajectory_message,
    thruster_angle,
)
from tdm_planner.parameters import build
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.formation_parameters import Arena
from tdm_planner.problems.robot_formation import RobotFormation
from tdm_planner.replanning import FormationExecution, Mode, Observation
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

# Deviations of a robot that follows its plan; the thruster's angle may be anything.
_TRACKED = np.array([0.15, 0.15, 0.1, 0.1, 0.3, 0.3, np.inf])
_CARRIED = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])


@dataclass(frozen=True)
class _Robot:
    """Topics of one robot."""

    odometry: NewestMeasurement
    joints: NewestMeasurement
    trajectory: Any
    controls: Any
    path: Any
    stand_in: RobotStandIn


class FormationAdapter(Adapter):
    """State from every robot's odometry and thruster joint; a plan for every robot."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        super().__init__(node, values)
        self._robots = {name: self._connect(name) for name in values['robots']}
        self._in_force: dict[str, PlansInForce] = {}
        self.trackers = {
            name: TrackerWatch(node, f'{name}/', RobotTrackerParameters) for name in self._robots
        }
        self._goal_tools: list[GoalTool] = []
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)
        self.values_changed(values)

    def _connect(self, name: str) -> _Robot:
        node = self.node
        odometry = NewestMeasurement(node, Odometry, f'{name}/odom', odometry_state)
        joints = NewestMeasurement(node, JointState, f'{name}/joint_states', thruster_angle)
        return _Robot(
            odometry,
            joints,
            node.create_publisher(MultiDOFJointTrajectory, f'{name}/trajectory', LATCHED),
            node.create_publisher(JointTrajectory, f'{name}/controls', LATCHED),
            node.create_publisher(Path, f'{name}/path', LATCHED),
            RobotStandIn(node, name, odometry, joints),
        )

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Draw the set-up as the parameters have it; a plan in force is drawn as it was made."""
        self._values = dict(values)
        for robot in self._robots.values():
            robot.stand_in.values_changed(values)
        if self._in_force:
            return
        places = {name: values.get(f'formation.{name}') for name in self._robots}
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
            GoalTool(self.node, name, lambda: self._values, request, robot.stand_in.publish)
            for name, robot in self._robots.items()
        ]

    def missing(self) -> list[str]:
        """Say where no state of a robot was received yet."""
        return [
            f"robot '{name}': {half.missing}"
            for name, robot in self._robots.items()
            for half in (robot.odometry, robot.joints)
            if half.missing
        ]

    def measured_start(self, values: Mapping[str, Any], now: int, start: int) -> dict[str, Any]:
        """Propagate every robot's newest state, drifting, to the instant the motion starts."""
        found: dict[str, Any] = {}
        missing: list[str] = []
        for name in self._robots:
            try:
                state = self._predicted(name, now, values['start.max_age'], start)
            except NoState as error:
                missing.append(f"robot '{name}': {error}")
                continue
            for key, value in zip(ROBOT_STATES, state.tolist(), strict=True):
                found[f'{name}.start.{key}'] = value
        if missing:
            raise NoState('; '.join(missing))
        return found

    def _predicted(self, name: str, now: int, max_age: float, start: int) -> Array:
        robot, plans = self._robots[name], self._in_force.get(name)
        followed = plans is not None and self.trackers[name].mode(now) is Mode.FOLLOWING
        newest = robot.odometry.fresh(now, max_age)
        alpha = thruster_angle(robot.joints.fresh(now, max_age).message)
        return predicted_start(
            plans.at(now) if plans is not None and followed else None,
            np.append(odometry_state(newest.message), alpha),
            newest.instant,
            start,
            tracked=lambda away: bool((np.abs(away) < _TRACKED).all()),
            free=_drifted,
            deviation=_deviation,
            carried=lambda away, wait: _drifted(away, wait) * _CARRIED,
        )

    def warnings(self) -> list[str]:
        """Name the robots whose tracker or plant is not connected."""
        found = []
        for name, robot in self._robots.items():
            if robot.trajectory.get_subscription_count() == 0:
                found.append(f"robot '{name}': no tracker listens to {robot.trajectory.topic}")
            if self.node.count_publishers(robot.odometry.topic) == 0:
                found.append(f"robot '{name}': no plant publishes {robot.odometry.topic}")
        return found

    def next_start(self, now: int) -> int | None:
        """Instant [ns] at which the newest published plan begins; None where it has begun."""
        plans = next(iter(self._in_force.values()), None)  # all begin at once
        return None if plans is None else plans.next_start(now)

    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish motion, controls and path of every robot, and draw them."""
        assert isinstance(problem, RobotFormation)
        plant, stamp = problem.plant, to_stamp(start)
        now = int(self.node.get_clock().now().nanoseconds)
        for name, planned in solution.trajectories.items():
            trajectory = planned.with_rates(plant.derivative)
            robot = self._robots[name]
            robot.controls.publish(robot_controls_message(trajectory, plant, stamp))
            robot.trajectory.publish(robot_trajectory_message(name, trajectory, stamp))
            robot.path.publish(robot_path_message(trajectory, start))
            plans = self._in_force.setdefault(name, PlansInForce())
            plans.add(PlanInForce(trajectory, start), now)
        ends = {name: plan.states[-1, [0, 1, 4]] for name, plan in solution.trajectories.items()}
        paths = {name: plan.states[:, :2] for name, plan in solution.trajectories.items()}
        self._markers.publish(formation_markers(problem.arena, ends, paths))

    def clock_was_set(self, step: int | None) -> None:
        """Let the plans in force go on as the trackers have them go on."""
        super().clock_was_set(step)
        for plans in self._in_force.values():
            plans.clock_was_set(step)

    def watch_plans_followed(self, found: Found) -> None:
        """Begin to listen to what the robots' trackers say they follow."""
        FollowedPlans(self.node, tuple(self._robots), found)

    def start_of(self, trajectories: Mapping[str, Trajectory]) -> dict[str, Any]:
        """Return the first state of every robot as parameters."""
        return {
            f'{name}.start.{key}': value
            for name, trajectory in trajectories.items()
            for key, value in zip(ROBOT_STATES, trajectory.states[0].tolist(), strict=True)
        }

    @property
    def replans(self) -> bool:
        """Plans are reviewed on the way."""
        return True

    def execution(self, problem: Problem) -> FormationExecution:
        """Return the trackers' feedback as a model."""
        assert isinstance(problem, RobotFormation)
        return FormationExecution(problem, self.tracker_parameters)

    def observations(
        self, values: Mapping[str, Any], now: int, seconds: Callable[[int], float]
    ) -> dict[str, Observation]:
        """Return the newest state of every robot."""
        found: dict[str, Observation] = {}
        missing: list[str] = []
        for name, robot in self._robots.items():
            try:
                newest = robot.odometry.fresh(now, values['start.max_age'])
                joints = robot.joints.fresh(now, values['start.max_age'])
            except NoState as error:
                missing.append(f"robot '{name}': {error}")
                continue
            state = np.append(odometry_state(newest.message), thruster_angle(joints.message))
            start, mode = self.trackers[name].followed(now), self.trackers[name].mode(now)
            followed = None if start is None else seconds(start)
            found[name] = Observation(state, seconds(newest.instant), mode, followed)
        if missing:
            raise NoState('; '.join(missing))
        return found

    def ages(self, now: int) -> Mapping[str, float | None]:
        """Age of every robot's newest state."""
        found: dict[str, float | None] = {}
        for name, robot in self._robots.items():
            found[f'{name}/odom'] = robot.odometry.age(now)
            found[f'{name}/joint_states'] = robot.joints.age(now)
        return found


def _drifted(state: Array, duration: float) -> Array:
    """State (7,) after `duration` s without thrust or torque."""
    x, y, u, v, yaw, omega, alpha = state
    moved = [x + u * duration, y + v * duration, u, v, yaw + omega * duration, omega, alpha]
    return np.array(moved)


def _deviation(state: Array, reference: Array) -> Array:
    """Difference of two states (7,), angles by less than half a turn."""
    away = state - reference
    away[[4, 6]] = np.angle(np.exp(1j * away[[4, 6]]))
    return np.asarray(away)
