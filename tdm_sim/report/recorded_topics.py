# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a report uses of a recording: arrays and plain messages by topic, log, clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_typestore, Stores
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import nanoseconds_of, yaw_of
from tdm_planner.plant_kind import QUANTITIES
from tdm_planner.trajectory import NANOSECOND
from tdm_sim.report import untrusted
from tdm_sim.report.bag_files import Raw
from tdm_sim.report.mission import Event, Severity

Array = NDArray[np.float64]

JOINT_STATE = 'sensor_msgs/msg/JointState'
ODOMETRY = 'nav_msgs/msg/Odometry'
PLAN = 'trajectory_msgs/msg/JointTrajectory'
STRING = 'std_msgs/msg/String'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
STATUSES = 'action_msgs/msg/GoalStatusArray'
LOG = 'rcl_interfaces/msg/Log'
CLOCK = 'rosgraph_msgs/msg/Clock'

_STREAMS = (JOINT_STATE, ODOMETRY)
_MESSAGES = (PLAN, DIAGNOSTICS, STATUSES, LOG, CLOCK)
_LATEST = 2**63 - 1  # ns
_LARGEST = 1e100  # a number beyond it is damage; its square still is a number
_MOST_COLUMNS = 200  # of a topic
_MOST_MESSAGES = 20_000  # of a topic that is not a stream of numbers
_DAY = 86_400.0  # s
MOST_EVENTS = 300
_LEAST_CLOCK = 10  # messages of a simulated clock
_WARNING, _ERROR = 30, 40  # levels of a log message
_PASSING = ('planning', 'preparing', 'ready')  # said by the planner before and during every plan
_SAME_TIME = 2.0  # s; within it, a diagnostic and a log message report the same event


def wanted(topic: str, kind: str) -> bool:
    """Whether a report has a use for a topic."""
    if kind == STRING:
        return topic.rsplit('/', 1)[-1] == 'plan_summary'
    return kind in _STREAMS or kind in _MESSAGES


@dataclass(frozen=True, eq=False)
class Stream:
    """
    Numbers of a topic: `instants` (n,) ns, increasing, and columns by name (n,).

    Columns are ``joint.position`` and so on; of an odometry those of x, y and yaw, in the frame of
    its pose. NaN: not in that message.
    """

    instants: NDArray[np.int64]
    columns: Mapping[str, Array]
    frame: str = ''


class Received(NamedTuple):
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

    def of_type(self, kind: str) -> dict[str, Sequence[Received]]:
        """Return the messages of every topic of a type."""
        return {topic: got for topic, got in self.messages.items() if self.types[topic] == kind}

    def received(self, topic: str, kind: str) -> Sequence[Received]:
        """Return the messages of a topic; none if it is not of this type."""
        return self.messages.get(topic, ()) if self.types.get(topic) == kind else ()

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
        row = _odometry(message) if hasattr(message, 'pose') else _joints(message)
        self.frame = message.header.frame_id
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


def _odometry(message: Any) -> dict[str, float]:
    """Return the numbers of an odometry; NaN for what an attitude that is none leaves unknown."""
    place, rates = message.pose.pose, message.twist.twist
    try:
        yaw = yaw_of(place.orientation)
    except InvalidProblem:
        yaw = math.nan
    c, s = math.cos(yaw), math.sin(yaw)
    return {
        'x.position': place.position.x,
        'x.velocity': c * rates.linear.x - s * rates.linear.y,
        'y.position': place.position.y,
        'y.velocity': s * rates.linear.x + c * rates.linear.y,
        'yaw.position': yaw,
        'yaw.velocity': rates.angular.z,
    }


def gather(messages: Iterable[Raw]) -> RecordedTopics:
    """Sort the messages of a recording by topic and read them."""
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
    for received in others.values():
        received.sort(key=lambda item: item.stamp)  # a file need not be in order
    read = {topic: part.stream() for topic, part in parts.items() if part.rows}
    return RecordedTopics(
        streams={topic: stream for topic, (stream, _) in read.items()},
        messages=others,
        types=types,
        malformed=malformed,
        not_finite={topic: count for topic, (_, count) in read.items() if count},
    )


