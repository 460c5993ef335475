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

"""Everything of a recording that a report can use: arrays and plain messages, by topic."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.trajectory import NANOSECOND
from tdm_sim.report.bag_files import Raw
from tdm_sim.report.cdr_columns import Columns, columns

Array = NDArray[np.float64]

JOINT_STATE = 'sensor_msgs/msg/JointState'
ODOMETRY = 'nav_msgs/msg/Odometry'
JOINT_PLAN = 'trajectory_msgs/msg/JointTrajectory'
STRING = 'std_msgs/msg/String'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
STATUSES = 'action_msgs/msg/GoalStatusArray'
LOG = 'rcl_interfaces/msg/Log'
CLOCK = 'rosgraph_msgs/msg/Clock'

QUANTITIES = ('position', 'velocity', 'effort')
ODOMETRY_COLUMNS = ('x', 'y', 'qx', 'qy', 'qz', 'qw', 'vx', 'vy', 'omega')

_STREAMS = (JOINT_STATE, ODOMETRY)
_MESSAGES = (JOINT_PLAN, DIAGNOSTICS, STATUSES, LOG, CLOCK)
_BATCH = 4096  # messages of a topic decoded at once
_LATEST = 2**63 - 1  # ns
_LARGEST = 1e100  # a number beyond it is damage; its square still is a number
_MOST_JOINTS = 64  # of a topic
_MOST_MESSAGES = 20_000  # of a topic that is not a stream of numbers

_ODOMETRY_PATHS = (
    *(f'pose.pose.position.{axis}' for axis in 'xy'),
    *(f'pose.pose.orientation.{axis}' for axis in 'xyzw'),
    *(f'twist.twist.linear.{axis}' for axis in 'xy'),
    'twist.twist.angular.z',
)


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
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(dict.fromkeys(name.rsplit('.', 1)[0] for name in self.columns))


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


@dataclass
class _StreamParts:
    """A topic's numbers as they come in."""

    kind: str
    waiting: list[tuple[int, bytes]] = field(default_factory=list)
    instants: list[NDArray[np.int64]] = field(default_factory=list)
    parts: list[dict[str, Array]] = field(default_factory=list)
    joints: set[str] = field(default_factory=set)
    frame: str = ''
    malformed: int = 0

    def take(self, definitions: Mapping[str, Any]) -> None:
        """Decode what is waiting."""
        stamps = np.array([stamp for stamp, _ in self.waiting], dtype=np.int64)
        data = [message for _, message in self.waiting]
        read = 0
        for found in columns(definitions, self.kind, data):
            taken = self._odometry(found) if self.kind == ODOMETRY else self._joints(found)
            if taken is not None:
                read += found.rows.size
                self.parts.append(taken)
                self.instants.append(_instants(found, stamps[found.rows]))
        self.malformed += len(data) - read
        self.waiting.clear()

    def _odometry(self, found: Columns) -> dict[str, Array] | None:
        self.frame = found.strings['header.frame_id'][0]
        values = [found.numbers[path][:, 0].astype(float) for path in _ODOMETRY_PATHS]
        return dict(zip(ODOMETRY_COLUMNS, values, strict=True))

    def _joints(self, found: Columns) -> dict[str, Array] | None:
        names = found.strings['name']
        self.joints |= set(names)
        if len(set(names)) != len(names) or len(self.joints) > _MOST_JOINTS:
            return None
        taken = {}
        for quantity in QUANTITIES:
            values = found.numbers[quantity]
            if values.shape[1] == len(names):
                for k, name in enumerate(names):
                    taken[f'{name}.{quantity}'] = values[:, k].astype(float)
            elif values.shape[1]:
                return None
        return taken

    def stream(self) -> tuple[Stream, int]:
        """Return everything in order of time, and how many messages held infinities or NaN."""
        instants = np.concatenate(self.instants) if self.instants else np.zeros(0, dtype=np.int64)
        names = list(dict.fromkeys(name for part in self.parts for name in part))
        found = {}
        for name in names:
            pieces = [
                part.get(name, np.full(size.size, np.nan))
                for part, size in zip(self.parts, self.instants, strict=True)
            ]
            found[name] = np.concatenate(pieces)
        order = np.argsort(instants, kind='stable')
        order = order[_plausible(instants[order])]
        bad = np.zeros(order.size, dtype=bool)
        for name, values in found.items():
            ordered = values[order]
            given = np.concatenate(
                [
                    np.full(size.size, name in part)
                    for part, size in zip(self.parts, self.instants, strict=True)
                ]
            )[order]
            sound = np.abs(ordered) < _LARGEST
            bad |= given & ~sound
            ordered[~sound] = np.nan
            found[name] = ordered
        return Stream(instants[order], found, self.frame), int(bad.sum())


def _instants(found: Columns, received: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the stamps of messages [ns]; when they were recorded, where there is none."""
    seconds = found.numbers['header.stamp.sec'][:, 0].astype(np.int64)
    stamps = seconds * 1_000_000_000 + found.numbers['header.stamp.nanosec'][:, 0].astype(np.int64)
    return np.where(stamps == 0, received, stamps)


def _plausible(instants: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which instants belong to one recording: within a day of most others."""
    if not instants.size:
        return np.zeros(0, dtype=bool)
    away = (instants - instants[instants.size // 2]) * NANOSECOND
    return np.asarray(np.abs(away) < 86400.0)


def gather(messages: Iterable[Raw]) -> RecordedTopics:
    """Sort the messages of a recording by topic and read them."""
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    streams: dict[str, _StreamParts] = {}
    others: dict[str, list[Received]] = {}
    types: dict[str, str] = {}
    malformed: Counter[str] = Counter()
    for topic, kind, stamp, data in messages:
        types[topic] = kind
        stamp = min(max(stamp, 0), _LATEST)
        if kind in _STREAMS:
            parts = streams.setdefault(topic, _StreamParts(kind))
            parts.waiting.append((stamp, data))
            if len(parts.waiting) >= _BATCH:
                parts.take(store.fielddefs)
            continue
        received = others.setdefault(topic, [])
        if len(received) >= _MOST_MESSAGES:
            continue
        try:
            received.append(Received(store.deserialize_cdr(data, kind), stamp))
        except Exception:  # noqa: B902
            # The library raises many kinds for bytes that are not such a message.
            malformed[topic] += 1
    found, not_finite = {}, {}
    for topic, parts in streams.items():
        parts.take(store.fielddefs)
        found[topic], not_finite[topic] = parts.stream()
        malformed[topic] += parts.malformed
    return RecordedTopics(
        streams=found,
        messages=others,
        types=types,
        malformed={topic: count for topic, count in malformed.items() if count},
        not_finite={topic: count for topic, count in not_finite.items() if count},
    )
