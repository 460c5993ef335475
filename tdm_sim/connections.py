# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Which nodes of a demo have found each other, as they say themselves in `/diagnostics`.

That one process sees two others does not mean that they see each other: the middleware may bring
some pairs together seconds after the rest. What one node receives, only that node knows.
"""

from __future__ import annotations

from collections.abc import Mapping
import math

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from tdm_planner.nodes.diagnostics import TOPIC

_NOTHING: Mapping[str, str] = {}
_DEPTH = 100  # as many nodes may speak at once


class Connections:
    """The newest figures of every node, by its full name."""

    def __init__(self) -> None:
        self._figures: dict[str, Mapping[str, str]] = {}

    def listen(self, node: Node) -> None:
        """Subscribe to the diagnostics."""
        node.create_subscription(DiagnosticArray, TOPIC, self.take, _DEPTH)

    def take(self, message: DiagnosticArray) -> None:
        """Keep the figures of a message."""
        for status in message.status:
            name = status.name.split(':', 1)[0]
            self._figures[name] = {value.key: value.value for value in status.values}

    def tracker(self, name: str) -> bool:
        """Whether a tracker receives states and sees a planner."""
        return math.isfinite(self._figure(name, 'state age [s]', math.inf)) and (
            self._figure(name, 'planners', 0.0) >= 1.0
        )

    def plant(self, name: str) -> bool:
        """Whether a plant receives commands."""
        return self._figure(name, 'commands accepted', 0.0) >= 1.0

    def _figure(self, name: str, key: str, default: float) -> float:
        try:
            return float(self._figures.get(name, _NOTHING)[key])
        except (KeyError, ValueError):
            return default
