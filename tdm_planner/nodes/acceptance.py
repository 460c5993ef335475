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

"""Whether those who are to follow a plan do: a tracker may refuse it, one of many among them."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.timer import Timer
from tdm_planner.nodes.adapters import Adapter
from tdm_planner.nodes.motion_clock import pacing_clock
from tdm_planner.trajectory import NANOSECOND

GRACE = 0.3  # s from a plan's start until trackers must have told that they follow it


class Acceptance:
    """
    Looks, shortly after the start of every published plan, who of the trackers does not follow it.

    `warning` names them, '' where there are none; `changed` is called when it comes. Trackers that
    do not tell what they follow are taken to follow.
    """

    def __init__(self, node: Node, adapter: Adapter, changed: Callable[[], None]) -> None:
        self._node, self._adapter, self._changed = node, adapter, changed
        self._timer: Timer | None = None
        self.warning = ''

    def forget(self) -> None:
        """Expect nothing any more."""
        self.warning = ''
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def expect(self, plan_id: int, start: int) -> None:
        """Look after the instant `start` [ns] whether the plan is followed."""
        self.forget()

        def look() -> None:
            self.forget()
            names = self._adapter.not_following(start)
            if names:
                self.warning = (
                    f'plan {plan_id} is not followed by {", ".join(names)}: the tracker says why'
                )
                self._node.get_logger().warning(self.warning)
                self._changed()

        now = int(self._node.get_clock().now().nanoseconds)
        wait = max((start - now) * NANOSECOND, 0.0) + GRACE
        self._timer = self._node.create_timer(wait, look, clock=pacing_clock(self._node))
