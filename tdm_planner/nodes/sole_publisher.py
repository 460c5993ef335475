# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Watches topics that only one node should publish: a second one, a mistake, is told of."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

PERIOD = 1.0  # s between looks


class SolePublisher:
    """
    Counts who publishes `topic` (resolved); where there are several, `warning` says so.

    `publishers` begins the sentence, `consequence` ends it; `changed` is called when the warning
    comes or goes. A process that was killed counts until the middleware has given it up, with Fast
    DDS some 20 s later.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        consequence: str,
        changed: Callable[[], None],
        publishers: str = 'planners',
    ) -> None:
        self._node, self._topic, self._publishers = node, topic, publishers
        self._consequence, self._changed = consequence, changed
        self.count = 0
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self.look, clock=clock)

    @property
    def warning(self) -> str:
        """One sentence, '' where there is at most one publisher."""
        if self.count < 2:
            return ''
        return f'{self.count} {self._publishers} publish {self._topic}: {self._consequence}'

    def look(self) -> int:
        """Count now, and return the count."""
        before = self.warning
        self.count = self._node.count_publishers(self._topic)
        if self.warning != before:
            if self.warning:
                self._node.get_logger().warning(self.warning)
            self._changed()
        return self.count
