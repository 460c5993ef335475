# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Other planners in the same namespace: a second one started by mistake, or this one's predecessor.

A planner that was killed and restarted recovers the active plan from the trackers that follow it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import partial
import json
import time

from rclpy.node import Node
from rclpy.timer import Timer
from std_msgs.msg import String
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.adapter import Vehicle
from tdm_planner.nodes.diagnostics import PublisherCount
from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory

TOPIC = 'plan_summary'
WINDOW = 10.0  # s after the node's start in which a followed plan counts as the predecessor's
GRACE = 1.0  # s for a living planner's summary of that plan to arrive
_REMEMBERED = 64  # plans
_SECOND = 1_000_000_000  # ns
_LATEST = 2**31 * _SECOND  # ns that no stamp reaches


class OtherPlanners:
    """
    Listens to every planner's `plan_summary`, and counts its publishers.

    `on_plan(start)` is called for every plan of another planner, with the instant [ns] at which
    its motion starts; `changed` when `warning` appears or disappears.
    """

    def __init__(
        self, node: Node, on_plan: Callable[[int], None], changed: Callable[[], None]
    ) -> None:
        self._on_plan = on_plan
        self._own: deque[int] = deque(maxlen=_REMEMBERED)
        self._others: deque[int] = deque(maxlen=_REMEMBERED)
        self._count = PublisherCount(
            node,
            node.resolve_topic_name(TOPIC),
            'trackers follow the plan that starts last; run only one of them',
            changed,
        )
        node.create_subscription(String, TOPIC, self._on_summary, LATCHED)

    @property
    def warning(self) -> str:
        """One sentence, '' where there is no other planner."""
        return self._count.warning

    def publishes(self, start: int) -> None:
        """Register an own plan before its summary is published."""
        self._own.append(start)

    def published(self, start: int) -> bool:
        """Whether another planner has published the plan that starts at the instant [ns]."""
        return start in self._others

    def _on_summary(self, message: String) -> None:
        try:
            stamp = json.loads(message.data)['stamp']
            start = int(stamp['sec']) * _SECOND + int(stamp['nanosec'])
        except (ArithmeticError, ValueError, TypeError, KeyError, RecursionError):
            return  # not a planner's
        if 0 <= start < _LATEST and start not in self._own:
            self._others.append(start)
            self._on_plan(start)


class Recovery:
    """
    Hands the plan that the trackers follow when the node starts to `recover`, after `GRACE`.

    `recover` gets the trajectories by vehicle and the instant [ns] of their common start. If
    starts differ, the trajectories are not parts of one plan, and `recover` is not called.
    """

    def __init__(
        self,
        node: ManagedNode,
        vehicles: Collection[Vehicle],
        recover: Callable[[Mapping[str, Trajectory], int], None],
    ) -> None:
        self._node, self._recover, self._count = node, recover, len(vehicles)
        self._until = time.monotonic() + WINDOW
        self._newest: dict[str, tuple[Trajectory | None, int]] = {}
        self._found: tuple[Mapping[str, Trajectory], int] | None = None
        self._timer: Timer | None = None
        for vehicle in vehicles:
            topic = f'{vehicle.prefix}active_trajectory'
            take = partial(self._on_message, vehicle)
            node.create_subscription(JointTrajectory, topic, take, LATCHED)

    def _on_message(self, vehicle: Vehicle, message: JointTrajectory) -> None:
        """Store the plan that one tracker follows; an empty message means none."""
        trajectory, start = None, nanoseconds_of(message.header.stamp)
        with suppress(InvalidProblem):
            trajectory = read_plan(vehicle.kind, message)
        self._newest[vehicle.name] = trajectory, start
        told = self._newest.items()
        if len(told) == self._count and all(stamp == start for _, (_, stamp) in told):
            whole = {name: plan for name, (plan, _) in told if plan is not None}
            self._on_found(whole if len(whole) == self._count else {}, start)

    def _on_found(self, trajectories: Mapping[str, Trajectory], start: int) -> None:
        if self._timer is None and time.monotonic() > self._until:
            return  # too late to be a predecessor's plan
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
