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

"""What the trackers of a formation say they follow, put together to one plan for all robots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.adapters.base import Found
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of
from tdm_planner.nodes.robot_messages import robot_trajectory
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory


class FollowedPlans:
    """
    Listens to `<robot>/trajectory_in_force` and `<robot>/controls_in_force` of all `robots`.

    Hands a plan to `found` when all trackers follow parts of it, that is, of one stamp, and none
    when they have given it up.
    """

    def __init__(self, node: Node, robots: Sequence[str], found: Found) -> None:
        self._robots, self._found = robots, found
        self._newest: dict[tuple[str, str], Any] = {}
        for robot in robots:
            self._listen(node, robot, 'trajectory_in_force', MultiDOFJointTrajectory)
            self._listen(node, robot, 'controls_in_force', JointTrajectory)

    def _listen(self, node: Node, robot: str, topic: str, kind: Any) -> None:
        def on_message(message: Any) -> None:
            self._newest[robot, topic] = message
            self._look()

        node.create_subscription(kind, f'{robot}/{topic}', on_message, LATCHED)

    def _look(self) -> None:
        stamps = {nanoseconds_of(message.header.stamp) for message in self._newest.values()}
        if len(self._newest) < 2 * len(self._robots) or len(stamps) > 1:
            return
        try:
            trajectories = {
                robot: robot_trajectory(
                    self._newest[robot, 'trajectory_in_force'],
                    self._newest[robot, 'controls_in_force'],
                    robot,
                )
                for robot in self._robots
            }
        except InvalidProblem:
            trajectories = {}
        self._found(trajectories, stamps.pop())
