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

from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.tracking.tracker import Motion
from tdm_planner.trajectory import Trajectory

Messages = Mapping[str, Any]  # or as bytes, which rclpy publishes as they are


class InForce:
    """
    Publishes the messages of the newest trajectory in force, or empty ones when it is given up.

    `topics` are the message types by topic.
    """

    def __init__(self, node: Node, topics: Mapping[str, Any]) -> None:
        self._topics = topics
        self._publishers = {
            topic: node.create_publisher(kind, topic, LATCHED) for topic, kind in topics.items()
        }
        self._accepted: list[tuple[Trajectory, Messages]] = []
        self._announced: Trajectory | None = None

    def accepted(self, trajectory: Trajectory, messages: Messages) -> None:
        """Take note of the messages, by topic, that an accepted trajectory came in."""
        self._accepted.append((trajectory, messages))

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
        messages: Messages = {topic: kind() for topic, kind in self._topics.items()}
        for accepted, its_messages in self._accepted:
            if accepted is trajectory:
                messages = its_messages
        for topic, publisher in self._publishers.items():
            publisher.publish(messages[topic])
