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

"""The newest measurement of a topic, and whether it is fresh enough to plan from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from tdm_planner.exceptions import InvalidProblem, NoState
from tdm_planner.nodes.messages import nanoseconds_of
from tdm_planner.trajectory import NANOSECOND


@dataclass(frozen=True)
class Received:
    """A message, and the instant it tells of [ns]."""

    message: Any
    instant: int


class NewestMeasurement:
    """
    Keeps the newest message of a topic; a stamp of zero is taken for the time of arrival.

    `check` raises InvalidProblem for a message that does not hold the state; such messages are
    passed over (others may publish on the topic), but named when there is no better one. Every
    other message is also given to `observer`.
    """

    def __init__(
        self,
        node: Node,
        message_type: Any,
        topic: str,
        check: Callable[[Any], Any],
        observer: Callable[[Received], None] | None = None,
    ) -> None:
        self._node = node
        self._check = check
        self._observer = observer
        self._newest: Received | None = None
        self._fault = ''
        self._subscription = node.create_subscription(
            message_type, topic, self._receive, qos_profile_sensor_data
        )
        self.topic: str = self._subscription.topic_name

    @property
    def newest(self) -> Received | None:
        """Return the newest message that holds the state."""
        return self._newest

    @property
    def missing(self) -> str:
        """Say that no state was received yet; '' once there is one."""
        return '' if self._newest else f'no state was received on {self.topic}{self._last_fault}'

    @property
    def _last_fault(self) -> str:
        return f'; the last message there does not hold it: {self._fault}' if self._fault else ''

    def age(self, now: int) -> float | None:
        """Age of the newest message [s]; None if there is none."""
        newest = self._newest
        return None if newest is None else (now - newest.instant) * NANOSECOND

    def fresh(self, now: int, max_age: float) -> Received:
        """
        Return the newest message, not older than `max_age` s at the instant `now` [ns].

        Raises
        ------
        NoState
            If there is none, or it is too old, or from the future by more than `max_age`.

        """
        newest, fault = self._newest, self._last_fault
        if newest is None:
            raise NoState(self.missing)
        age = (now - newest.instant) * NANOSECOND
        if age > max_age:
            raise NoState(
                f'the newest state on {self.topic} is {age:.3g} s old: must not be older than '
                f'{max_age:g} s (start.max_age){fault}'
            )
        if age < -max_age:
            raise NoState(
                f'the newest state on {self.topic} is stamped {-age:.3g} s in the future: the '
                'clocks of its publisher and of the planner differ'
            )
        return newest

    def _receive(self, message: Any) -> None:
        try:
            self._check(message)
        except InvalidProblem as error:
            self._fault = str(error)
            return
        self._fault = ''
        stamp = nanoseconds_of(message.header.stamp)
        arrival = self._node.get_clock().now().nanoseconds
        self._newest = Received(message, stamp or arrival)
        if self._observer is not None:
            self._observer(self._newest)
