# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Robots for the planner node: `<robot>/odom` and `<robot>/joint_states` in, their plans out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nav_msgs.msg import Odometry, Path
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from tdm_planner.exceptions import NoState
from tdm_planner.nodes.adapters.base import Adapter
from tdm_planner.nodes.adapters.measurement import NewestMeasurement
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
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.robot_formation import RobotFormation
from tdm_planner.trajectory import NANOSECOND

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Robot:
    """Topics of one robot."""

    odometry: NewestMeasurement
    joints: NewestMeasurement
    trajectory: Any
    controls: Any
    path: Any


class FormationAdapter(Adapter):
    """State from every robot's odometry and thruster joint; a plan for every robot."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        super().__init__(node, values)
        self._robots = {name: self._connect(name) for name in values['robots']}
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)

    def _connect(self, name: str) -> _Robot:
        node = self.node
        return _Robot(
            NewestMeasurement(node, Odometry, f'{name}/odom', odometry_state),
            NewestMeasurement(node, JointState, f'{name}/joint_states', thruster_angle),
            node.create_publisher(MultiDOFJointTrajectory, f'{name}/trajectory', LATCHED),
            node.create_publisher(JointTrajectory, f'{name}/controls', LATCHED),
            node.create_publisher(Path, f'{name}/path', LATCHED),
        )

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Nothing to follow: the robots' names are fixed while the node runs."""

    def measured_start(self, values: Mapping[str, Any], now: int, start: int) -> dict[str, Any]:
        """Propagate every robot's newest state, drifting, to the instant the motion starts."""
        found: dict[str, Any] = {}
        missing: list[str] = []
        for name, robot in self._robots.items():
            try:
                state = self._drifted(robot, now, values['start.max_age'], start)
            except NoState as error:
                missing.append(f"robot '{name}': {error}")
                continue
            for key, value in zip(ROBOT_STATES, state.tolist(), strict=True):
                found[f'{name}.start.{key}'] = value
        if missing:
            raise NoState('; '.join(missing))
        return found

    @staticmethod
    def _drifted(robot: _Robot, now: int, max_age: float, start: int) -> Array:
        newest = robot.odometry.fresh(now, max_age)
        alpha = thruster_angle(robot.joints.fresh(now, max_age).message)
        x, y, u, v, yaw, omega = odometry_state(newest.message)
        wait = (start - newest.instant) * NANOSECOND
        return np.array([x + u * wait, y + v * wait, u, v, yaw + omega * wait, omega, alpha])

    def warnings(self) -> list[str]:
        """Name the robots whose tracker or plant is not connected."""
        found = []
        for name, robot in self._robots.items():
            if robot.trajectory.get_subscription_count() == 0:
                found.append(f"robot '{name}': no tracker listens to {robot.trajectory.topic}")
            if self.node.count_publishers(robot.odometry.topic) == 0:
                found.append(f"robot '{name}': no plant publishes {robot.odometry.topic}")
        return found

    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish motion, controls and path of every robot, and draw them."""
        assert isinstance(problem, RobotFormation)
        plant, stamp = problem.plant, to_stamp(start)
        for name, planned in solution.trajectories.items():
            trajectory = planned.with_rates(plant.derivative)
            robot = self._robots[name]
            robot.controls.publish(robot_controls_message(trajectory, plant, stamp))
            robot.trajectory.publish(robot_trajectory_message(name, trajectory, stamp))
            robot.path.publish(robot_path_message(trajectory, start))
        self._markers.publish(formation_markers(problem, solution))

    def ages(self, now: int) -> Mapping[str, float | None]:
        """Age of every robot's newest state."""
        found: dict[str, float | None] = {}
        for name, robot in self._robots.items():
            found[f'{name}/odom'] = robot.odometry.age(now)
            found[f'{name}/joint_states'] = robot.joints.age(now)
        return found
