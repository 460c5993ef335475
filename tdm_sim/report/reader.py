# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A mission from a path: a recording, whole or in part, or a plan file.

Recordings are those of `ros2 bag record`, `tdm record` or a demo.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tdm_planner.nodes.reading import Level
from tdm_planner.plan_files import load_plan, UnusableFile, vehicles
from tdm_planner.problems.problem import Problem
from tdm_planner.trajectory import NANOSECOND, Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.mission import Event, Mission, PlanFigures, RecordedVehicle
from tdm_sim.report.recorded_topics import (
    DIAGNOSTICS,
    read_topics,
    RecordedTopics,
    STRING,
)
from tdm_sim.report.recorded_vehicles import (
    choose,
    find_sites,
    first_measured,
    followed,
    namespace_of,
    never_begun,
    planned_vehicles,
    Planner,
    read_plans,
    recorded_vehicle,
    Site,
)
from tdm_sim.report.untrusted import plan_figures, problem_of, read_summary, UNREADABLE

_MOST_NAMED = 8  # topics that an error message lists
MOST_EVENTS = 300
_PASSING = ('planning', 'preparing', 'ready')  # said by the planner before and during every plan


def read_mission(
    path: Path | str, namespace: str | None = None, problem: type[Problem] | None = None
) -> Mission:
    """
    Read a rosbag2 folder, a single .mcap or .db3 file, or a plan file (.json).

    A rosbag2 may be given by its metadata.yaml too. `namespace` chooses among several planners in
    one recording; `problem` is the class of a problem that is not installed.

    Raise TdmError in one sentence, if nothing can be made of it.
    """
    path = Path(path)
    if path.name == 'metadata.yaml' and path.is_file():
        path = path.parent
    if path.suffix.lower() != '.json':
        return _read_bag(path, namespace, problem)
    if namespace is not None:
        raise UnusableFile(f"'{path}' is a plan, which has no namespaces to choose from")
    return _read_plan(path, problem)


def _read_plan(path: Path, given: type[Problem] | None) -> Mission:
    """Read a plan file of `tdm plan` or of a demo; raises InvalidProblem if it is none."""
    document = load_plan(path)
    trajectories = {
        untrusted.text(name, 60): Trajectory.from_dict(dict(part))
        for name, part in vehicles(document).items()
    }
    try:
        figures = plan_figures(document)
    except UNREADABLE:
        raise UnusableFile(f"the file '{path}' is not a plan written by tdm") from None
    missing = ['This is a plan file without a recording: nothing is measured.']
    problem, unknown = problem_of(figures, given)
    missing += [unknown] if unknown else []
    if not figures.parameters:
        missing.append(
            'The file does not hold the parameters of the problem: no limits are drawn.'
        )
    found = planned_vehicles(problem, trajectories)
    return Mission(
        title=found[0].view.title or f'Plan for {figures.problem}',
        vehicles=found,
        figures=(figures,),
        parameters=figures.parameters,
        missing=tuple(missing),
        source=str(path),
    )


def _read_bag(path: Path, namespace: str | None, given: type[Problem] | None) -> Mission:
    """Read the mission that a recording holds, that below `namespace` if it holds several."""
    notes: list[str] = []
    topics = read_topics(path, notes)
    planners = _planners(topics, given, notes)
    sites = find_sites(topics, planners)
    if not sites:
        raise UnusableFile(_nothing_of_ours(path, topics.seen, notes))
    chosen = choose(sites, namespace)
    planner = planners.get(chosen[0].planner)
    notes += [planner.unknown] if planner is not None and planner.unknown else []
    return _mission(topics, {} if planner is None else planner.plans, chosen, path, notes)


def _nothing_of_ours(path: Path, topics: set[str], damage: Sequence[str]) -> str:
    names = [untrusted.text(topic, 60) for topic in sorted(topics) if topic]
    if not names:
        reason = damage[0].rstrip('.') if damage else 'it holds no messages'
        return f"nothing can be read from the recording '{path}': {untrusted.text(reason)}"
    more = f' and {len(names) - _MOST_NAMED} more' if len(names) > _MOST_NAMED else ''
    return (
        f"the recording '{path}' holds nothing of a planner, tracker or plant of tdm_planner; its "
        f'topics are {", ".join(names[:_MOST_NAMED])}{more}'
    )