@dataclass(frozen=True, eq=False)
class RecordedClock:
    """What the simulated clock showed, `shown` (n,) ns, at the instants `recorded` (n,) ns."""

    recorded: NDArray[np.int64]
    shown: NDArray[np.int64]

    @classmethod
    def of(cls, topics: RecordedTopics) -> RecordedClock | None:
        """Return the clock of a recording; None where time was not simulated."""
        for received in topics.of_type(CLOCK).values():
            if len(received) >= _LEAST_CLOCK:
                pairs = [(item.stamp, nanoseconds_of(item.message.clock)) for item in received]
                recorded, shown = np.array(sorted(pairs), dtype=np.int64).T
                return cls(recorded, shown)
        return None

    @property
    def speed(self) -> float:
        """Return the simulated time relative to real time, over the whole recording."""
        elapsed = int(self.recorded[-1] - self.recorded[0])
        return int(self.shown[-1] - self.shown[0]) / elapsed if elapsed > 0 else 1.0

    def instant(self, stamp: int) -> int:
        """Return what the clock showed at an instant [ns] of the computer's own clock."""
        index = int(np.clip(np.searchsorted(self.recorded, stamp), 1, self.recorded.size - 1))
        nearest = index if stamp >= self.recorded[index] else index - 1
        return int(self.shown[nearest]) + round((stamp - int(self.recorded[nearest])) * self.speed)


def events(
    topics: RecordedTopics, namespace: str, origin: int, clock: RecordedClock | None = None
) -> tuple[list[Event], int]:
    """
    Return the events in order of time, and how many were dropped as too many.

    Of nodes below `namespace` they are all changes of state, of others errors and warnings. Times
    count from `origin` [ns]. `clock` is the simulated one, if any: logs bear the computer's time.
    """
    found = [*_changes(topics, namespace, origin)]
    found += _logged(topics, origin, found, clock)
    found.sort(key=lambda event: event.time)
    if len(found) <= MOST_EVENTS:
        return found, 0
    gravest = sorted(found, key=lambda event: -event.level)[:MOST_EVENTS]
    return sorted(gravest, key=lambda event: event.time), len(found) - MOST_EVENTS


def _changes(topics: RecordedTopics, namespace: str, origin: int) -> Iterator[Event]:
    last: dict[str, tuple[Severity, str]] = {}
    for received in topics.of_type(DIAGNOSTICS).values():
        for item in received:
            instant = nanoseconds_of(item.message.header.stamp) or item.stamp
            for status in item.message.status:
                level = Severity(min(max(int(status.level), 0), 3))
                source = untrusted.text(status.name.split(':')[0], 200)
                now = level, untrusted.text(status.message)
                own = source.startswith(f'{namespace.rstrip("/")}/')
                passing = level == Severity.OK and (now[1] in _PASSING or not own)
                if not passing and last.get(source) != now:
                    last[source] = now
                    yield Event((instant - origin) * NANOSECOND, level, source, now[1])


def _logged(
    topics: RecordedTopics, origin: int, told: list[Event], clock: RecordedClock | None
) -> Iterator[Event]:
    near: dict[tuple[str, int], list[str]] = {}
    for event in told:
        near.setdefault((event.source, int(event.time // _SAME_TIME)), []).append(event.text)
    for received in topics.of_type(LOG).values():
        for item in received:
            log = item.message
            if log.level < _WARNING:
                continue
            instant = nanoseconds_of(log.stamp) or item.stamp
            if clock is not None:
                instant = clock.instant(instant)
            event = Event(
                time=(instant - origin) * NANOSECOND,
                level=Severity.WARN if log.level < _ERROR else Severity.ERROR,
                source='/' + untrusted.text(log.name, 200).replace('.', '/'),
                text=untrusted.text(log.msg),
            )
            slot = int(event.time // _SAME_TIME)
            said = [t for k in (slot - 1, slot, slot + 1) for t in near.get((event.source, k), [])]
            if not any(text in event.text or event.text in text for text in said):
                near.setdefault((event.source, slot), []).append(event.text)
                yield event
