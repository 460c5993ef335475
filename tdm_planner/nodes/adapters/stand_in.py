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

"""Pictures of plants that do not draw themselves, from their measured states."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from tdm_planner.nodes.markers import MARKER_DEPTH
from visualization_msgs.msg import MarkerArray

MARKER_RATE = 20.0  # Hz
OLDEST_SHOWN = 0.5  # s; a state older than that is not drawn any more


class StandIn:
    """
    Publishes `draw()` on `topic` while somebody looks and nobody else publishes there.

    Simulated plants draw themselves; where the plant is a real one, the planner does it.
    `draw` returns None where there is nothing to be shown.
    """

    def __init__(self, node: Node, topic: str, draw: Callable[[], MarkerArray | None]) -> None:
        self._node = node
        self._draw = draw
        self.publisher = node.create_publisher(MarkerArray, topic, MARKER_DEPTH)
        self._timer = node.create_timer(1.0 / MARKER_RATE, self._show)

    def _show(self) -> None:
        publisher = self.publisher
        if publisher.get_subscription_count() == 0:
            return
        if self._node.count_publishers(publisher.topic_name) > 1:
            return
        drawn = self._draw()
        if drawn is not None:
            publisher.publish(drawn)
