# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of plants that do not draw themselves, from their measured states."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from tdm_planner.nodes.markers import MARKER_DEPTH
from visualization_msgs.msg import MarkerArray

MARKER_RATE = 20.0  # Hz
OLDEST_SHOWN = 0.5  # s; a state older than that is not drawn any more


class StandIn:
    """Publishes `draw()` on `topic` while somebody looks and nobody else publishes there.

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
