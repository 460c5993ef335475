# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Diagnostics and log messages of a recording, and its simulated clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.trajectory import NANOSECOND
from tdm_sim.report import untrusted
from tdm_sim.report.mission import Event, Severity
from tdm_sim.report.recorded_topics import CLOCK, DIAGNOSTICS, LOG, RecordedTopics

MOST_EVENTS = 300
_LEAST_CLOCK = 10  # messages of a simulated clock

_WARNING, _ERROR = 30, 40  # levels of a log message
_PASSING = ('planning', 'preparing', 'ready')  # said by the planner before and during every plan
_SAME_TIME = 2.0  # s; within it, a diagnostic and a log message report the same event


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
