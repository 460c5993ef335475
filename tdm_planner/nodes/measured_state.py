# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A plant's measured state from the topics it comes on, for planners and trackers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem, NoState
from tdm_planner.nodes.qos import NEWEST
from tdm_planner.nodes.reading import nanoseconds_of, read_joints, read_odometry
from tdm_planner.plant_kind import PlantKind
from tdm_planner.trajectory import NANOSECOND

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Received:
    """A message, the states it holds by name, and the instant of their measurement [ns]."""

    message: Any
    states: Mapping[str, float]
    instant: int


class NewestMeasurement:
    """
    Keeps the newest message of a topic; a stamp of zero means the time of arrival.

    `read` raises InvalidProblem for a message that does not hold the states. Such a message is
    ignored: `ignored` is called with the reason, and `missing` quotes it until a valid message
    arrives. Every other message becomes the `newest`, and `observer` is called.
    """

    def __init__(
        self,
        node: Node,
        message_type: Any,
        topic: str,
        read: Callable[[Any], Mapping[str, float]],
        observer: Callable[[], None],
        ignored: Callable[[str], None],
    ) -> None:
        self._node = node
        self._read = read
        self._observer, self._ignored = observer, ignored
        self.newest: Received | None = None
        self._fault = ''
        subscription = node.create_subscription(message_type, topic, self._receive, NEWEST)
        self.topic: str = subscription.topic_name

    @property
    def missing(self) -> str:
        """Say that no state was received yet; '' once there is one."""
        return '' if self.newest else f'no state was received on {self.topic}{self._last_fault}'

    @property
    def _last_fault(self) -> str:
        return f'; the last message there does not hold it: {self._fault}' if self._fault else ''

    def age(self, now: int) -> float | None:
        """Age of the newest message [s]; None if there is none."""
        newest = self.newest
        return None if newest is None else (now - newest.instant) * NANOSECOND

    def fresh(self, now: int, max_age: float) -> Received:
        """
        Return the newest message, not older than `max_age` s at the instant `now` [ns].

        Raises
        ------
        NoState
            If there is none, or it is too old, or from the future by more than `max_age`.

        """
        newest, fault = self.newest, self._last_fault
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
            states = self._read(message)
        except InvalidProblem as error:
            self._fault = str(error)
            self._ignored(self._fault)
            return
        self._fault = ''
        stamp = nanoseconds_of(message.header.stamp)
        arrival = self._node.get_clock().now().nanoseconds
        self.newest = Received(message, states, stamp or arrival)
        self._observer()


class MeasuredState:
    """
    The newest state of a plant, from `odom` where it has one and from `joint_states`.

    `prefix` is the plant's namespace ('' or 'robot1/'). `observer` is called with every state and
    its instant [ns], `ignored` with the reason why a message is ignored. A state is ignored, too,
    if its parts are more than `longest()` [s] apart.
    """

    def __init__(
        self,
        node: Node,
        kind: PlantKind,
        prefix: str,
        observer: Callable[[Array, int], None],
        ignored: Callable[[str], None] = lambda _: None,
        longest: Callable[[], float] = lambda: math.inf,
    ) -> None:
        self._kind, self._prefix, self._observer = kind, prefix, observer
        self._ignored, self._longest = ignored, longest
        self.joints = NewestMeasurement(
            node,
            JointState,
            f'{prefix}joint_states',
            lambda message: read_joints(kind.measured, message, kind.state_names),
            lambda: None if kind.odometry else self._observe(),
            ignored,
        )
        self._parts = {'joint_states': self.joints}
        if kind.odometry:
            odometry = NewestMeasurement(
                node,
                Odometry,
                f'{prefix}odom',
                lambda message: read_odometry(kind, message),
                self._observe,
                ignored,
            )
            self._parts = {'odom': odometry, **self._parts}

    @property
    def topic(self) -> str:
        """Topic whose stamps are those of the states."""
        return next(iter(self._parts.values())).topic

    @property
    def missing(self) -> list[str]:
        """Return a sentence for every topic on which no state was received yet."""
        return [part.missing for part in self._parts.values() if part.missing]

    @property
    def newest(self) -> tuple[Array, int] | None:
        """Return the newest state (nx,) and its instant [ns]; None until it is complete."""
        parts = [part.newest for part in self._parts.values()]
        received = [part for part in parts if part is not None]
        return self._state(received) if len(received) == len(parts) else None

    def fresh(self, now: int, max_age: float) -> tuple[Array, int]:
        """
        Return the newest state (nx,) and its instant [ns], not older than `max_age` s at `now`.

        Raises
        ------
        NoState
            As `NewestMeasurement.fresh` does.

        """
        return self._state([part.fresh(now, max_age) for part in self._parts.values()])

    def ages(self, now: int) -> dict[str, float | None]:
        """Age [s] of the newest message by topic; None where there is none."""
        return {f'{self._prefix}{name}': part.age(now) for name, part in self._parts.items()}

    def _state(self, parts: Sequence[Received]) -> tuple[Array, int]:
        values = {name: value for part in parts for name, value in part.states.items()}
        return np.array([values[name] for name in self._kind.state_names]), parts[0].instant

    def _observe(self) -> None:
        newest = self.newest
        if newest is None:
            return
        instants = [part.newest.instant for part in self._parts.values() if part.newest]
        apart, longest = (max(instants) - min(instants)) * NANOSECOND, self._longest()
        if apart > longest:
            self._ignored(
                f'odom and the newest joint_states are {apart:.3g} s apart, more than '
                f'state_timeout = {longest:g} s'
            )
        else:
            self._observer(*newest)
