# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Finds the vehicles of a recording by their topics, and their measured histories.

A topic is recognised by its last name and its content, in any namespace.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import starmap, zip_longest
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import nanoseconds_of, read_joints, read_odometry, read_plan
from tdm_planner.plan_files import UnusableFile
from tdm_planner.plant_kind import PlantKind
from tdm_planner.plant_views import PendulumView, PlantView, RobotView, view_of
from tdm_planner.problems.problem import Problem
from tdm_planner.trajectory import NANOSECOND, Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.mission import FollowedPlan, PlanFigures, RecordedVehicle
from tdm_sim.report.recorded_topics import (
    JOINT_STATE,
    ODOMETRY,
    PLAN,
    RecordedTopics,
    STATUSES,
)
from tdm_sim.report.signals import Signals

_TURN = 2 * np.pi
_DAY = 86_400.0  # s

Reader = Callable[[Any], dict[str, float]]  # states or controls of a message
Row = tuple[float, dict[str, float]]  # time [s], states and controls


@dataclass(frozen=True, eq=False)
class Site:
    """Where a vehicle's topics stand, what it is and is called, and where its planner's do."""

    namespace: str
    view: PlantView
    name: str
    planner: str


class Planner(NamedTuple):
    """What a planner told: its last problem or why it is not known, its plans by start [ns]."""

    problem: Problem | None
    unknown: str
    plans: Mapping[int, PlanFigures]


def namespace_of(topic: str) -> str:
    """Return the namespace of a topic, without a slash at its end."""
    return topic.rsplit('/', 1)[0]


def planned_vehicles(
    problem: Problem | None, plans: Mapping[str, Trajectory]
) -> tuple[RecordedVehicle, ...]:
    """Return vehicles of which nothing but plans by name is there; a single one may have none."""
    found = []
    for name, plan in plans.items():
        view = view_of(problem, plan)
        found.append(RecordedVehicle(name or view.name, view, (FollowedPlan(plan, 0.0),)))
    return tuple(found)


def find_sites(topics: RecordedTopics, planners: Mapping[str, Planner]) -> list[Site]:
    """Return every vehicle; `planners` are the namespaces in which plans were told of."""
    sites = []
    for namespace in dict.fromkeys(map(namespace_of, sorted(topics))):
        above = namespace_of(namespace)
        planner = next((p for p in (namespace, above) if p in planners), None)
        joints = _joints(topics, namespace)
        view = _built_in(topics, namespace, joints)
        if planner is not None and joints:
            view = _told(planners[planner], namespace) or view
        if view is not None:
            named = untrusted.text(namespace.rsplit('/', 1)[-1], 60)
            if planner is None:
                planner = above if view.place else namespace
            if namespace == planner:  # of a single one a summary tells the name
                plans = planners[planner].plans if planner in planners else {}
                told = next(iter(plans.values())).vehicles if plans else {}
                named = next(iter(told)) if len(told) == 1 else ''
            sites.append(Site(namespace, view, named or view.name, planner))
    return sites


def _told(planner: Planner, namespace: str) -> PlantView | None:
    """Return the plant that a planner told of: of its problem, or as its summary names joints."""
    if planner.problem is not None:
        return view_of(planner.problem)
    told = planner.plans[max(planner.plans)].vehicles
    only = next(iter(told.values())) if len(told) == 1 else None
    vehicle = told.get(namespace.rsplit('/', 1)[-1], only)
    return None if vehicle is None else PlantView(vehicle)


def _joints(topics: RecordedTopics, namespace: str) -> set[str]:
    plan = topics.first(f'{namespace}/trajectory', PLAN)
    found = set() if plan is None else set(plan.joint_names)
    for name in ('joint_states', 'joint_command'):
        message = topics.first(f'{namespace}/{name}', JOINT_STATE)
        found |= set() if message is None else set(message.name)
    return found


