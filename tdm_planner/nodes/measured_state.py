# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The newest state of a plant, as its messages tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
import math
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem, NoState
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.diagnostics import PublisherCount
from tdm_planner.nodes.messages import NEWEST
from tdm_planner.nodes.reading import read_joints, read_odometry
from tdm_planner.plant_kind import PlantKind

LATEST = 10.0  # s that a state may be late; one that is older tells of a clock that was set back


class MeasuredState:
    """
    The newest state of a plant, from `odom` where it has one and from `joint_states`.

    `prefix` is the plant's namespace ('' or 'robot1/'). Instants are those of `clock`: a stamp of
    zero means the arrival, and nothing is taken before the clock runs. `observer` is called with
    every state and its instant. A message that does not hold the states is ignored, as is a state
    whose parts are more than `longest()` [s] apart: `ignored` is called with the reason. One that
    is overtaken on its way by a newer one is dropped. Safe to read in any thread.
    """

    def __init__(
        self,
        node: Node,
        clock: MotionClock,
        kind: PlantKind,
        prefix: str,
        observer: Callable[[Array, float], None],
        ignored: Callable[[str], None] = lambda _: None,
        longest: Callable[[], float] = lambda: math.inf,
        qos: QoSProfile = NEWEST,
    ) -> None:
        self._clock, self._kind, self._prefix = clock, kind, prefix
        self._observer, self._ignored, self._longest = observer, ignored, longest
        self._newest: dict[str, tuple[Mapping[str, float], float]] = {}  # states, their instant
        self._joints = JointState()  # the newest
        self._faults: dict[str, str] = {}  # of the last message
        self._topics: dict[str, str] = {}  # resolved
        self._node, self._subscriptions = node, list[Any]()
        for name in dict.fromkeys([kind.leading, 'joint_states']):
            take = partial(self._receive, name)
            message_type = Odometry if name == 'odom' else JointState
            subscription = node.create_subscription(message_type, prefix + name, take, qos)
            self._subscriptions.append(subscription)
            self._topics[name] = subscription.topic_name

    def close(self) -> None:
        """Receive nothing any more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def count_sources(self, changed: Callable[[], None]) -> list[PublisherCount]:
        """Count the publishers of every topic; `changed` is that of `PublisherCount`."""
        harm = 'their states are taken for those of one plant; run only one of them'
        topics = self._topics.values()
        return [PublisherCount(self._node, topic, harm, changed, 'nodes') for topic in topics]

    @property
    def topic(self) -> str:
        """Topic whose stamps are those of the states."""
        return self._topics[self._kind.leading]

    @property
    def missing(self) -> list[str]:
        """Return a sentence for every topic on which no state was received yet."""
        return [
            f'no state was received on {topic}{self._fault(name)}'
            for name, topic in self._topics.items()
            if name not in self._newest
        ]

    @property
    def newest(self) -> tuple[Array, float] | None:
        """Return the newest state (nx,) and its instant [s]; None until it is complete."""
        known = self._newest.copy()  # another may come meanwhile
        return self._whole(known) if len(known) == len(self._topics) else None

    def _whole(
        self, known: Mapping[str, tuple[Mapping[str, float], float]]
    ) -> tuple[Array, float]:
        values = {k: v for states, _ in known.values() for k, v in states.items()}
        _, instant = known[self._kind.leading]
        return np.array([values[name] for name in self._kind.state_names]), instant

    @property
    def control(self) -> Array:
        """Return the controls (nu,) that the newest joints report as efforts, 0 for others."""
        efforts: dict[str, float] = {}
        for joint in self._kind.actuated:
            with suppress(InvalidProblem):
                efforts |= read_joints([joint], self._joints, [joint.effort])
        return np.array([efforts.get(name, 0.0) for name in self._kind.control_names])

    def fresh(self, now: float, max_age: float) -> tuple[Array, float]:
        """
        Return the newest state (nx,) and its instant [s], not older than `max_age` s at `now`.

        Raise NoState if there is none, or it is too old, or from the future by more than
        `max_age`.
        """
        if missing := self.missing:
            raise NoState(missing[0])
        known = self._newest.copy()  # another may come meanwhile
        for name, topic in self._topics.items():
            _, instant = known[name]
            age = now - instant
            if age > max_age:
                raise NoState(
                    f'the newest state on {topic} is {age:.3g} s old: must not be older than '
                    f'{max_age:g} s (start.max_age){self._fault(name)}'
                )
            if age < -max_age:
                raise NoState(
                    f'the newest state on {topic} is stamped {-age:.3g} s in the future: the '
                    'clocks of its publisher and of the planner differ'
                )
        return self._whole(known)

    def ages(self, now: float) -> dict[str, float | None]:
        """Age [s] of the newest message by topic; None where there is none."""
        ages = {name: now - instant for name, (_, instant) in self._newest.items()}
        return {self._prefix + name: ages.get(name) for name in self._topics}

    def _fault(self, name: str) -> str:
        fault = self._faults.get(name)
        return f'; the last message there does not hold it: {fault}' if fault else ''

    def _receive(self, name: str, message: Any) -> None:
        """Take a part of the state; the leading one completes it."""
        kind = self._kind
        try:
            if name == 'odom':
                states = read_odometry(kind, message)
            else:
                states = read_joints(kind.measured, message, kind.state_names)
        except InvalidProblem as error:
            self._faults[name] = str(error)
            self._ignored(str(error))
            return
        if not self._clock.runs:
            return
        self._faults.pop(name, None)
        at = self._clock.instant_of(message.header.stamp)
        _, last = self._newest.get(name, (states, at))
        # Not where a clock was set back, or is another than ours: those are not waited for.
        if last - LATEST < at < last <= self._clock.now() < last + LATEST:
            return
        self._newest[name] = states, at
        if name == 'joint_states':
            self._joints = message
        newest = self.newest
        if name != kind.leading or newest is None:
            return
        apart = max(abs(instant - at) for _, instant in self._newest.values())
        longest = self._longest()
        if apart > longest:
            self._ignored(
                f'odom and the newest joint_states are {apart:.3g} s apart, more than '
                f'state_timeout = {longest:g} s'
            )
        else:
            self._observer(*newest)
