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

`joint_states` is passed on to `relayed/joint_states`. What goes wrong comes as JSON on `fault`
(see `Fault`) and is acknowledged, word for word, on `fault_taken`. When it goes wrong is decided
by the stamps of the messages, and chance is seeded: a fault hits the same messages however busy
the machine is. `passed` tells how far it has come.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
import heapq
import itertools
import json
import random
import sys

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, to_stamp
from tdm_planner.nodes.ros_parameters import ParameterNode
from tdm_planner.nodes.runtime import run

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


class FaultyRelay(ParameterNode):
    """Passes the states on."""

    def __init__(self) -> None:
        super().__init__('faulty_relay', {})
        self._order = itertools.count()
        self._held: list[tuple[float, int, JointState]] = []
        self._last: JointState | None = None
        self._suffer(Fault())
        self._publisher = self.create_publisher(JointState, 'relayed/joint_states', DEPTH)
        self._taken = self.create_publisher(String, 'fault_taken', LATCHED)
        self._passed = self.create_publisher(Header, 'passed', DEPTH)
        self.create_subscription(JointState, 'joint_states', self._on_state, DEPTH)
        self.create_subscription(String, 'fault', self._on_fault, LATCHED)
        self.create_timer(PERIOD, self._release)

    def _suffer(self, fault: Fault) -> None:
        self._fault, self._random = fault, random.Random(7)

    def _on_fault(self, message: String) -> None:
        self._suffer(Fault(**json.loads(message.data)))
        self._taken.publish(message)

    def _on_state(self, message: JointState) -> None:
        now = self.get_clock().now()
        if not self._fault.start <= nanoseconds_of(message.header.stamp) < self._fault.end:
            self._last = message
            found = [(0.0, message)]
        else:
            found = self._spoilt(message)
        for delay, state in found:
            if delay == 0.0:
                self._publisher.publish(state)
            else:
                due = now.nanoseconds / SECOND + delay
                heapq.heappush(self._held, (due, next(self._order), state))
        self._passed.publish(Header(stamp=now.to_msg()))

    def _spoilt(self, message: JointState) -> list[tuple[float, JointState]]:
        """Return what becomes of a message: those that come, each with its delay [s]."""
        kind, amount, stamp = self._fault.kind, self._fault.amount, message.header.stamp
        chance = self._random.random()
        if kind == 'freeze' or (kind == 'drop' and chance < amount):
            return []
        if kind in ('repeat', 'stuck'):
            again = copy.deepcopy(self._last or message)
            if kind == 'stuck':
                again.header.stamp = stamp
            return [(0.0, again)]
        if kind == 'duplicate':
            return [(0.0, message), (chance * amount, message)]
        if kind in ('delay', 'reorder'):
            return [(amount if kind == 'delay' else chance * amount, message)]
        if kind == 'shift':
            shifted = nanoseconds_of(stamp) + round(amount * SECOND)
            message.header.stamp = to_stamp(max(shifted, -(2**31) * SECOND))
        elif kind == 'unstamped':
            message.header.stamp = Time()
        return [(0.0, message)]

    def _release(self) -> None:
        now = self.get_clock().now().nanoseconds / SECOND
        while self._held and self._held[0][0] <= now:
            self._publisher.publish(heapq.heappop(self._held)[2])


if __name__ == '__main__':
    sys.exit(run(FaultyRelay))