def _built_in(topics: RecordedTopics, namespace: str, joints: set[str]) -> PlantView | None:
    odometry = topics.first(f'{namespace}/odom', ODOMETRY)
    for view in (PendulumView(), RobotView()):
        moved = view.kind.odometry
        own = {joint.name for joint in view.kind.joints if joint.name not in moved}
        here = moved and odometry is not None and odometry.header.frame_id == view.kind.frame
        if here or own <= joints:
            return view
    return None


def choose(sites: Sequence[Site], namespace: str | None) -> list[Site]:
    """
    Return the vehicles of the planner in `namespace`, or of the only one.

    Raise UnusableFile if there is none in the namespace, or there are several.
    """
    planners = {site.planner for site in sites}
    if namespace is not None:
        planners &= {f'/{namespace.strip("/")}'.rstrip('/')}
    if len(planners) != 1:
        there = sorted({untrusted.text(site.planner, 60) or '/' for site in sites})
        raise UnusableFile(
            f'the recording holds planners and plants in {", ".join(there)}: choose one of them '
            'with --namespace'
        )
    return [site for site in sites if site.planner in planners]


def first_measured(topics: RecordedTopics, sites: Sequence[Site]) -> int:
    """Return the instant [ns] of the first measurement; 0 if there is none."""
    found = [
        next(topics.messages(f'{site.namespace}/{name}', kind), None)
        for site in sites
        for name, kind in (('joint_states', JOINT_STATE), ('odom', ODOMETRY))
    ]
    return min((received.instant for received in found if received is not None), default=0)


def recorded_vehicle(
    topics: RecordedTopics, site: Site, origin: int, plans: tuple[FollowedPlan, ...]
) -> RecordedVehicle:
    """
    Return a vehicle with what was measured of its states and controls, times from `origin` [ns].

    Angles are counted on the turn on which the first plan that was followed starts.
    """
    kind, space = site.view.kind, site.namespace
    units = kind.units
    read = partial(read_joints, names=kind.control_names)
    readers: list[Reader] = [partial(read_joints, kind.measured, names=kind.state_names)]
    readers += [partial(read, [joint]) for joint in kind.actuated]
    joints = _read(topics, f'{space}/joint_states', JOINT_STATE, origin, readers)
    states = _signals(joints, kind.state_names, units)
    if kind.odometry:
        moved = _read(topics, f'{space}/odom', ODOMETRY, origin, [partial(read_odometry, kind)])
        states = _moving(_signals(moved, kind.state_names, units), states, kind)
    readers = [partial(read, kind.actuated)]
    commands = _read(topics, f'{space}/joint_command', JOINT_STATE, origin, readers)
    return RecordedVehicle(
        site.name,
        site.view,
        plans,
        states=_on_planned_turn(states, plans, site.view),
        commands=_signals(commands, kind.control_names, units),
        applied=_signals(joints, kind.control_names, units),
    )