def _planners(
    topics: RecordedTopics, given: type[Problem] | None, notes: list[str]
) -> dict[str, Planner]:
    """
    Return what planners told of their plans, by namespace, with the last one's problem.

    Plans that no tracker began do not count, unless there is no other.
    """
    found: dict[str, dict[int, PlanFigures]] = {}
    for topic, item in topics.of_type(STRING):
        try:
            start, figures = read_summary(item.message.data)
        except UNREADABLE:
            notes.append(f'{untrusted.text(topic)}: a summary of a plan cannot be read.')
            continue
        late = topics.real_time and topics.begun < start < item.stamp
        found.setdefault(namespace_of(topic), {})[start] = replace(figures, late=late)
    for planner, plans in found.items():
        begun = plans.keys() - never_begun(topics, f'{planner}/')
        found[planner] = {start: plans[start] for start in plans if start in begun} or plans
    return {
        planner: Planner(*problem_of(plans[max(plans)], given), plans)
        for planner, plans in found.items()
    }


def _mission(
    topics: RecordedTopics,
    summaries: Mapping[int, PlanFigures],
    sites: Sequence[Site],
    path: Path,
    notes: list[str],
) -> Mission:
    plans = {site: read_plans(topics, site, summaries, notes) for site in sites}
    starts = sorted({start for found in plans.values() for start in found})
    origin = (starts or sorted(summaries) or [first_measured(topics, sites)])[0]
    figures = [summaries[start] for start in sorted(summaries)]
    vehicles = [
        recorded_vehicle(topics, site, origin, followed(plans[site], origin)) for site in sites
    ]
    happened, left_out = events(topics, sites[0].planner, origin)
    if left_out:
        notes.append(f'{left_out} of the lesser warnings and changes of state are not listed.')
    notes += _gaps(topics, sites, vehicles, summaries)
    return Mission(
        title=sites[0].view.title or sites[0].name,
        vehicles=tuple(vehicles),
        figures=tuple(figures),
        events=tuple(happened),
        parameters=next((f.parameters for f in reversed(figures) if f.parameters), {}),
        missing=tuple(dict.fromkeys(notes)),
        source=str(path),
        recorded_at=origin * NANOSECOND,
    )


def _gaps(
    topics: RecordedTopics,
    sites: Sequence[Site],
    vehicles: Sequence[RecordedVehicle],
    summaries: Mapping[int, PlanFigures],
) -> list[str]:
    found = []
    for site, vehicle in zip(sites, vehicles, strict=True):
        where = untrusted.text(site.namespace, 100)
        expected = {
            'joint_states': (vehicle.applied, 'the applied controls are not known'),
            site.view.kind.leading: (vehicle.states, "the plant's motion is not known"),
            'joint_command': (vehicle.commands, "the tracker's commands are not known"),
        }
        for name, (there, consequence) in expected.items():
            if not there:
                found.append(f'{where}/{name} is not in the recording, or empty: {consequence}.')
        if not vehicle.plans:
            found.append(f'There is no plan of {vehicle.name} in the recording.')
    if not summaries:
        found.append(
            f'{untrusted.text(sites[0].planner, 100)}/plan_summary is not in the '
            'recording: neither cost nor limits of the plans are known.'
        )
    named = next(iter(summaries.values())).vehicles if summaries else {}
    absent = [name for name in named if name not in {vehicle.name for vehicle in vehicles}]
    found += [f'Nothing of {n}, which the plan names, is in the recording.' for n in absent]
    malformed = 'do not match their type and were ignored'
    strange = 'lack what is measured, or hold values that are not finite, which were ignored'
    for name, topic in topics.items():
        for count, fault in ((topic.malformed, malformed), (topic.strange, strange)):
            found += [f'{untrusted.text(name)}: {count} message(s) {fault}.'] if count else []
    return found


def events(topics: RecordedTopics, namespace: str, origin: int) -> tuple[list[Event], int]:
    """
    Return the events in order of time, and how many were dropped as too many.

    Of nodes below `namespace` they are all changes of state, of others errors and warnings. Times
    count from `origin` [ns].
    """
    found = sorted(_changes(topics, namespace, origin), key=lambda event: event.time)
    if len(found) <= MOST_EVENTS:
        return found, 0
    gravest = sorted(found, key=lambda event: -event.level)[:MOST_EVENTS]
    return sorted(gravest, key=lambda event: event.time), len(found) - MOST_EVENTS


def _changes(topics: RecordedTopics, namespace: str, origin: int) -> Iterator[Event]:
    last: dict[str, tuple[Level, str]] = {}
    for _, item in topics.of_type(DIAGNOSTICS):
        for status in item.message.status:
            level = Level(min(max(int(status.level), 0), 3))
            source = untrusted.text(status.name.split(':')[0], 200)
            now = level, untrusted.text(status.message)
            own = source.startswith(f'{namespace.rstrip("/")}/')
            passing = level == Level.OK and (now[1] in _PASSING or not own)
            if not passing and last.get(source) != now:
                last[source] = now
                yield Event((item.instant - origin) * NANOSECOND, level, source, now[1])
