# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated time, faster or slower than real time: a node publishes `/clock` and follows it."""

from __future__ import annotations

from collections.abc import Sequence
import math
import time
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time
from rclpy.time_source import CLOCK_TOPIC, TimeSource
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import QUEUE
from tdm_planner.nodes.reading import nanoseconds_of

_MOST_STEPS = 2  # that simulated time takes at once; where more are due it falls behind
_LONGEST_PERIOD = 20  # steps; a follower that publishes again after more of them was away
_FOLLOWER_WAIT = 2.0  # s of real time, usually, for which a silent follower is waited for
_AGAIN = 0.2  # s of real time of waiting after which the time is told again: it may have got lost


class _Follower:
    """
    A topic whose stamps show the simulated time of another node.

    A message is due in every step, until one has been waited for in vain: then the node publishes
    more seldom, or was away. Its period is the shortest seen since.
    """

    def __init__(self, node: Node, topic: str, step: int, patience: float) -> None:
        self.step = self.period = step  # ns
        self.patience = patience  # s
        self.stamp = 0  # ns
        self.heard_at = -math.inf
        # Reliable: a message that gets lost would be waited for.
        node.create_subscription(JointState, topic, self._on_message, QUEUE)

    def _on_message(self, message: JointState) -> None:
        stamp = nanoseconds_of(message.header.stamp)
        gap = stamp - self.stamp
        if self.silent:
            self.period = gap if self.step < gap <= _LONGEST_PERIOD * self.step else self.step
        elif gap > 0:
            self.period = min(self.period, max(gap, self.step))
        self.stamp, self.heard_at = stamp, time.monotonic()

    @property
    def silent(self) -> bool:
        return time.monotonic() - self.heard_at > self.patience

    def lags(self, now: int) -> bool:
        """Whether its message of the simulated instant `now` [ns], or an earlier one, is due."""
        # An older stamp, or none, is not of this time, which would wait for it without end.
        late = now - self.stamp
        return self.period <= late <= _LONGEST_PERIOD * self.step and not self.silent


class ClockSource:
    """
    Publishes `/clock` in steps of `step` [s]; the node's own clock shows the same time.

    Simulated time begins with the computer's and runs `speed` times as fast. It advances in whole
    steps, so that timers of that period fire in every one, and waits at each for the publishers of
    the topics `followers`: a busy computer delays a motion, and does not change it. One that is
    silent for `patience` s of real time is not waited for.
    """

    def __init__(
        self, node: Node, step: float, speed: float, followers: Sequence[str],
        patience: float = _FOLLOWER_WAIT,
    ) -> None:  # fmt: skip
        if node.get_clock().ros_time_is_active:
            # The node publishes /clock itself and must not subscribe to it.
            Node.set_parameters_atomically(node, [Parameter('use_sim_time', value=False)])
        self._publisher = node.create_publisher(Clock, CLOCK_TOPIC, QUEUE)
        self._source: Any = TimeSource()
        self._source.ros_time_is_active = True
        self._source.attach_clock(node.get_clock())
        self._step = round(1e9 * step)  # ns
        self._followers = [_Follower(node, topic, self._step, patience) for topic in followers]
        self._time = time.time_ns()
        self._due = 0.0  # steps, with the fraction of the next
        self._last = time.monotonic()
        self.speed = speed
        self._tell()

    def advance(self) -> None:
        """Advance the time to the present, but not ahead of the followers, and publish it."""
        now = time.monotonic()
        elapsed, self._last = now - self._last, now
        self._due = min(self._due + elapsed * self.speed * 1e9 / self._step, _MOST_STEPS + 1.0)
        for _ in range(min(math.floor(self._due), _MOST_STEPS)):
            if any(one.lags(self._time) for one in self._followers):
                if now - self._told_at > _AGAIN:
                    self._tell()
                return
            self._due -= 1.0
            self._time += self._step
            self._tell()

    def _tell(self) -> None:
        self._told_at = time.monotonic()
        message = Clock(clock=Time(nanoseconds=self._time).to_msg())
        self._source.clock_callback(message)
        self._publisher.publish(message)
