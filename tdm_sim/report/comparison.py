# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Planned against achieved: the figures of a mission's summary."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
import math
from typing import Literal, NamedTuple

import numpy as np
from tdm_planner.nodes.reading import Level
from tdm_sim.report.mission import Mission, RecordedVehicle
from tdm_sim.report.signals import Margin, ROUNDING, Signals, smallest
from tdm_sim.report.verdict import (
    arrival,
    goal_errors,
    held_from,
    HOLD_TIME,
    judge,
    judged_until,
    Verdict,
)

Kind = Literal['duration', 'cost', 'landing', 'margin', 'distance', 'planner']

_STEP, _MOST_STEPS = 0.001, 50_000  # between instants at which a plan is judged


class Entry(NamedTuple):
    """
    A figure, planned and achieved; None: there is none. '' as vehicle: of all together.

    `planned_at` and `achieved_at` are instants since the mission's origin [s]. `mark` is a word on
    the achieved value.
    """

    kind: Kind
    name: str
    unit: str
    planned: float | None = None
    achieved: float | None = None
    planned_at: float | None = None
    achieved_at: float | None = None
    vehicle: str = ''
    note: str = ''
    mark: str = ''


@dataclass(frozen=True, eq=False)
class Comparison:
    """Figures in the order of the summary; no verdict where not enough was recorded for one."""

    entries: tuple[Entry, ...]
    verdict: Verdict | None = None


def compare(mission: Mission) -> Comparison:
    """Compare what was planned with what was achieved."""
    entries = chain(
        _durations(mission),
        _costs(mission),
        _landings(mission),
        _margins(mission),
        _distances(mission),
        _planner(mission),
    )
    found = judge(mission) if mission.was_executed else None
    return Comparison(tuple(entries), found)


def _several(mission: Mission) -> str:
    count = len(mission.figures)
    return f'planned: the first of {count} plans' if count > 1 else ''


def _durations(mission: Mission) -> Iterator[Entry]:
    """Durations of plans, and when states are within the verdict's tolerances for good."""
    note = _several(mission)
    for vehicle in mission.vehicles:
        if vehicle.plans:
            length = vehicle.plans[0].trajectory.duration
            plain = Entry('duration', 'duration of the plan', 's', length, vehicle=vehicle.name)
            yield plain._replace(note=note)
            if vehicle.states:
                yield _time_to_goal(vehicle, note)


def _time_to_goal(vehicle: RecordedVehicle, note: str) -> Entry:
    first, last = vehicle.plans[0], vehicle.plans[-1]
    reached, due = arrival(vehicle), _due(vehicle)
    if not vehicle.view.is_held(last.trajectory):
        reached, note = None, 'the plan ends in motion: its end is not held'
    if reached is not None:
        latest = last.end + vehicle.view.settling(last.trajectory.duration)
        end = float(vehicle.states.times[-1])
        # So late the recording may end while the plant happens to pass its goal.
        if reached > latest and end - reached < HOLD_TIME:
            early = end <= latest
            note = 'the recording ends before' if early else 'the goal was not held to the end'
            reached = None
    return Entry(
        kind='duration',
        name='time to the goal',
        unit='s',
        planned=due if due < math.inf else None,
        achieved=None if reached is None else max(reached - first.start, 0.0),
        vehicle=vehicle.name,
        note=note,
    )


def _due(vehicle: RecordedVehicle) -> float:
    """Return when the first plan's own states are at its goal for good [s]; inf if never."""
    motion = vehicle.plans[0].trajectory
    times = np.linspace(0.0, motion.duration, min(int(motion.duration / _STEP) + 2, _MOST_STEPS))
    states, _ = Signals.both(motion, times, motion.sample(times))
    return held_from(*goal_errors(vehicle.view, motion, states))


def _costs(mission: Mission) -> Iterator[Entry]:
    figures = mission.figures[0] if mission.figures else None
    if figures is None or figures.cost is None:
        return
    yield Entry('cost', 'cost J', '', figures.cost, note=_several(mission))
    if len(figures.cost_terms) > 1:
        for name, value in figures.cost_terms.items():
            yield Entry('cost', f'cost: {name}', '', value)


