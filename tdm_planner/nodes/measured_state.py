# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The newest state of a plant, as its messages tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import math
from typing import Any, NamedTuple

from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem, NoState
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.messages import NEWEST
from tdm_planner.nodes.reading import read_joints, read_odometry
from tdm_planner.plant_kind import PlantKind

Array = NDArray[np.float64]


class Received(NamedTuple):
    """A message, the states it holds by name, and the instant of their measurement [s]."""

    message: Any
    states: Mapping[str, float]
    instant: float


class MeasuredState:
    """
    The newest state of a plant, from `odom` where it has one and from `joint_states`.

    `prefix` is the plant's namespace ('' or 'robot1/'). Instants are those of `clock`: a stamp of
    zero means the arrival, and nothing is taken before the clock runs. `observer` is called with
    every state and its instant. A message that does not hold the states is ignored, as is a state
    whose parts are more than `longest()` [s] apart: `ignored` is called with the reason. Safe to
    read in any thread.
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
    ) -> None:
        self._clock, self._kind, self._prefix = clock, kind, prefix
        self._observer, self._ignored, self._longest = observer, ignored, longest
        read: Callable[[Any], Mapping[str, float]] = partial(read_odometry, kind)
        sources = [('odom', Odometry, read)] if kind.odometry else []
        sources.append(('joint_states', JointState, self._read_joints))
        self._newest: dict[str, Received] = {}
        self._faults: dict[str, str] = {}  # of the last message
        self._topics: dict[str, str] = {}  # resolved
        for name, message_type, read in sources:
            take = partial(self._receive, name, read)
            subscription = node.create_subscription(message_type, prefix + name, take, NEWEST)
            self._topics[name] = subscription.topic_name
        self._leading = sources[0][0]  # its stamps are those of the states

    @property
    def topic(self) -> str:
        """Topic whose stamps are those of the states."""
        return self._topics[self._leading]

    @property
    def missing(self) -> list[str]:
        """Return a sentence for every topic on which no state was received yet."""
        return [
            f'no state was received on {topic}{self._told(name)}'
            for name, topic in self._topics.items()
            if name not in self._newest
        ]

    @property
    def joints(self) -> JointState | None:
        """Return the newest message of `joint_states`; None until there is one."""
        received = self._newest.get('joint_states')
        return None if received is None else received.message

    @property
    def newest(self) -> tuple[Array, float] | None:
        """Return the newest state (nx,) and its instant [s]; None until it is complete."""
        parts = [part for name in self._topics if (part := self._newest.get(name)) is not None]
        return self._state(parts) if len(parts) == len(self._topics) else None

    def fresh(self, now: float, max_age: float) -> tuple[Array, float]:
        """
        Return the newest state (nx,) and its instant [s], not older than `max_age` s at `now`.

        Raises
        ------
        NoState
            If there is none, or it is too old, or from the future by more than `max_age`.

        """
        missing = self.missing
        if missing:
            raise NoState(missing[0])
        for name, topic in self._topics.items():
            age = now - self._newest[name].instant
            if age > max_age:
                raise NoState(
                    f'the newest state on {topic} is {age:.3g} s old: must not be older than '
                    f'{max_age:g} s (start.max_age){self._told(name)}'
                )
            if age < -max_age:
                raise NoState(
                    f'the newest state on {topic} is stamped {-age:.3g} s in the future: the '
                    'clocks of its publisher and of the planner differ'
                )
        return self._state([self._newest[name] for name in self._topics])

    def ages(self, now: float) -> dict[str, float | None]:
        """Age [s] of the newest message by topic; None where there is none."""
        newest = {name: self._newest.get(name) for name in self._topics}
        return {
            self._prefix + name: None if part is None else now - part.instant
            for name, part in newest.items()
        }

    def _told(self, name: str) -> str:
        fault = self._faults.get(name)
        return f'; the last message there does not hold it: {fault}' if fault else ''

    def _state(self, parts: Sequence[Received]) -> tuple[Array, float]:
        values = {name: value for part in parts for name, value in part.states.items()}
        return np.array([values[name] for name in self._kind.state_names]), parts[0].instant

    def _read_joints(self, message: JointState) -> Mapping[str, float]:
        return read_joints(self._kind.measured, message, self._kind.state_names)

    def _receive(
        self, name: str, read: Callable[[Any], Mapping[str, float]], message: Any
    ) -> None:
        """Take a part of the state; the leading one completes it."""
        try:
            states = read(message)
        except InvalidProblem as error:
            self._faults[name] = str(error)
            self._ignored(str(error))
            return
        if not self._clock.runs:
            return
        self._faults.pop(name, None)
        at = self._clock.instant_of(message.header.stamp)
        self._newest[name] = Received(message, states, at)
        newest = self.newest
        if name != self._leading or newest is None:
            return
        apart = max(abs(part.instant - at) for part in self._newest.values())
        longest = self._longest()
        if apart > longest:
            self._ignored(
                f'odom and the newest joint_states are {apart:.3g} s apart, more than '
                f'state_timeout = {longest:g} s'
            )
        else:
            self._observer(*newest)
