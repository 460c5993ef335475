# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a report uses of a recording: arrays and plain messages by topic, log, clock."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
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


class Stream(NamedTuple):
    """
    Numbers of a topic: `instants` (n,) ns, increasing, and columns by name (n,).

    Columns are ``joint.position`` and so on; of an odometry those of x, y and yaw, in the frame of
    its pose. NaN: not in that message. `not_finite` counts messages with infinities or NaN.
    """

    instants: NDArray[np.int64]
    columns: Mapping[str, Array]
    frame: str
    not_finite: int


class Received(NamedTuple):
    """A message, and when it was recorded [ns]."""

    message: Any
    stamp: int


@dataclass(eq=False)
class Topic:
    """
    What was recorded of a topic: its messages or, of joints and odometry, rows of numbers by name.

    `malformed` counts messages that could not be read.
    """

    kind: str
    received: list[Received] = field(default_factory=list)
    malformed: int = 0
    rows: list[tuple[int, dict[str, float]]] = field(default_factory=list)
    names: dict[str, None] = field(default_factory=dict)
    frame: str = ''

    def take(self, message: Any, stamp: int) -> None:
        """Keep a message or its numbers; ValueError where it contradicts itself."""
        if self.kind not in _STREAMS:
            self.received.append(Received(message, stamp))
            return
        row = _joints(message) if self.kind == JOINT_STATE else _odometry(message)
        self.frame = message.header.frame_id
        if len({**self.names, **row}) > _MOST_COLUMNS:
            raise ValueError('too many joints')
        self.names |= dict.fromkeys(row)
        self.rows.append((nanoseconds_of(message.header.stamp) or stamp, row))

    @cached_property
    def stream(self) -> Stream | None:
        """Return all numbers in order of time; None if there are none."""
        if not self.rows:
            return None
        instants = np.array([instant for instant, _ in self.rows], dtype=np.int64)
        nothing = dict.fromkeys(self.names, 0.0)  # which is sound
        absent = np.array([[name not in row for name in self.names] for _, row in self.rows])
        values = np.array([list((nothing | row).values()) for _, row in self.rows], dtype=float)
        sound = np.abs(values) < _LARGEST
        values[~sound | absent] = np.nan
        order = np.argsort(instants, kind='stable')
        away = (instants[order] - instants[order[order.size // 2]]) * NANOSECOND
        order = order[np.abs(away) < _DAY]  # of one recording, as most others
        columns = dict(zip(self.names, values[order].T, strict=True))
        return Stream(instants[order], columns, self.frame, int((~sound).any(axis=1).sum()))


class RecordedTopics(dict[str, Topic]):
    """A recording by topic."""

    def of_type(self, kind: str) -> dict[str, Sequence[Received]]:
        """Return the messages of every topic of a type."""
        return {name: topic.received for name, topic in self.items() if topic.kind == kind}

    def received(self, name: str, kind: str) -> Sequence[Received]:
        """Return the messages of a topic; none if it is not of this type."""
        topic = self.get(name)
        return topic.received if topic is not None and topic.kind == kind else ()

    def stream(self, name: str, kind: str) -> Stream | None:
        """Return the numbers of a topic; None if there are none of this type."""
        topic = self.get(name)
        return topic.stream if topic is not None and topic.kind == kind else None


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
    topics = RecordedTopics()
    for name, kind, stamp, data in messages:
        topic = topics.setdefault(name, Topic(kind))
        if len(topic.received) >= _MOST_MESSAGES:
            continue
        try:
            topic.take(store.deserialize_cdr(data, kind), min(max(stamp, 0), _LATEST))
        except Exception:  # noqa: B902
            # The library raises many kinds for bytes that are not such a message.
            topic.malformed += 1
    for topic in topics.values():
        topic.received.sort(key=lambda item: item.stamp)  # a file need not be in order
    return topics


class RecordedClock(NamedTuple):
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
