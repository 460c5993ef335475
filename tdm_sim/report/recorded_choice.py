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

"""Which planner of a recording a report tells of, where several were recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from tdm_planner.nodes.reading import nanoseconds_of
from tdm_sim.report import untrusted
from tdm_sim.report.bag_files import UnreadableRecording
from tdm_sim.report.recorded_topics import JOINT_STATE, ODOMETRY, RecordedTopics
from tdm_sim.report.recorded_vehicles import Site

_STATES = {'robot': ('odom', ODOMETRY)}  # of other plants: joint_states


def choose(
    sites: Sequence[Site], topics: RecordedTopics, namespace: str | None, notes: list[str]
) -> list[Site]:
    """
    Return the vehicles of one planner: that of `namespace` or, by default, the liveliest.

    That is one of whose vehicles a planned motion was measured; failing that, or of several such,
    the one of most plans. `notes` are told of the others.

    Raises
    ------
    UnreadableRecording
        If nothing was recorded in the namespace.

    """
    planners = list(dict.fromkeys(site.planner for site in sites))
    if namespace is None:
        chosen = max(planners, key=lambda planner: _liveliness(topics, sites, planner))
    else:
        chosen = '/' + namespace.strip('/') if namespace.strip('/') else ''
        if chosen not in planners:
            raise UnreadableRecording(
                f"the recording holds nothing in the namespace '{namespace}'; it has: "
                + ', '.join(map(_shown, planners))
            )
    others = [_shown(planner) for planner in planners if planner != chosen]
    if others:
        notes.append(
            f'The recording also holds {", ".join(others)}, which this report does not tell of: '
            'tdm report --namespace chooses.'
        )
    return [site for site in sites if site.planner == chosen]


def _shown(planner: str) -> str:
    return untrusted.text(planner, 60) or '/'


def _liveliness(
    topics: RecordedTopics, sites: Sequence[Site], planner: str
) -> tuple[bool, int, bool]:
    """
    Return whether a plan was seen carried out, how many plans, whether anything was measured.

    A plan alone is no sign of life: planners publish theirs to whoever comes later.
    """
    own = [site for site in sites if site.planner == planner]
    carried_out, plans, measured = False, 0, False
    for site in own:
        name, kind = _STATES.get(site.plant, ('joint_states', JOINT_STATE))
        topic = f'{site.namespace}/{name}'
        stream = topics.streams.get(topic) if topics.types.get(topic) == kind else None
        instants = None if stream is None or not stream.instants.size else stream.instants
        measured |= instants is not None
        for start, end in _motions(topics, site):
            plans += 1
            if instants is not None:
                carried_out |= bool(((instants >= start) & (instants <= end)).any())
    return carried_out, plans, measured


def _motions(topics: RecordedTopics, site: Site) -> Iterator[tuple[int, int]]:
    """Yield start and end of every planned motion [ns]."""
    for received in topics.messages.get(f'{site.namespace}/trajectory', ()):
        message = received.message
        points: Sequence[Any] = getattr(message, 'points', ())
        if len(points):
            start = nanoseconds_of(message.header.stamp)
            yield start, start + nanoseconds_of(points[-1].time_from_start)
