# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Everything of a recording that a report can use: arrays and plain messages, by topic."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plant_kind import QUANTITIES
from tdm_planner.trajectory import NANOSECOND
from tdm_sim.report.bag_files import Raw

Array = NDArray[np.float64]

JOINT_STATE = 'sensor_msgs/msg/JointState'
ODOMETRY = 'nav_msgs/msg/Odometry'
PLAN = 'trajectory_msgs/msg/JointTrajectory'
STRING = 'std_msgs/msg/String'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
STATUSES = 'action_msgs/msg/GoalStatusArray'
LOG = 'rcl_interfaces/msg/Log'
CLOCK = 'rosgraph_msgs/msg/Clock'

ODOMETRY_COLUMNS = ('x', 'y', 'qx', 'qy', 'qz', 'qw', 'vx', 'vy', 'omega')

_STREAMS = (JOINT_STATE, ODOMETRY)
_MESSAGES = (PLAN, DIAGNOSTICS, STATUSES, LOG, CLOCK)
_LATEST = 2**63 - 1  # ns
_LARGEST = 1e100  # a number beyond it is damage; its square still is a number
_MOST_COLUMNS = 200  # of a topic
_MOST_MESSAGES = 20_000  # of a topic that is not a stream of numbers
_DAY = 86_400.0  # s


def wanted(topic: str, kind: str) -> bool:
    """Whether a report has a use for a topic."""
    if kind == STRING:
        return topic.rsplit('/', 1)[-1] == 'plan_summary'
    return kind in _STREAMS or kind in _MESSAGES


@dataclass(frozen=True, eq=False)
class Stream:
    """
    Numbers of a topic: `instants` (n,) ns, increasing, and columns by name (n,).

    Columns of a JointState are ``joint.position`` and so on. NaN: not in that message.
    """

    instants: NDArray[np.int64]
    columns: Mapping[str, Array]
    frame: str = ''

    def column(self, name: str) -> Array:
        """Return a column; NaN throughout if there is none of this name."""
        return self.columns.get(name, np.full(self.instants.size, np.nan))

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints."""
        return frozenset(name.rsplit('.', 1)[0] for name in self.columns)


@dataclass(frozen=True, eq=False)
class Received:
    """A message, and when it was recorded [ns]."""

    message: Any
    stamp: int


@dataclass(frozen=True, eq=False)
class RecordedTopics:
    """A recording by topic. `malformed` counts messages that could not be read, by topic."""

    streams: Mapping[str, Stream]
    messages: Mapping[str, Sequence[Received]]
    types: Mapping[str, str]
    malformed: Mapping[str, int]
    not_finite: Mapping[str, int]

    def of_type(self, kind: str, name: str = '') -> dict[str, Sequence[Received]]:
        """Return the messages of every topic of a type, and of the name `name` if it is given."""
        return {
            topic: found
            for topic, found in self.messages.items()
            if self.types[topic] == kind and (not name or topic.rsplit('/', 1)[-1] == name)
        }

    def stream(self, topic: str, kind: str) -> Stream | None:
        """Return the numbers of a topic; None if there are none of this type."""
        found = self.streams.get(topic) if self.types.get(topic) == kind else None
        return found if found is not None and found.instants.size else None


@dataclass
class _StreamParts:
    """A topic's numbers as they come in: one row by name, and its instant, a message."""

    rows: list[dict[str, float]] = field(default_factory=list)
    instants: list[int] = field(default_factory=list)
    names: dict[str, None] = field(default_factory=dict)
    frame: str = ''

    def take(self, message: Any, stamp: int) -> None:
        """Keep a message's numbers; ValueError where it contradicts itself."""
        if hasattr(message, 'pose'):
            row = dict(zip(ODOMETRY_COLUMNS, _odometry(message), strict=True))
            self.frame = message.header.frame_id
        else:
            row = _joints(message)
        if len({**self.names, **row}) > _MOST_COLUMNS:
            raise ValueError('too many joints')
        self.names |= dict.fromkeys(row)
        self.rows.append(row)
        self.instants.append(nanoseconds_of(message.header.stamp) or stamp)

    def stream(self) -> tuple[Stream, int]:
        """Return everything in order of time, and how many messages held infinities or NaN."""
        instants = np.array(self.instants, dtype=np.int64)
        nothing = dict.fromkeys(self.names, 0.0)  # which is sound
        absent = np.array([[name not in row for name in self.names] for row in self.rows])
        values = np.array([list((nothing | row).values()) for row in self.rows], dtype=float)
        sound = np.abs(values) < _LARGEST
        values[~sound | absent] = np.nan
        order = np.argsort(instants, kind='stable')
        away = (instants[order] - instants[order[order.size // 2]]) * NANOSECOND
        order = order[np.abs(away) < _DAY]  # of one recording, as most others
        columns = dict(zip(self.names, values[order].T, strict=True))
        return Stream(instants[order], columns, self.frame), int((~sound).any(axis=1).sum())


def _joints(message: Any) -> dict[str, float]:
    """Return the numbers of a JointState; ValueError where it contradicts itself."""
    if len(set(message.name)) != len(message.name):
        raise ValueError('joints that are named twice')
    row: dict[str, float] = {}
    for quantity in QUANTITIES:
        values = getattr(message, quantity).tolist()
        if values:
            names = [f'{joint}.{quantity}' for joint in message.name]
            row |= zip(names, values, strict=True)
    return row


def _odometry(message: Any) -> list[float]:
    pose, twist = message.pose.pose, message.twist.twist
    turn = pose.orientation
    at = [pose.position.x, pose.position.y, turn.x, turn.y, turn.z, turn.w]
    return [*at, twist.linear.x, twist.linear.y, twist.angular.z]


def gather(messages: Iterable[Raw]) -> RecordedTopics:
    """Sort the messages of a recording by topic and read them."""
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    parts: dict[str, _StreamParts] = {}
    others: dict[str, list[Received]] = {}
    types: dict[str, str] = {}
    malformed: Counter[str] = Counter()
    for topic, kind, stamp, data in messages:
        types[topic] = kind
        at = min(max(stamp, 0), _LATEST)
        received = others.setdefault(topic, []) if kind not in _STREAMS else []
        if len(received) >= _MOST_MESSAGES:
            continue
        try:
            message = store.deserialize_cdr(data, kind)
            if kind in _STREAMS:
                parts.setdefault(topic, _StreamParts()).take(message, at)
            else:
                received.append(Received(message, at))
        except Exception:  # noqa: B902
            # The library raises many kinds for bytes that are not such a message.
            malformed[topic] += 1
    read = {topic: part.stream() for topic, part in parts.items() if part.rows}
    return RecordedTopics(
        streams={topic: stream for topic, (stream, _) in read.items()},
        messages=others,
        types=types,
        malformed=malformed,
        not_finite={topic: count for topic, (_, count) in read.items() if count},
    )
