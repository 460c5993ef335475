# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Simulated time for a rig of real processes that waits for them, and that can be spoiled.

`/clock` advances at the pace of real time, and slower where one of the processes is late: each is
seen to have come along by the stamps on the topics that `followers` names. So a busy machine makes
a mission longer, and changes nothing else. What is done to the clock comes as JSON on
`clock_order` (see `Order`) and is acknowledged, word for word, on `clock_order_taken`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
import json
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.clock import Clock as Timepiece
from rclpy.clock import ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, to_stamp
from tdm_planner.nodes.runtime import run

SECOND = 1_000_000_000  # ns
BEGIN = 1000 * SECOND
STEP = 2_500_000  # ns
LONGEST_PAUSE = 1.0  # s after which it goes on by a step: a timer may wait for that, too
LAG = 12_500_000  # ns that a follower may be behind
PATIENCE = 10.0  # s after which a silent follower is not waited for any more


@dataclass(frozen=True)
class Order:
    """
    What is done to the clock: it leaps by `leap` s, stops while `paused`.

    `odd`, times [s] that are published in between, now and then, are no times at all.
    """

    leap: float = 0.0
    paused: bool = False
    odd: tuple[float, ...] = ()


class LockstepClock(Node):
    """Publishes `/clock`."""

    def __init__(self) -> None:
        super().__init__('lockstep_clock')
        self._now = BEGIN
        self._order = Order()
        self._count = 0
        self._moved = time.monotonic()
        self._seen: dict[str, tuple[int, float]] = {}
        self._publisher = self.create_publisher(Clock, '/clock', 10)
        self._taken = self.create_publisher(String, 'clock_order_taken', LATCHED)
        self.create_subscription(String, 'clock_order', self._on_order, LATCHED)
        for topic in self.declare_parameter('followers', ['joint_states']).value:
            kind = Header if topic.endswith('passed') else JointState
            self.create_subscription(kind, topic, partial(self._on_follower, topic), 10)
        self.create_timer(
            STEP / SECOND, self._advance, clock=Timepiece(clock_type=ClockType.STEADY_TIME)
        )

    def _on_order(self, message: String) -> None:
        self._order = Order(**json.loads(message.data))
        self._now += round(self._order.leap * SECOND)
        if self._order.leap:
            self._seen.clear()
        self._taken.publish(message)

    def _on_follower(self, topic: str, message: Any) -> None:
        header = message if isinstance(message, Header) else message.header
        self._seen[topic] = nanoseconds_of(header.stamp), time.monotonic()

    @property
    def _in_step(self) -> bool:
        now = time.monotonic()
        return all(
            0 <= self._now - stamp < LAG or now - at > PATIENCE
            for stamp, at in self._seen.values()
        )

    def _advance(self) -> None:
        now = time.monotonic()
        if not self._order.paused and (self._in_step or now - self._moved > LONGEST_PAUSE):
            self._now += STEP
            self._moved = now
        self._publisher.publish(Clock(clock=to_stamp(self._now)))
        self._count += 1
        if self._order.odd and self._count % 20 == 0:
            odd = self._order.odd[self._count // 20 % len(self._order.odd)]
            self._publisher.publish(Clock(clock=Time(sec=int(odd), nanosec=1)))


if __name__ == '__main__':
    sys.exit(run(LockstepClock))
