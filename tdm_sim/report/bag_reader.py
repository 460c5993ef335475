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

"""A mission out of a recording, by `ros2 bag record`, `tdm record` or a demo, whole or in part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import re

from tdm_planner.trajectory import NANOSECOND
from tdm_sim.report import untrusted
from tdm_sim.report.bag_files import (
    check_recording,
    messages,
    salvaged,
    UnreadableRecording,
)
from tdm_sim.report.mission import Mission, PlanFigures, Vehicle
from tdm_sim.report.plan_documents import (
    diagnosed_figures,
    PlannedVehicle,
    PlanSummary,
    read_summary,
)
from tdm_sim.report.recorded_choice import choose
from tdm_sim.report.recorded_clock import RecordedClock
from tdm_sim.report.recorded_events import events, statuses
from tdm_sim.report.recorded_gaps import gaps
from tdm_sim.report.recorded_plans import in_force, read_plans, TimedPlan
from tdm_sim.report.recorded_topics import gather, RecordedTopics, STRING, wanted
from tdm_sim.report.recorded_vehicles import find_sites, measured, namespace_of, Site

_MOST_NAMED = 8  # topics that an error message lists
_TITLES = {'pendulum': 'Swing-up of the rotary pendulum', 'robot': 'Formation of floating robots'}

Summaries = dict[str, dict[int, PlanSummary]]


def read_bag(path: Path, namespace: str | None = None) -> Mission:
    """
    Read the mission that a recording holds, that below `namespace` if it holds several.

    Raises
    ------
    UnreadableRecording
        If it is no recording, cannot be read at all, or holds nothing of the planner's.

    """
    check_recording(path)
    notes: list[str] = []
    topics = _topics(path, notes)
    summaries = _summaries(topics, notes)
    found = find_sites(topics, summaries)
    if not found:
        raise UnreadableRecording(_nothing_of_ours(path, topics.types, ()))
    sites = choose(found, topics, namespace, notes)
    return _mission(topics, summaries.get(sites[0].planner, {}), sites, path, notes)


def _topics(path: Path, notes: list[str]) -> RecordedTopics:
    """Read the recording as a whole or, failing that, whatever of it can be read."""
    try:
        topics = gather(messages(path, wanted))
        if topics.types:
            return topics
    except Exception:  # noqa: B902
        # Whatever the libraries raise for a damaged file: try what is left.
        notes.append('The recording was not closed properly, or is damaged.')
    found: list[str] = []
    everything: dict[str, str] = {}

    def noted(topic: str, kind: str) -> bool:
        everything[topic] = kind
        return wanted(topic, kind)

    topics = gather(salvaged(path, noted, found))
    notes += found
    if not topics.types:
        raise UnreadableRecording(_nothing_of_ours(path, everything, found))
    return topics


def _nothing_of_ours(path: Path, topics: Mapping[str, str], damage: Sequence[str]) -> str:
    if not topics:
        reason = damage[0].rstrip('.') if damage else 'it holds no messages'
        return f"nothing can be read from the recording '{path}': {untrusted.text(reason)}"
    names = [untrusted.text(topic, 60) for topic in sorted(topics)]
    more = f' and {len(names) - _MOST_NAMED} more' if len(names) > _MOST_NAMED else ''
    return (
        f"the recording '{path}' holds nothing of a planner, tracker or plant of tdm_planner; its "
        f'topics are {", ".join(names[:_MOST_NAMED])}{more}'
    )


def _summaries(topics: RecordedTopics, notes: list[str]) -> Summaries:
    found: Summaries = {}
    for topic, received in topics.of_type(STRING, 'plan_summary').items():
        for item in received:
            summary = read_summary(item.message.data)
            if summary is None:
                notes.append(f'{untrusted.text(topic)}: a summary of a plan cannot be read.')
            else:
                found.setdefault(namespace_of(topic), {})[summary.start] = summary
    return found


@dataclass(frozen=True)
class _Frame:
    """The mission's origin [ns], and plan numbers by the start of the motion [ns]."""

    origin: int
    plan_ids: Mapping[int, str]


def _mission(
    topics: RecordedTopics,
    summaries: Mapping[int, PlanSummary],
    sites: Sequence[Site],
    path: Path,
    notes: list[str],
) -> Mission:
    names = _names(sites, summaries)
    plans = {
        site: read_plans(topics, site.namespace, site.plant, _said(summaries, names[site]), notes)
        for site in sites
    }
    origin = _origin(topics, sites, plans, summaries)
    figures = _figures(topics, summaries, sites[0].planner, origin, plans)
    frame = _Frame(origin, {start: _number(figures, start, origin) for start in _starts(plans)})
    vehicles = [_vehicle(topics, site, names[site], plans[site], frame) for site in sites]
    clock = RecordedClock.of(topics)
    happened, left_out = events(topics, sites[0].planner, origin, clock)
    if left_out:
        notes.append(f'{left_out} of the lesser warnings and changes of state are not listed.')
    notes += gaps(topics, sites, vehicles, summaries, figures, names)
    parameters = next((f.parameters for f in reversed(figures) if f.parameters), {})
    return Mission(
        title=_TITLES.get(sites[0].plant, names[sites[0]]),
        problem=next((s.problem for s in summaries.values()), _problem(topics, sites)),
        vehicles=tuple(vehicles),
        figures=tuple(figures),
        events=tuple(happened),
        parameters=parameters,
        missing=tuple(dict.fromkeys(notes)),
        counters=_counters(topics, sites[0].planner),
        source=str(path),
        recorded_at=origin * NANOSECOND,
        speed=1.0 if clock is None else clock.speed,
    )