def _landings(mission: Mission) -> Iterator[Entry]:
    said = mission.figures[-1].terminal_error if mission.figures else {}
    for vehicle in mission.vehicles:
        plan = vehicle.plan
        if plan is None:
            continue
        motion = plan.trajectory
        for k, name in enumerate(motion.state_names):
            planned = said.get(name, said.get(f'{vehicle.name}.{name}'))
            measured = vehicle.states.at(np.array([plan.end])).table([name])
            away = float(vehicle.view.away(name, measured - motion.states[-1, k])[0, 0])
            achieved = away if math.isfinite(away) else None
            if planned is not None or achieved is not None:
                yield Entry(
                    kind='landing',
                    name=f'error of {name} at the planned end',
                    unit=motion.units.get(name, ''),
                    planned=planned,
                    achieved=achieved,
                    vehicle=vehicle.name,
                )


def _margins(mission: Mission) -> Iterator[Entry]:
    for vehicle in mission.vehicles:
        counted = vehicle.margins.measured.between(-math.inf, judged_until(vehicle))
        planned, measured = smallest(vehicle.margins.planned), smallest(counted)
        controls = () if vehicle.plan is None else vehicle.plan.trajectory.control_names
        for name in dict.fromkeys([*planned, *measured]):
            achieved = measured.get(name)
            # of a control: the plant could not do more
            at_limit = achieved is not None and abs(achieved.worst) <= ROUNDING
            mark = 'saturated' if at_limit and name.partition(', ')[0] in controls else ''
            entry = _smallest('margin', f'margin of {name}', planned.get(name), achieved)
            yield entry._replace(vehicle=vehicle.name, mark=mark)


def _smallest(kind: Kind, name: str, planned: Margin | None, achieved: Margin | None) -> Entry:
    unit = next((m.unit for m in (achieved, planned) if m is not None and m.unit), '')
    due, done = (None if m is None else m.worst for m in (planned, achieved))
    due_at, done_at = (None if m is None else m.instant for m in (planned, achieved))
    return Entry(kind, name, unit, due, done, due_at, done_at)


def _distances(mission: Mission) -> Iterator[Entry]:
    planned, measured = map(smallest, mission.separations)
    if not planned and not measured:
        return
    nearest = min(planned.values(), key=lambda m: m.worst, default=None)
    closest = min(measured.values(), key=lambda m: m.worst, default=None)
    yield _smallest('distance', 'smallest distance', nearest, closest)
    least = mission.vehicles[0].view.separation
    if least is not None:
        due, kept = (
            None if m is None else Margin(m.worst - least, m.instant, 'm')
            for m in (nearest, closest)
        )
        yield _smallest('margin', 'margin of separation', due, kept)


def _planner(mission: Mission) -> Iterator[Entry]:
    """Solve times, replans, late plans, and errors from the start of the first motion on."""
    times = [f.solve_time for f in mission.figures if f.solve_time is not None]
    if times:
        note = f'longest of {len(times)} plans' if len(times) > 1 else ''
        yield Entry('planner', 'time to solve', 's', mission.deadline, max(times), note=note)
    plans = max([len(mission.figures), *(len(v.plans) for v in mission.vehicles)], default=0)
    if not mission.was_executed and not mission.events:
        return
    yield Entry('planner', 'replans', '', None, float(max(plans - 1, 0)))
    yield Entry('planner', 'missed deadlines', '', 0.0, float(missed_deadlines(mission)))
    yield Entry('planner', 'errors reported by nodes', '', 0.0, float(_errors(mission)))


def _errors(mission: Mission) -> int:
    """Count the errors since the motion started, and those that still lasted then."""
    said_last: dict[str, Level] = {}
    count = 0
    for event in mission.events:
        if mission.is_early(event):
            said_last[event.source] = event.level
        else:
            count += event.level >= Level.ERROR
    return count + sum(level >= Level.ERROR for level in said_last.values())


def missed_deadlines(mission: Mission) -> int:
    """Count plans that took longer than allowed, came after their start, or never came."""
    deadline = math.inf if mission.deadline is None else mission.deadline
    late = [figures.late or (figures.solve_time or 0.0) > deadline for figures in mission.figures]
    return sum(late) + sum(event.text.startswith('DEADLINE:') for event in mission.events)
