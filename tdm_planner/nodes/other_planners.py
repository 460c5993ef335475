# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Other planners in the same namespace: a second one started by mistake, or this one's predecessor.

A planner that was killed and restarted recovers the active plan from the trackers that follow it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial
import json
import time

from rclpy.node import Node
from std_msgs.msg import String
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.diagnostics import PublisherCount
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.nodes.vehicle import Vehicle
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
    its motion starts; `changed` when the warning of the `count` appears or disappears. `published`
    are the starts of their last plans, `own` those of this one's, added before their summaries.
    """

    def __init__(
        self, node: Node, on_plan: Callable[[int], None], changed: Callable[[], None]
    ) -> None:
        self._on_plan = on_plan
        self.own: deque[int] = deque(maxlen=_REMEMBERED)
        self.published: deque[int] = deque(maxlen=_REMEMBERED)
        self.count = PublisherCount(
            node,
            node.resolve_topic_name(TOPIC),
            'trackers follow the plan that starts last; run only one of them',
            changed,
        )
        node.create_subscription(String, TOPIC, self._on_summary, LATCHED)

    def _on_summary(self, message: String) -> None:
        try:
            stamp = json.loads(message.data)['stamp']
            start = int(stamp['sec']) * _SECOND + int(stamp['nanosec'])
        except (ArithmeticError, ValueError, TypeError, KeyError, RecursionError):
            return  # not a planner's
        if 0 <= start < _LATEST and start not in self.own:
            self.published.append(start)
            self._on_plan(start)


class Recovery:
    """
    Finds the plan that the trackers follow when the planner starts; to be looked at repeatedly.

    Where the trackers tell of different starts, their trajectories are not parts of one plan.
    """

    def __init__(self, node: Node, vehicles: Collection[Vehicle]) -> None:
        self._vehicles = vehicles
        self._until = time.monotonic() + WINDOW
        self._told: dict[str, JointTrajectory] = {}  # by vehicle; empty: it follows none
        self._start, self._since = 0, 0.0  # of the plan that all follow [ns], told since [s]
        self._waits = False  # for GRACE to pass, and for the planner to become active
        for vehicle in vehicles:
            topic = f'{vehicle.prefix}active_trajectory'
            take = partial(self._told.__setitem__, vehicle.name)
            node.create_subscription(JointTrajectory, topic, take, LATCHED)

    def look(self, active: bool) -> tuple[dict[str, Trajectory], int] | None:
        """Return trajectories by vehicle and their start [ns], once there are any."""
        now, told, vehicles = time.monotonic(), self._told, self._vehicles
        starts = {nanoseconds_of(p.header.stamp) if p.points else 0 for p in told.values()}
        start = starts.pop() if len(told) == len(vehicles) and len(starts) == 1 else 0
        if start != self._start:
            self._start, self._since = start, now
            self._waits |= bool(start) and now < self._until  # later ones are no predecessor's
        if self._waits and active and now >= self._since + GRACE:
            self._waits = False
            if start:
                with suppress(InvalidProblem):
                    return {v.name: read_plan(v.kind, told[v.name]) for v in vehicles}, start
        return None
