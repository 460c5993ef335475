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

"""A planner that was killed and restarted gets the active plan back from those who follow it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import time

from rclpy.timer import Timer
from tdm_planner.nodes.adapters import Adapter
from tdm_planner.nodes.managed import ManagedNode
from tdm_planner.trajectory import Trajectory

WINDOW = 10.0  # s from the start in which a plan that is followed is taken for an earlier own one
GRACE = 1.0  # s in which the planner that has published it, if it lives, can be heard

Recover = Callable[[Mapping[str, Trajectory], int], None]


class Recovery:
    """
    Hands what the trackers follow when the node starts to `recover`, after `GRACE`.

    That is: trajectories by vehicle, and the instant [ns] at which they start.
    """

    def __init__(self, node: ManagedNode, adapter: Adapter, recover: Recover) -> None:
        self._node, self._recover = node, recover
        self._until = time.monotonic() + WINDOW
        self._found: tuple[Mapping[str, Trajectory], int] | None = None
        self._timer: Timer | None = None
        adapter.watch_plans_followed(self._on_found)

    def _on_found(self, trajectories: Mapping[str, Trajectory], start: int) -> None:
        if self._timer is None and time.monotonic() > self._until:
            return  # what was found before, and waits for the node, is to be of the newest
        self._found = (trajectories, start) if trajectories else None
        if self._timer is None:
            self._timer = self._node.create_timer(GRACE, self._on_timer)

    def _on_timer(self) -> None:
        if self._timer is None or not self._node.active:
            return
        self._node.destroy_timer(self._timer)
        self._timer = None
        found, self._found = self._found, None
        if found is not None:
            self._recover(*found)
