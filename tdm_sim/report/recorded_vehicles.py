# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Finds the vehicles of a recording by their topics, and their measured histories.

A topic is recognised by its last name and its content, in any namespace.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.plant_kind import Joint, PlantKind, QUANTITIES
from tdm_planner.plant_views import kind_by_names, PendulumView, PlantView, RobotView, view_of
from tdm_planner.problems.problem import Problem
from tdm_planner.trajectory import Interpolation, NANOSECOND, Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.bag_files import UnreadableRecording
from tdm_sim.report.mission import FollowedPlan, Signals
from tdm_sim.report.recorded_topics import (
    JOINT_STATE,
    ODOMETRY,
    PLAN,
    Received,
    RecordedTopics,
    STATUSES,
    Stream,
)

Array = NDArray[np.float64]
Columns = dict[str, Array]

_TURN = 2 * np.pi
_STATES = 'joint_states', JOINT_STATE
_UNIT = 1e-3  # that the length of a quaternion may differ from 1


@dataclass(frozen=True, eq=False)
class Site:
    """Where a vehicle's topics stand, what it is, and where its planner's do."""

    namespace: str
    view: PlantView
    planner: str


class Planner(NamedTuple):
    """A planner's summaries: the problem, if it is known, and the vehicles' joints."""

    problem: Problem | None
    kinds: Mapping[str, PlantKind | None]


def namespace_of(topic: str) -> str:
    """Return the namespace of a topic, without a slash at its end."""
    return topic.rsplit('/', 1)[0]


def unknown_view(plan: Trajectory) -> PlantView:
    """Return the plant of a problem that is not known, by the names of a plan's states."""
    for view in (PendulumView(), RobotView()):
        if set(view.kind.state_names) <= set(plan.state_names):
            return view
    return PlantView(kind_by_names(plan))


def find_sites(topics: RecordedTopics, planners: Mapping[str, Planner]) -> list[Site]:
    """Return every vehicle; `planners` are the namespaces in which plans were told of."""
    sites = []
    for namespace in dict.fromkeys(map(namespace_of, sorted(topics.types))):
        above = namespace_of(namespace)
        planner = next((p for p in (namespace, above) if p in planners), None)
        joints = _joints(topics, namespace)
        view = _built_in(topics, namespace, joints)
        if planner is not None and joints:
            view = _told(planners[planner], namespace) or view
        if view is not None:
            alone = above if view.place else namespace
            sites.append(Site(namespace, view, alone if planner is None else planner))
    return sites


def _told(planner: Planner, namespace: str) -> PlantView | None:
    """Return the plant that a planner told of: of its problem, or as its summary names joints."""
    if planner.problem is not None:
        return view_of(planner.problem)
    only = next(iter(planner.kinds.values())) if len(planner.kinds) == 1 else None
    kind = planner.kinds.get(namespace.rsplit('/', 1)[-1], only)
    return None if kind is None else PlantView(kind)


def _joints(topics: RecordedTopics, namespace: str) -> set[str]:
    """Return the joints that a vehicle's topics name."""
    found: set[str] = set()
    for received in _plans(topics, namespace)[:1]:
        found |= set(received.message.joint_names)
    for name in ('joint_states', 'joint_command'):
        stream = topics.stream(f'{namespace}/{name}', JOINT_STATE)
        found |= stream.joints if stream is not None else frozenset()
    return found


def _plans(topics: RecordedTopics, namespace: str) -> Sequence[Any]:
    topic = f'{namespace}/trajectory'
    return topics.messages.get(topic, ()) if topics.types.get(topic) == PLAN else ()


def _built_in(topics: RecordedTopics, namespace: str, joints: set[str]) -> PlantView | None:
    for view in (PendulumView(), RobotView()):
        odometry = topics.stream(f'{namespace}/odom', ODOMETRY) if view.kind.odometry else None
        here = odometry is not None and odometry.frame == view.kind.frame
        if (
            here
            or {j.name for j in view.kind.joints if j.name not in view.kind.odometry} <= joints
        ):
            return view
    return None


