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

"""The picture of a robot that does not draw itself."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.adapters.measurement import NewestMeasurement
from tdm_planner.nodes.adapters.stand_in import OLDEST_SHOWN, StandIn
from tdm_planner.nodes.reading import joint_indices, odometry_state, ROBOT_JOINTS, thruster_angle
from tdm_planner.nodes.robot_markers import RobotLook, RobotPicture, RobotState
from tdm_planner.trajectory import NANOSECOND
from visualization_msgs.msg import MarkerArray

_TRAIL = 60.0  # s
_BODY = 0.375  # radius of the body as a share of the minimum separation: the planner has no other


class RobotStandIn:
    """Draws a real robot on `<robot>/plant_markers` from its newest odometry and joints."""

    def __init__(
        self, node: Node, name: str, odometry: NewestMeasurement, joints: NewestMeasurement
    ) -> None:
        self._node, self._name = node, name
        self._odometry, self._joints = odometry, joints
        self._picture = RobotPicture(RobotLook(name, 0.15, 0.4, 1.0), _TRAIL)
        self._stand_in = StandIn(node, f'{name}/plant_markers', self._draw)

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Draw the robot as the planner's parameters have it."""
        separation = values['arena.minimum_separation']
        look = RobotLook(self._name, _BODY * separation, separation, values['limits.thrust'])
        self._picture.set_up(look, _TRAIL)

    def publish(self, markers: MarkerArray) -> None:
        """Publish something else among the robot's markers."""
        self._stand_in.publisher.publish(markers)

    def _draw(self) -> MarkerArray | None:
        now, newest = self._node.get_clock().now(), self._odometry.newest
        if newest is None or (now.nanoseconds - newest.instant) * NANOSECOND > OLDEST_SHOWN:
            return None
        x, y, _, _, yaw, _ = odometry_state(newest.message).tolist()
        joints, alpha, thrust = self._joints.newest, 0.0, 0.0
        if joints is not None:
            alpha, thrust = thruster_angle(joints.message), _thrust(joints.message)
        self._picture.add(newest.instant, x, y)
        return self._picture.draw(now.to_msg(), RobotState(x, y, yaw, alpha, thrust))


def _thrust(message: JointState) -> float:
    """Effort of the joint `thruster` [N]; 0 where the driver does not tell."""
    with suppress(InvalidProblem, IndexError):
        (index,) = joint_indices(message.name, ROBOT_JOINTS[:1])
        return float(message.effort[index])
    return 0.0
