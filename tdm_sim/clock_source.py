# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time, faster or slower than real time: a node drives `/clock`, and itself with it."""

from __future__ import annotations

import math
import time

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time
from rclpy.time_source import CLOCK_TOPIC, TimeSource
from rosgraph_msgs.msg import Clock

_QUEUE = 10
_NANOSECOND = 1e-9
_MOST_STEPS = 10  # that simulated time takes at once; where more are due it falls behind


class ClockSource:
    """Publishes `/clock` in steps of `step` [s]; the node's own clock shows the same time.

    Simulated time begins with the computer's and runs `speed` times as fast. It goes on in whole
    steps, so that timers of its period fire in every one of them, and never in leaps: where the
    process does not keep up, it runs slower than asked.
    """

    def __init__(self, node: Node, step: float, speed: float) -> None:
        if node.get_clock().ros_time_is_active:
            # The node is the one that tells the time: what it would hear is its own.
            off = Parameter('use_sim_time', value=False)
            Node.set_parameters_atomically(node, [off])
        self._publisher = node.create_publisher(Clock, CLOCK_TOPIC, _QUEUE)
        self._source = TimeSource()
        self._source.ros_time_is_active = True
        self._source.attach_clock(node.get_clock())
        self._step = round(step / _NANOSECOND)
        self._time = time.time_ns()
        self._due = 0.0  # steps, with the fraction of the next
        self._last = time.monotonic()
        self.speed = speed
        self._tell()

    def advance(self) -> None:
        """Bring the time up to the present, and tell it."""
        now = time.monotonic()
        elapsed, self._last = now - self._last, now
        self._due += elapsed * self.speed / (self._step * _NANOSECOND)
        steps = math.floor(self._due)
        if steps < 1:
            return
        self._due = min(self._due - steps, 1.0)
        self._time += min(steps, _MOST_STEPS) * self._step
        self._tell()

    def _tell(self) -> None:
        message = Clock(clock=Time(nanoseconds=self._time).to_msg())
        self._source.clock_callback(message)
        self._publisher.publish(message)
