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

"""What a tracker follows, latched for whoever joins: viewers, and a planner that was restarted."""

from __future__ import annotations

from rclpy.node import Node
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.tracking.tracker import Motion
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory


class InForce:
    """Publishes the message of the newest plan followed, or an empty one when it is given up."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(JointTrajectory, 'trajectory_in_force', LATCHED)
        self._accepted: list[tuple[Trajectory, bytes]] = []
        self._announced: Trajectory | None = None

    def accepted(self, trajectory: Trajectory, message: bytes) -> None:
        """Take note of the message, as it came, of an accepted trajectory."""
        self._accepted.append((trajectory, message))

    def update(self, current: Motion | None, following: Motion | None) -> None:
        """Tell of a change; `following` is to take over from `current`."""
        newest = following or current
        trajectory = None if newest is None else newest.trajectory
        if trajectory is self._announced:
            return
        self._announced = trajectory
        kept = [motion.trajectory for motion in (current, following) if motion is not None]
        self._accepted = [
            item for item in self._accepted if any(item[0] is other for other in kept)
        ]
        told = [message for accepted, message in self._accepted if accepted is trajectory]
        self._publisher.publish(told[0] if told else JointTrajectory())