def _names(sites: Sequence[Site], summaries: Mapping[int, PlanSummary]) -> dict[Site, str]:
    """Return what the vehicles are called: as in the summaries, or by their namespaces."""
    told = next(iter(summaries.values())).vehicles if summaries else {}
    names = {}
    for site in sites:
        own = untrusted.text(site.namespace.rsplit('/', 1)[-1], 60)
        if site.plant == 'pendulum':
            own = 'pendulum'
        elif site.namespace == site.planner and len(told) == 1:
            own = next(iter(told))
        names[site] = own or 'vehicle'
    return names


def _said(summaries: Mapping[int, PlanSummary], name: str) -> dict[int, PlannedVehicle]:
    return {
        start: summary.vehicles[name]
        for start, summary in summaries.items()
        if name in summary.vehicles
    }


def _starts(plans: Mapping[Site, Sequence[TimedPlan]]) -> list[int]:
    return sorted({plan.start for found in plans.values() for plan in found})


def _origin(
    topics: RecordedTopics,
    sites: Sequence[Site],
    plans: Mapping[Site, Sequence[TimedPlan]],
    summaries: Mapping[int, PlanSummary],
) -> int:
    """Return the start of the first plan [ns]; failing that, of the first measurement."""
    starts = _starts(plans) or sorted(summaries)
    if starts:
        return starts[0]
    own = {site.namespace for site in sites}
    firsts = [
        int(stream.instants[0])
        for topic, stream in topics.streams.items()
        if namespace_of(topic) in own and stream.instants.size
    ]
    return min(firsts, default=0)


def _figures(
    topics: RecordedTopics,
    summaries: Mapping[int, PlanSummary],
    planner: str,
    origin: int,
    plans: Mapping[Site, Sequence[TimedPlan]],
) -> list[PlanFigures]:
    """Return figures of every plan: the planner's summary or, failing that, its diagnostics."""
    if summaries:
        return [summaries[start].figures(origin) for start in sorted(summaries)]
    starts = _starts(plans)
    found: dict[str, PlanFigures] = {}
    for status in statuses(topics):
        if namespace_of(status.source) == planner:
            # Plans are numbered from 1; with others before the recording, the last are these.
            figures = diagnosed_figures(status.values, 0.0)
            if figures is not None:
                found[figures.plan_id] = figures
    count = len(starts)
    last = list(found.values())[-count:] if count else []
    shift = len(starts) - len(last)
    return [
        PlanFigures(**{**vars(figures), 'time': (starts[shift + k] - origin) * NANOSECOND})
        for k, figures in enumerate(last)
    ]


def _number(figures: Sequence[PlanFigures], start: int, origin: int) -> str:
    time = (start - origin) * NANOSECOND
    return next((f.plan_id for f in figures if abs(f.time - time) < 1e-6), '')


def _vehicle(
    topics: RecordedTopics, site: Site, name: str, plans: Sequence[TimedPlan], frame: _Frame
) -> Vehicle:
    followed = in_force(plans, frame.origin, frame.plan_ids)
    found = measured(topics, site, frame.origin, followed)
    return Vehicle(
        name=name,
        plant=site.plant,
        plans=followed,
        states=found.states,
        commands=found.commands,
        applied=found.applied,
        tracking_error=found.tracking_error,
    )


def _problem(topics: RecordedTopics, sites: Sequence[Site]) -> str:
    """Return the problem's name from the planner's diagnostics."""
    for status in statuses(topics):
        if namespace_of(status.source) == sites[0].planner and 'problem' in status.values:
            return untrusted.text(status.values['problem'], 100)
    return ''


def _counters(topics: RecordedTopics, planner: str) -> dict[str, int]:
    """
    Return how many requests the planner had, and how many failed, since its first plan.

    While there is no plan, the planner may be asked before the plants are there. Without any plan
    it is since the recording started.
    """
    first: dict[str, int] = {}
    planned = False
    last: dict[str, int] = {}
    for status in statuses(topics):
        if namespace_of(status.source) == planner and 'plan id' in status.values:
            if not planned and status.values['plan id'] != '0':
                planned = True
                first.clear()
            for name in ('requests', 'failures'):
                count = status.values.get(name, '')
                if re.fullmatch(r'\d{1,9}', count):
                    first.setdefault(name, int(count))
                    last[name] = int(count)
    return {name: max(last[name] - first[name], 0) for name in last}