def _read(
    topics: RecordedTopics, name: str, kind: str, origin: int, readers: Sequence[Reader]
) -> list[Row]:
    """Return times from `origin` [ns] and what `readers` find of messages, in order of time."""
    found, strange = list[tuple[int, dict[str, float]]](), 0
    for received in topics.messages(name, kind):
        values: dict[str, float] = {}
        for number, read in enumerate(readers):
            try:
                values |= read(received.message)
            except InvalidProblem:
                strange += number == 0  # not all joint states tell of efforts
        found.append((received.instant, values))
    if found:
        topics[name].strange = strange
        found.sort(key=itemgetter(0))
        middle = found[len(found) // 2][0]  # of one recording, as most others
        found = [row for row in found if abs(row[0] - middle) * NANOSECOND < _DAY]
    return [((instant - origin) * NANOSECOND, values) for instant, values in found]


def _signals(rows: Sequence[Row], names: Sequence[str], units: Mapping[str, str]) -> Signals:
    """Return the histories of those of `names` that rows hold."""
    rows = [row for row in rows if not row[1].keys().isdisjoint(names)]
    found = {
        name: np.array([values.get(name, np.nan) for _, values in rows])
        for name in names
        if any(name in values for _, values in rows)
    }
    return Signals(np.array([time for time, _ in rows]), found, units)


def _moving(odometry: Signals, joints: Signals, kind: PlantKind) -> Signals:
    """Return the states by an odometry, angles without jumps by a turn, and those of joints."""
    if not odometry:
        return odometry
    for name, column in odometry.columns.items():
        if name in kind.angles:
            column[np.isfinite(column)] = np.unwrap(column[np.isfinite(column)])
    both = {**odometry.columns, **joints.at(odometry.times).columns}
    found = {name: both[name] for name in kind.state_names if name in both}
    return Signals(odometry.times, found, odometry.units)


def _on_planned_turn(states: Signals, plans: tuple[FollowedPlan, ...], view: PlantView) -> Signals:
    """Shift angles by whole turns to where the first plan that was followed has them."""
    for plan in plans[:1]:
        during = states.between(plan.start, plan.followed_until)
        planned, _ = Signals.both(plan.trajectory, during.times, plan.sample(during.times))
        for name in states.columns.keys() & planned.columns.keys() & {*view.kind.angles}:
            away = during.columns[name] - planned.columns[name]
            turns = np.round(away[np.isfinite(away)] / _TURN)
            states.columns[name][:] -= _TURN * turns[0] if turns.size else 0.0
    return states


# Of action_msgs/GoalStatus: statuses of a plan that was begun, and those of one that is over.
_BEGUN = {2, 3, 4}  # EXECUTING, CANCELING, SUCCEEDED
_OVER = {5, 6}  # CANCELED, ABORTED


def read_plans(
    topics: RecordedTopics, site: Site, told: Mapping[int, PlanFigures], notes: list[str]
) -> dict[int, Trajectory]:
    """
    Return the plans published in a vehicle's namespace, by the starts of their motions [ns].

    Of several with the same start the last one counts. `told` is what summaries say, which know
    how controls run between samples. A plan that cannot be read is told in `notes`, and so are
    those that the tracker never began: it rejected them, or they were superseded while pending.
    """
    namespace = site.namespace
    published = topics.messages(f'{namespace}/trajectory', PLAN)
    motions = {p.instant: p.message for p in published if len(p.message.points)}  # empty: dropped
    dropped = never_begun(topics, f'{namespace}/tracker_status') & set(motions)
    if dropped:
        notes.append(
            f'{len(dropped)} of the plans on {namespace}/trajectory were rejected by the '
            'tracker or superseded before they began.'
        )
    found = {}
    for start in sorted(set(motions) - dropped):
        vehicle = told[start].vehicles.get(site.name) if start in told else None
        try:
            interpolation = None if vehicle is None else vehicle.interpolation
            given = site.view.kind, motions[start], interpolation
            found[start] = read_plan(*given, rated=vehicle is not None)
        except (InvalidProblem, ValueError, IndexError) as error:
            reason = untrusted.text(str(error))
            notes.append(f'A plan on {namespace}/trajectory cannot be read: {reason}.')
    return found


def followed(plans: Mapping[int, Trajectory], origin: int) -> tuple[FollowedPlan, ...]:
    """Return plans with times from `origin` [ns], each until the next one starts."""
    times = [(start - origin) * NANOSECOND for start in plans]
    return tuple(starmap(FollowedPlan, zip_longest(plans.values(), times, times[1:])))


def never_begun(topics: RecordedTopics, prefix: str) -> set[int]:
    """Return the starts [ns] of plans that ended before they began, by topics with a `prefix`."""
    told: dict[int, set[int]] = {}
    for name, item in topics.of_type(STATUSES):
        for status in item.message.status_list if name.startswith(prefix) else ():
            told.setdefault(nanoseconds_of(status.goal_info.stamp), set()).add(int(status.status))
    return {start for start, seen in told.items() if seen & _OVER and not seen & _BEGUN}
