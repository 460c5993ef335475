# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.
"""What the planner knows of a tracker: its `tracker_status` and its parameters."""

from __future__ import annotations

import math
import time
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.clocks import MotionClock, steady_timer
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.nodes.tracker_status import TOPIC
from tdm_planner.parameters import build, specifications
from tdm_planner.replanning import Mode
from tdm_planner.tracking.tracker_parameters import TrackerParameters

_PERIOD = 0.2  # s between attempts to ask for the parameters
_PATIENCE = 2.0  # s that an answer may take: its client may have been met only just now
_FOLLOWED = (GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_SUCCEEDED)
_ACTIVE = (GoalStatus.STATUS_ACCEPTED, *_FOLLOWED)


class TrackerWatch:
    """
    Listens to the tracker in the namespace `prefix` ('' or 'robot1/') of a planner.

    `parameters` are the tracker's, of the class `kind`; None until they are known. They are read
    when a tracker becomes active, and whenever one of them has changed. Of a tracker of no `kind`
    nothing is known but what it publishes. Instants are those of `clock` [s]. Safe in any thread.
    """

    def __init__(
        self, node: Node, clock: MotionClock, prefix: str, kind: type[TrackerParameters] | None
    ) -> None:
        self._node, self._clock, self._kind = node, clock, kind
        self._statuses: dict[int, int] | None = None  # by start [ns] as published
        self._begins: dict[int, float] = {}  # instants of these starts, when they were first told
        self.parameters: TrackerParameters | None = None
        self._names = [] if kind is None else list(specifications(kind))
        self._due = math.inf  # when to ask for the parameters [s]
        self._asked: Future | None = None
        self._topic = node.create_subscription(
            GoalStatusArray, f'{prefix}{TOPIC}', self._on_status, LATCHED
        ).topic_name
        self._client = node.create_client(GetParameters, f'{prefix}tracker/get_parameters')
        self._name = self._client.service_name.removesuffix('/get_parameters')
        node.create_subscription(
            ParameterEvent, '/parameter_events', self._on_event, qos_profile_parameter_events
        )
        steady_timer(node, _PERIOD, self._ask)

    @property
    def heard(self) -> bool:
        """Whether a tracker of this package has published its status."""
        return self._statuses is not None

    @property
    def inactive(self) -> bool:
        """Whether the tracker is not active yet, not any more, or gone after it was heard."""
        if self._statuses is None:  # its node may be there; it tells nothing until it is active
            return self._kind is not None and bool(self._client.service_is_ready())
        canceled = GoalStatus.STATUS_CANCELED
        return (
            all(status == canceled for status in self._statuses.values())
            or self._node.count_publishers(self._topic) == 0
        )

    def followed(self, now: float) -> float | None:
        """Return the start of the plan followed at the instant `now`, None for none."""
        accepted, begins = GoalStatus.STATUS_ACCEPTED, self._begins
        begun = [
            begins[start]
            for start, status in (self._statuses or {}).items()
            if status in _FOLLOWED or (status == accepted and begins[start] <= now)
        ]
        return max(begun, default=None)

    def mode(self, now: float) -> Mode:
        """
        Return what the tracker does at the instant `now`.

        If none was heard, another controller is assumed to follow the plan.
        """
        statuses = self._statuses
        if statuses is None or self.followed(now) is not None:
            return Mode.FOLLOWING
        recovers = GoalStatus.STATUS_CANCELING in statuses.values()
        return Mode.RECOVERING if recovers else Mode.IDLE

    def rejects(self, start: int) -> bool:
        """Whether the tracker neither follows nor awaits the plan of instant `start` [ns]."""
        return self._statuses is not None and self._statuses.get(start) not in _ACTIVE

    def forget_plans(self) -> None:
        """Forget the plans told so far."""
        self._statuses = None if self._statuses is None else {}

    def _on_status(self, message: GoalStatusArray) -> None:
        told = {nanoseconds_of(item.goal_info.stamp): item.status for item in message.status_list}
        known, instant = self._begins, self._clock.instant
        self._begins = {s: known[s] if s in known else instant(s) for s in told}
        self._statuses = told
        if self.parameters is None or not self._statuses:
            self._due = 0.0
            self._ask()

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node == self._name:
            self._due = 0.0

    def _ask(self) -> None:
        """Ask for the parameters when that is due, and again where no answer comes."""
        now, ready = time.monotonic(), self.heard and self._client.service_is_ready()
        if now < self._due or self._kind is None or not ready:
            return
        self._due = now + _PATIENCE
        self._asked = self._client.call_async(GetParameters.Request(names=self._names))
        self._asked.add_done_callback(self._on_answer)

    def _on_answer(self, answer: Future) -> None:
        response: Any = answer.result()
        if answer is not self._asked or self._kind is None:
            return
        if self._due > 0.0:  # else a parameter has changed meanwhile
            self._due = math.inf
        values = [parameter_value_to_python(value) for value in response.values]
        try:
            found = build(self._kind, dict(zip(self._names, values, strict=True)))
        except (InvalidProblem, ValueError) as error:
            self._node.get_logger().warning(f'parameters of {self._name} cannot be read: {error}')
        else:
            self.parameters = found
