# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A node between plant and tracker that spoils the stream of states, as it is told.

Every topic that the parameter `topics` names is passed on to ``relayed/<topic>``. What goes wrong
comes as JSON on `fault` (see `Fault`) and is acknowledged, word for word, on `fault_taken`. When
it goes wrong is decided by the stamps of the messages, and chance is seeded: a fault hits the
same messages however busy the machine is. `passed` tells how far it has come.
"""

from __future__ import annotations

from collections.abc import Callable
import copy
from dataclasses import dataclass
import heapq
import itertools
import json
import math
import random
import sys
from typing import Any

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, to_stamp
from tdm_planner.nodes.ros_parameters import ParameterNode
from tdm_planner.nodes.runtime import run
from tdm_planner.parameters import ParameterSpec

SECOND = 1_000_000_000  # ns
PERIOD = 0.002  # s between looks at what is held back
DEPTH = 200


@dataclass(frozen=True)
class Fault:
    """
    What goes wrong with messages stamped in [`start`, `end`) ns.

    `kind` and what its `amount` means:

    - none: they pass;
    - freeze: nothing comes;
    - repeat: the last message before comes again and again, its stamp included;
    - stuck: the last message before comes again and again, with fresh stamps;
    - delay: they come `amount` s late;
    - drop: each is lost with the probability `amount`;
    - duplicate: each comes twice, the second time up to `amount` s later;
    - reorder: each comes up to `amount` s late, whatever came before it;
    - shift: their stamps are wrong by `amount` s, from the least instant that can be written on;
    - unstamped: their stamps are zero.
    """

    kind: str = 'none'
    amount: float = 0.0
    start: int = 0
    end: int = 2**62
    seed: int = 0


class Line:
    """One topic: turns a message into those that are passed on, each with its delay [s]."""

    def __init__(self) -> None:
        self._last: Any = None
        self.suffer(Fault())

    def suffer(self, fault: Fault) -> None:
        """Put a fault in force in place of the one before."""
        self.fault = fault
        self._random = random.Random(fault.seed)

    def passed(self, message: Any) -> list[tuple[float, Any]]:
        """Return what becomes of a message."""
        fault, stamp = self.fault, message.header.stamp
        if not fault.start <= nanoseconds_of(stamp) < fault.end:
            self._last = message
            return [(0.0, message)]
        effect: Callable[[Any], list[tuple[float, Any]]] = getattr(self, f'_{fault.kind}')
        return effect(message)

    def _none(self, message: Any) -> list[tuple[float, Any]]:
        return [(0.0, message)]

    def _freeze(self, message: Any) -> list[tuple[float, Any]]:
        return []

    def _repeat(self, message: Any) -> list[tuple[float, Any]]:
        return [] if self._last is None else [(0.0, self._last)]

    def _stuck(self, message: Any) -> list[tuple[float, Any]]:
        if self._last is None:
            return []
        again = copy.deepcopy(self._last)
        again.header.stamp = message.header.stamp
        return [(0.0, again)]

    def _delay(self, message: Any) -> list[tuple[float, Any]]:
        return [(self.fault.amount, message)]

    def _drop(self, message: Any) -> list[tuple[float, Any]]:
        return [] if self._random.random() < self.fault.amount else [(0.0, message)]

    def _duplicate(self, message: Any) -> list[tuple[float, Any]]:
        return [(0.0, message), (self._random.uniform(0.0, self.fault.amount), message)]

    def _reorder(self, message: Any) -> list[tuple[float, Any]]:
        return [(self._random.uniform(0.0, self.fault.amount), message)]

    def _shift(self, message: Any) -> list[tuple[float, Any]]:
        stamp = nanoseconds_of(message.header.stamp) + round(self.fault.amount * SECOND)
        message.header.stamp = to_stamp(max(stamp, -(2**31) * SECOND))
        return [(0.0, message)]

    def _unstamped(self, message: Any) -> list[tuple[float, Any]]:
        message.header.stamp = Time()
        return [(0.0, message)]


_TOPICS = ParameterSpec(
    name='topics', kind=list[str], default=['joint_states'], description='what to pass on'
)


class FaultyRelay(ParameterNode):
    """Passes topics on through a `Line` each; one fault for all."""

    def __init__(self) -> None:
        super().__init__('faulty_relay', {_TOPICS.name: _TOPICS})
        self._order = itertools.count()
        self._held: list[tuple[float, int, Any, Any]] = []
        self._lines: dict[str, Line] = {}
        for topic in self.parameter_values[_TOPICS.name]:
            self._connect(topic)
        self._taken = self.create_publisher(String, 'fault_taken', LATCHED)
        self.create_subscription(String, 'fault', self._on_fault, LATCHED)
        self._passed = self.create_publisher(Header, 'passed', DEPTH)
        self.create_timer(PERIOD, self._release)

    def _connect(self, topic: str) -> None:
        kind = Odometry if topic.endswith('odom') else JointState
        publisher = self.create_publisher(kind, f'relayed/{topic}', DEPTH)
        line = self._lines[topic] = Line()
        self.create_subscription(
            kind, topic, lambda message: self._pass_on(line, publisher, message), DEPTH
        )

    def _on_fault(self, message: String) -> None:
        fault = Fault(**json.loads(message.data))
        for number, line in enumerate(self._lines.values()):
            line.suffer(Fault(**{**vars(fault), 'seed': fault.seed + number}))
        self._taken.publish(message)

    def _pass_on(self, line: Line, publisher: Any, message: Any) -> None:
        now = self.get_clock().now().nanoseconds / SECOND
        for delay, passed in line.passed(message):
            if delay == 0.0:
                publisher.publish(passed)
                continue
            heapq.heappush(self._held, (now + delay, next(self._order), publisher, passed))
        self._passed.publish(Header(stamp=self.get_clock().now().to_msg()))

    def _release(self) -> None:
        now = self.get_clock().now().nanoseconds / SECOND
        while self._held and self._held[0][0] <= now:
            _, _, publisher, message = heapq.heappop(self._held)
            publisher.publish(message)


def stamps(start: float, seconds: float = math.inf) -> dict[str, int]:
    """Return `start` and `end` of a fault from the instant [s] and the duration [s]."""
    end = 2**62 if math.isinf(seconds) else round((start + seconds) * SECOND)
    return {'start': round(start * SECOND), 'end': end}


if __name__ == '__main__':
    sys.exit(run(FaultyRelay))