def choose(
    sites: Sequence[Site], topics: RecordedTopics, namespace: str | None, notes: list[str]
) -> list[Site]:
    """
    Return the vehicles of one planner: that of `namespace` or, by default, the liveliest.

    That is one for which a planned motion was measured; else, or of several such, the one with
    most plans. `notes` name the others.

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
            f'The recording also holds {", ".join(others)}, which this report ignores: '
            'choose with tdm report --namespace.'
        )
    return [site for site in sites if site.planner == chosen]


def _shown(planner: str) -> str:
    return untrusted.text(planner, 60) or '/'


def _liveliness(
    topics: RecordedTopics, sites: Sequence[Site], planner: str
) -> tuple[bool, int, bool]:
    """
    Return whether a plan's motion was measured, the number of plans, whether there is any data.

    A plan alone is no sign of life: it is latched, and published to late subscribers.
    """
    executed, plans, seen = False, 0, False
    for site in (site for site in sites if site.planner == planner):
        name, kind = ('odom', ODOMETRY) if site.view.kind.odometry else _STATES
        stream = topics.stream(f'{site.namespace}/{name}', kind)
        seen |= stream is not None
        for start, end in _motions(topics, site):
            plans += 1
            if stream is not None:
                executed |= bool(((stream.instants >= start) & (stream.instants <= end)).any())
    return executed, plans, seen


def _motions(topics: RecordedTopics, site: Site) -> Iterator[tuple[int, int]]:
    """Yield start and end of every planned motion [ns]."""
    for received in _plans(topics, site.namespace):
        if received.message.points:
            start = nanoseconds_of(received.message.header.stamp)
            yield start, start + nanoseconds_of(received.message.points[-1].time_from_start)


def measured(
    topics: RecordedTopics, site: Site, origin: int, plans: tuple[FollowedPlan, ...]
) -> dict[str, Signals | None]:
    """
    Return measured states and controls as a `Vehicle` has them, times from `origin` [ns].

    Angles are counted on the turn on which the first plan that was followed starts.
    """
    kind = site.view.kind
    units = site.view.units

    def signals(name: str, joints: Sequence[Joint], wanted: Sequence[str]) -> Signals | None:
        stream = topics.stream(f'{site.namespace}/{name}', JOINT_STATE)
        if stream is None:
            return None
        return _signals(stream, origin, columns_of(stream, joints, wanted), units)

    states = signals('joint_states', kind.measured, kind.state_names)
    odometry = topics.stream(f'{site.namespace}/odom', ODOMETRY) if kind.odometry else None
    if kind.odometry:
        states = None if odometry is None else _moving(odometry, states, site.view, origin, units)
    return {
        'states': None if states is None else _on_planned_turn(states, plans, site.view),
        'commands': signals('joint_command', kind.actuated, kind.control_names),
        'applied': signals('joint_states', kind.actuated, kind.control_names),
        'tracking_error': signals('tracking_error', kind.joints, kind.state_names),
    }


def columns_of(stream: Stream, joints: Sequence[Joint], wanted: Sequence[str]) -> Columns:
    """Return those of the states or controls `wanted` that joints have in a stream."""
    places = {
        getattr(joint, quantity): f'{joint.name}.{quantity}'
        for joint in joints
        for quantity in QUANTITIES
    }
    return {
        name: stream.columns[places[name]] for name in wanted if places.get(name) in stream.columns
    }


def _signals(
    stream: Stream, origin: int, columns: Columns, units: Mapping[str, str]
) -> Signals | None:
    """Return histories; None if nothing at all was measured."""
    if not columns:
        return None
    values = np.stack(list(columns.values()), axis=1)
    if np.isnan(values).all():
        return None
    times = np.asarray((stream.instants - origin) * NANOSECOND, dtype=np.float64)
    return Signals(times, values, tuple(columns), tuple(units.get(name, '') for name in columns))


def _moving(
    odometry: Stream,
    joints: Signals | None,
    view: PlantView,
    origin: int,
    units: Mapping[str, str],
) -> Signals | None:
    """Return the states by an odometry, its twist turned into its frame, and those of joints."""
    qx, qy, qz, qw = (odometry.column(name) for name in ('qx', 'qy', 'qz', 'qw'))
    yaw = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    yaw[~(np.abs(np.sqrt(qx**2 + qy**2 + qz**2 + qw**2) - 1.0) < _UNIT)] = np.nan
    c, s = np.cos(yaw), np.sin(yaw)
    known = ~np.isnan(yaw)
    yaw[known] = np.unwrap(yaw[known])
    vx, vy = odometry.column('vx'), odometry.column('vy')
    motions = (
        (odometry.column('x'), c * vx - s * vy),
        (odometry.column('y'), s * vx + c * vy),
        (yaw, odometry.column('omega')),
    )
    table = {joint.name: joint for joint in view.kind.joints}
    found: Columns = {}
    for name, pair in zip(view.kind.odometry, motions, strict=True):
        found |= zip((table[name].position, table[name].velocity), pair, strict=True)
    if joints is not None:
        times = np.asarray((odometry.instants - origin) * NANOSECOND, dtype=np.float64)
        found |= zip(joints.names, joints.at(times).T, strict=True)
    ordered = {name: found[name] for name in view.kind.state_names if name in found}
    return _signals(odometry, origin, ordered, units)


def _on_planned_turn(states: Signals, plans: tuple[FollowedPlan, ...], view: PlantView) -> Signals:
    """Shift angles by whole turns to where the first plan that was followed has them."""
    for plan in plans[:1]:
        values = states.values.copy()
        motion = plan.trajectory
        for name in set(view.kind.angles) & set(states.names) & set(motion.state_names):
            k = states.names.index(name)
            planned = plan.sample(states.times).state[:, motion.state_names.index(name)]
            during = (states.times >= plan.start) & (states.times <= plan.followed_until)
            away = values[during, k] - planned[during]
            if np.isfinite(away).any():
                first = away[np.isfinite(away)][0]
                values[:, k] -= _TURN * np.round(first / _TURN)
        return Signals(states.times, values, states.names, states.units)
    return states


# Of action_msgs/GoalStatus: statuses of a plan that was begun, and those of one that is over.
_BEGUN = {2, 3, 4}  # EXECUTING, CANCELING, SUCCEEDED
_OVER = {5, 6}  # CANCELED, ABORTED


def read_plans(
    topics: RecordedTopics,
    namespace: str,
    kind: PlantKind,
    told: Mapping[int, Interpolation | None],
    notes: list[str],
) -> dict[int, Trajectory]:
    """
    Return the plans published in a vehicle's namespace, by the starts of their motions [ns].

    `told` is what summaries say of the samples, by the start of the motion [ns]. A plan that
    cannot be read is told in `notes`, and so are those that the tracker never began: it rejected
    them, or they were superseded while pending.
    """
    motions = _by_start(topics, f'{namespace}/trajectory')
    never_begun = _never_begun(topics, f'{namespace}/tracker_status') & set(motions)
    if never_begun:
        notes.append(
            f'{len(never_begun)} of the plans on {namespace}/trajectory were rejected by the '
            'tracker or superseded before they began.'
        )
    plans = {}
    for start in sorted(set(motions) - never_begun):
        try:
            plans[start] = read_plan(kind, motions[start], told.get(start))
        except (InvalidProblem, ValueError, IndexError) as error:
            reason = untrusted.text(str(error))
            notes.append(f'A plan on {namespace}/trajectory cannot be read: {reason}.')
    return plans


def followed(plans: Mapping[int, Trajectory], origin: int) -> tuple[FollowedPlan, ...]:
    """Return plans with times from `origin` [ns], each until the next one starts."""
    times = [(start - origin) * NANOSECOND for start in plans]
    ends = [*times[1:], None][: len(times)]
    return tuple(
        FollowedPlan(plan, time, until)
        for plan, time, until in zip(plans.values(), times, ends, strict=True)
    )


def _never_begun(topics: RecordedTopics, topic: str) -> set[int]:
    """Return the starts [ns] of plans that ended before they began, by what a tracker told."""
    told: dict[int, set[int]] = {}
    if topics.types.get(topic) == STATUSES:
        for item in topics.messages.get(topic, ()):
            for status in item.message.status_list:
                start = nanoseconds_of(status.goal_info.stamp)
                told.setdefault(start, set()).add(int(status.status))
    return {start for start, seen in told.items() if seen & _OVER and not seen & _BEGUN}


def _by_start(topics: RecordedTopics, topic: str) -> dict[int, Any]:
    """Messages of a topic of trajectories by the start of their motion; the last one counts."""
    if topics.types.get(topic) != PLAN:
        return {}
    found: Sequence[Received] = topics.messages.get(topic, ())
    return {nanoseconds_of(item.message.header.stamp): item.message for item in found}
