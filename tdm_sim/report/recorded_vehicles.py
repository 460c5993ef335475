# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Finds the vehicles of a recording by their topics, and their measured histories.

A topic is recognised by its last name and its content, in any namespace.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import starmap, zip_longest
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.plan_files import UnusableFile
from tdm_planner.plant_kind import Joint, PlantKind, QUANTITIES
from tdm_planner.plant_views import kind_by_names, PendulumView, PlantView, RobotView, view_of
from tdm_planner.problems.problem import Problem
from tdm_planner.trajectory import NANOSECOND, Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.mission import FollowedPlan, PlanFigures, RecordedVehicle, Signals
from tdm_sim.report.recorded_topics import (
    PLAN,
    RecordedTopics,
    STATUSES,
)

_TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Site:
    """Where a vehicle's topics stand, what it is and is called, and where its planner's do."""

    namespace: str
    view: PlantView
    name: str
    planner: str

    @property
    def leading(self) -> str:
        """Return the topic whose stamps are those of the states."""
        return 'odom' if self.view.kind.odometry else 'joint_states'


class Planner(NamedTuple):
    """What a planner told: its last problem or why it is not known, its plans by start [ns]."""

    problem: Problem | None
    unknown: str
    plans: Mapping[int, PlanFigures]


def namespace_of(topic: str) -> str:
    """Return the namespace of a topic, without a slash at its end."""
    return topic.rsplit('/', 1)[0]


def unknown_view(plan: Trajectory) -> PlantView:
    """Return the plant of a problem that is not known, by the names of a plan's states."""
    for view in (PendulumView(), RobotView()):
        if set(view.kind.state_names) <= set(plan.state_names):
            return view
    return PlantView(kind_by_names(plan))


def planned_vehicles(
    problem: Problem | None, plans: Mapping[str, Trajectory]
) -> tuple[RecordedVehicle, ...]:
    """Return vehicles of which nothing but plans by name is there; a single one may have none."""
    found = []
    for name, plan in plans.items():
        view = unknown_view(plan) if problem is None else view_of(problem, plan)
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
    plans = topics.received(f'{namespace}/trajectory', PLAN)
    found = set(plans[0].message.joint_names) if plans else set()
    for name in ('joint_states', 'joint_command'):
        stream = topics.stream(f'{namespace}/{name}')
        found |= {column.rsplit('.', 1)[0] for column in stream.columns} if stream else set()
    return found


def _built_in(topics: RecordedTopics, namespace: str, joints: set[str]) -> PlantView | None:
    for view in (PendulumView(), RobotView()):
        odometry = topics.stream(f'{namespace}/odom') if view.kind.odometry else None
        here = odometry is not None and odometry.frame == view.kind.frame
        own = {j.name for j in view.kind.joints if j.name not in view.kind.odometry}
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


def recorded_vehicle(
    topics: RecordedTopics, site: Site, origin: int, plans: tuple[FollowedPlan, ...]
) -> RecordedVehicle:
    """
    Return a vehicle with what was measured of its states and controls, times from `origin` [ns].

    Angles are counted on the turn on which the first plan that was followed starts.
    """
    kind, units = site.view.kind, site.view.units

    def signals(name: str, joints: Sequence[Joint], wanted: Sequence[str]) -> Signals | None:
        stream = topics.stream(f'{site.namespace}/{name}')
        if stream is None:
            return None
        places = {getattr(j, what): f'{j.name}.{what}' for j in joints for what in QUANTITIES}
        names = tuple(name for name in wanted if places.get(name) in stream.columns)
        columns = [stream.columns[places[name]] for name in names]
        if all(np.isnan(column).all() for column in columns):
            return None
        times = np.asarray((stream.instants - origin) * NANOSECOND, dtype=np.float64)
        return Signals(
            times, np.stack(columns, axis=1), names, tuple(units.get(n, '') for n in names)
        )

    states = signals('joint_states', kind.measured, kind.state_names)
    if kind.odometry:
        moved = [joint for joint in kind.joints if joint.name in kind.odometry]
        states = _moving(signals('odom', moved, kind.state_names), states, kind)
    return RecordedVehicle(
        site.name,
        site.view,
        plans,
        states=None if states is None else _on_planned_turn(states, plans, site.view),
        commands=signals('joint_command', kind.actuated, kind.control_names),
        applied=signals('joint_states', kind.actuated, kind.control_names),
    )


def _moving(odometry: Signals | None, joints: Signals | None, kind: PlantKind) -> Signals | None:
    """Return the states by an odometry, angles without jumps by a turn, and those of joints."""
    if odometry is None:
        return None
    for name, column in zip(odometry.names, odometry.values.T, strict=True):
        if name in kind.angles:
            column[np.isfinite(column)] = np.unwrap(column[np.isfinite(column)])
    if joints is None:
        return odometry
    values = np.hstack([odometry.values, joints.at(odometry.times).values])
    names, units = odometry.names + joints.names, odometry.units + joints.units
    both = Signals(odometry.times, values, names, units)
    return both.select(*(name for name in kind.state_names if name in both))


def _on_planned_turn(states: Signals, plans: tuple[FollowedPlan, ...], view: PlantView) -> Signals:
    """Shift angles by whole turns to where the first plan that was followed has them."""
    for plan in plans[:1]:
        during = states.between(plan.start, plan.followed_until)
        planned, _ = Signals.both(plan.trajectory, during.times, plan.sample(during.times))
        away = during.values - planned.select(*states.names).values
        for k in (k for k, name in enumerate(states.names) if name in view.kind.angles):
            turns = np.round(away[np.isfinite(away[:, k]), k] / _TURN)
            states.values[:, k] -= _TURN * turns[0] if turns.size else 0.0
    return states


# Of action_msgs/GoalStatus: statuses of a plan that was begun, and those of one that is over.
_BEGUN = {2, 3, 4}  # EXECUTING, CANCELING, SUCCEEDED
_OVER = {5, 6}  # CANCELED, ABORTED


def read_plans(
    topics: RecordedTopics, site: Site, told: Mapping[int, PlanFigures], notes: list[str]
) -> dict[int, Trajectory]:
    """
    Return the plans published in a vehicle's namespace, by the starts of their motions [ns].

    `told` is what summaries say, which know how controls run between samples. A plan that cannot
    be read is told in `notes`, and so are those that the tracker never began: it rejected them, or
    they were superseded while pending.
    """
    namespace = site.namespace
    motions = _by_start(topics, namespace)
    never_begun = _never_begun(topics, f'{namespace}/tracker_status') & set(motions)
    if never_begun:
        notes.append(
            f'{len(never_begun)} of the plans on {namespace}/trajectory were rejected by the '
            'tracker or superseded before they began.'
        )
    plans = {}
    for start in sorted(set(motions) - never_begun):
        vehicle = told[start].vehicles.get(site.name) if start in told else None
        try:
            interpolation = None if vehicle is None else vehicle.interpolation
            plans[start] = read_plan(site.view.kind, motions[start], interpolation)
        except (InvalidProblem, ValueError, IndexError) as error:
            reason = untrusted.text(str(error))
            notes.append(f'A plan on {namespace}/trajectory cannot be read: {reason}.')
    return plans


def followed(plans: Mapping[int, Trajectory], origin: int) -> tuple[FollowedPlan, ...]:
    """Return plans with times from `origin` [ns], each until the next one starts."""
    times = [(start - origin) * NANOSECOND for start in plans]
    return tuple(starmap(FollowedPlan, zip_longest(plans.values(), times, times[1:])))


def _never_begun(topics: RecordedTopics, topic: str) -> set[int]:
    """Return the starts [ns] of plans that ended before they began, by what a tracker told."""
    told: dict[int, set[int]] = {}
    for item in topics.received(topic, STATUSES):
        for status in item.message.status_list:
            told.setdefault(nanoseconds_of(status.goal_info.stamp), set()).add(int(status.status))
    return {start for start, seen in told.items() if seen & _OVER and not seen & _BEGUN}


def _by_start(topics: RecordedTopics, namespace: str) -> dict[int, Any]:
    """Messages of a vehicle's plans by the start of their motion; the last one counts."""
    found = topics.received(f'{namespace}/trajectory', PLAN)
    return {nanoseconds_of(item.message.header.stamp): item.message for item in found}
