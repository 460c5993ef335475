# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Planned against achieved: the figures of a mission's summary, and the histories behind them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
import math
import re
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from tdm_sim.report.margins import (
    History,
    Limits,
    limits_of,
    margin_history,
    separations,
    smallest,
)
from tdm_sim.report.mission import Margin, Mission, Severity, Signals, Vehicle
from tdm_sim.report.outcome import arrival, landing_errors, tracking_errors, verdict
from tdm_sim.verdict import Verdict

Array = NDArray[np.float64]
Kind = Literal['duration', 'cost', 'landing', 'margin', 'distance', 'tracking', 'planner']

_ROUNDING = 1e-6  # of a margin, in its unit


@dataclass(frozen=True)
class Entry:
    """A figure, planned and achieved; None: there is none. '' as vehicle: of all together.

    `planned_at` and `achieved_at` are instants since the mission's origin [s].
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

    @property
    def violated(self) -> bool:
        """Whether this is a margin that was not kept, as planned or as achieved."""
        known = [value for value in (self.planned, self.achieved) if value is not None]
        return self.kind == 'margin' and any(value < -_ROUNDING for value in known)


@dataclass(frozen=True, eq=False)
class Comparison:
    """What a report shows beside the mission itself.

    `entries` stand in the order of the summary; `margins` and `tracking_errors` are by vehicle;
    `separations` are distances of pairs, `minimum_separation` what they must keep [m]; `verdict`
    is the demo's judgement, None where not enough was recorded for one; `missing` says what could
    not be computed.
    """

    entries: tuple[Entry, ...]
    margins: Mapping[str, History] = field(default_factory=dict)
    separations: History = field(default_factory=History)
    minimum_separation: float | None = None
    tracking_errors: Mapping[str, Signals] = field(default_factory=dict)
    verdict: Verdict | None = None
    missing: tuple[str, ...] = ()

    def of(self, kind: Kind, vehicle: str | None = None) -> tuple[Entry, ...]:
        """Return the entries of a kind, of one vehicle if it is given."""
        return tuple(
            entry
            for entry in self.entries
            if entry.kind == kind and (vehicle is None or entry.vehicle == vehicle)
        )


def compare(mission: Mission) -> Comparison:
    """Compare what was planned with what was achieved."""
    limits = limits_of(mission)
    margins = {v.name: margin_history(v, limits) for v in mission.vehicles}
    apart = separations(mission)
    errors = {vehicle.name: tracking_errors(vehicle) for vehicle in mission.vehicles}
    arrivals = {vehicle.name: arrival(vehicle) for vehicle in mission.vehicles}
    minimum = mission.number('arena.minimum_separation')
    known = {name: error for name, error in errors.items() if error is not None}
    entries = [
        *_durations(mission, arrivals),
        *_costs(mission, limits, arrivals),
        *_landings(mission),
        *_margin_entries(mission, margins),
        *_distance_entries(mission, apart, minimum),
        *_tracking_entries(known),
        *_planner_entries(mission),
    ]
    return Comparison(
        entries=tuple(entries),
        margins=margins,
        separations=apart,
        minimum_separation=minimum,
        tracking_errors=known,
        verdict=verdict(mission, limits) if mission.was_carried_out else None,
        missing=(limits.fault,) if limits.fault else (),
    )


def _several(mission: Mission) -> str:
    count = len(mission.figures)
    return f'planned: the first of {count} plans' if count > 1 else ''


def _durations(mission: Mission, arrivals: Mapping[str, float | None]) -> Iterator[Entry]:
    """When the goal was reached for good, counted from the start of the first plan."""
    rows = []
    for vehicle in mission.vehicles:
        if vehicle.plans:
            reached = arrivals[vehicle.name]
            start = vehicle.plans[0].start
            note = 'the goal was not held to the end' if reached == math.inf else ''
            rows.append(
                Entry(
                    kind='duration',
                    name='time to the goal',
                    unit='s',
                    planned=vehicle.plans[0].trajectory.duration,
                    achieved=None
                    if reached is None or math.isinf(reached)
                    else max(reached - start, 0.0),
                    planned_at=vehicle.plans[0].end,
                    achieved_at=None if reached is None or math.isinf(reached) else reached,
                    vehicle=vehicle.name,
                    note=note or _several(mission),
                )
            )
    if len(rows) > 1:
        done = [row.achieved for row in rows if row.achieved is not None]
        yield Entry(
            kind='duration',
            name='time until all are at the goal',
            unit='s',
            planned=max(row.planned for row in rows if row.planned is not None),
            achieved=max(done) if len(done) == len(rows) else None,
            note=_several(mission),
        )
    yield from rows


def _costs(
    mission: Mission, limits: Limits, arrivals: Mapping[str, float | None]
) -> Iterator[Entry]:
    """The performance index and its terms, as planned and for the motion as it was measured."""
    figures = mission.figures[0] if mission.figures else None
    planned = {} if figures is None else dict(figures.cost_terms)
    achieved = _achieved_terms(mission, limits, arrivals)
    total = sum(achieved.values()) if achieved else None
    if figures is None or figures.cost is None:
        return
    unit = 's' if mission.problem == 'pendulum_swing_up' else ''
    yield Entry('cost', 'cost J', unit, figures.cost, total, note=_several(mission))
    if len(planned) > 1 or len(achieved) > 1:
        for name in dict.fromkeys([*planned, *achieved]):
            yield Entry('cost', f'cost: {name}', unit, planned.get(name), achieved.get(name))


def _achieved_terms(
    mission: Mission, limits: Limits, arrivals: Mapping[str, float | None]
) -> dict[str, float]:
    """Terms of J for the measured motion until the goal was held; empty where not known."""
    times = {}
    for vehicle in mission.vehicles:
        reached = arrivals[vehicle.name]
        if reached is None or math.isinf(reached):
            return {}
        times[vehicle.name] = max(reached - vehicle.plans[0].start, 0.0)
    if mission.problem == 'pendulum_swing_up' and len(times) == 1:
        return {'time': next(iter(times.values()))}
    task = limits.formation
    if task is None or set(task.names) != set(times):
        return {}
    by_name = {vehicle.name: vehicle for vehicle in mission.vehicles}
    gas = [_gas(by_name[name], times[name]) for name in task.names]
    if any(value is None for value in gas):
        return {}
    arrived = np.array([times[name] for name in task.names])
    return task.cost_terms(arrived, np.array(gas, dtype=float) / task.plant.mass)


def _gas(robot: Vehicle, duration: float) -> float | None:
    """Return the integral of the thrust [N s] until the goal is reached, or was to be."""
    if robot.controls is None or 'thrust' not in robot.controls:
        return None
    start = robot.plans[0].start
    during = robot.controls.between(start, max(start + duration, robot.plans[-1].end))
    thrust = during.column('thrust')
    known = np.isfinite(thrust)
    return float(trapezoid(thrust[known], during.times[known])) if known.any() else None


def _landings(mission: Mission) -> Iterator[Entry]:
    """Where the vehicle was when the last plan was to end."""
    said = mission.figures[-1].terminal_error if mission.figures else {}
    for vehicle in mission.vehicles:
        plan = vehicle.plan
        if plan is None:
            continue
        errors: dict[str, float | None] = {**landing_errors(vehicle)}
        planned = {
            name: said.get(name, said.get(f'{vehicle.name}.{name}'))
            for name in plan.trajectory.state_names
        }
        units = plan.trajectory.units
        if vehicle.plant == 'robot':
            planned, errors = _polar(planned), _polar(errors)
            units = {'position': 'm', 'velocity': 'm/s', 'yaw': 'rad', 'omega': 'rad/s'}
        for name in dict.fromkeys([*planned, *errors]):
            if planned.get(name) is None and name not in errors:
                continue
            yield Entry(
                kind='landing',
                name=f'error of {name} at the planned end',
                unit=units.get(name, ''),
                planned=planned.get(name),
                achieved=errors.get(name),
                achieved_at=plan.end,
                vehicle=vehicle.name,
            )


def _polar(errors: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return errors of position and velocity as lengths."""

    def length(*names: str) -> float | None:
        values = [errors.get(name) for name in names]
        known = [value for value in values if value is not None]
        return math.hypot(*known) if len(known) == len(values) else None

    found = {
        'position': length('x', 'y'),
        'velocity': length('u', 'v'),
        'yaw': errors.get('yaw'),
        'omega': errors.get('omega'),
    }
    return {name: value for name, value in found.items() if value is not None}


def _margin_entries(mission: Mission, histories: Mapping[str, History]) -> Iterator[Entry]:
    """Worst margins: as the planner's check found them, and of the measured motion."""
    said = _said_margins(mission)
    used: set[str] = set()
    for vehicle in mission.vehicles:
        history = histories[vehicle.name]
        measured, drawn = smallest(history.measured), smallest(history.planned)
        own = {
            name.removeprefix(f'{vehicle.name}.'): margin
            for name, margin in said.items()
            if name.startswith(f'{vehicle.name}.') or len(mission.vehicles) == 1
        }
        used |= {n for n in said if n in own or n.startswith(f'{vehicle.name}.')}
        for name in dict.fromkeys([*own, *drawn, *measured]):
            yield _margin(name, own.get(name) or drawn.get(name), measured.get(name), vehicle.name)
    for name, margin in said.items():
        if name not in used and not name.startswith('separation '):
            yield _margin(name, margin, None, '')


def _margin(name: str, planned: Margin | None, achieved: Margin | None, vehicle: str) -> Entry:
    unit = next((m.unit for m in (achieved, planned) if m is not None and m.unit), '')
    return Entry(
        kind='margin',
        name=f'margin of {name}',
        unit=unit,
        planned=None if planned is None else planned.worst,
        achieved=None if achieved is None else achieved.worst,
        planned_at=None if planned is None else planned.instant,
        achieved_at=None if achieved is None else achieved.instant,
        vehicle=vehicle,
    )


def _said_margins(mission: Mission) -> dict[str, Margin]:
    """Return the worst margin of all plans by constraint, instants since the mission's origin."""
    found: dict[str, Margin] = {}
    for figures in mission.figures:
        for name, margin in figures.margins.items():
            at = None if margin.instant is None else figures.time + margin.instant
            if name not in found or margin.worst < found[name].worst:
                found[name] = Margin(margin.worst, at, margin.unit)
    return found


def _distance_entries(
    mission: Mission, history: History, minimum: float | None
) -> Iterator[Entry]:
    """Smallest distance of every pair, and of all."""
    planned, measured = smallest(history.planned), smallest(history.measured)
    names = list(dict.fromkeys([*planned, *measured]))
    rows = [_distance(name, planned.get(name), measured.get(name)) for name in names]
    if not rows:
        return
    nearest = min(planned.values(), key=lambda m: m.worst, default=None)
    closest = min(measured.values(), key=lambda m: m.worst, default=None)
    yield _distance('smallest distance of two robots', nearest, closest)
    if minimum is not None:
        yield _margin(
            'separation',
            None if nearest is None else Margin(nearest.worst - minimum, nearest.instant, 'm'),
            None if closest is None else Margin(closest.worst - minimum, closest.instant, 'm'),
            '',
        )
    if len(rows) > 1:
        yield from rows


def _distance(name: str, planned: Margin | None, achieved: Margin | None) -> Entry:
    return Entry(
        kind='distance',
        name=name,
        unit='m',
        planned=None if planned is None else planned.worst,
        achieved=None if achieved is None else achieved.worst,
        planned_at=None if planned is None else planned.instant,
        achieved_at=None if achieved is None else achieved.instant,
    )


def _tracking_entries(errors: Mapping[str, Signals]) -> Iterator[Entry]:
    """Root mean square and largest tracking error while plans were carried out."""
    for vehicle, history in errors.items():
        for name, unit, column in zip(history.names, history.units, history.values.T, strict=True):
            if not np.isfinite(column).any():
                continue
            k = int(np.nanargmax(np.abs(column)))
            rms = math.sqrt(float(np.nanmean(column**2)))
            yield Entry('tracking', f'rms error of {name}', unit, None, rms, vehicle=vehicle)
            yield Entry(
                kind='tracking',
                name=f'largest error of {name}',
                unit=unit,
                achieved=abs(float(column[k])),
                achieved_at=float(history.times[k]),
                vehicle=vehicle,
            )


def _planner_entries(mission: Mission) -> Iterator[Entry]:
    """Solving times, and how often plans were made anew, refused or late."""
    times = [f.solve_time for f in mission.figures if f.solve_time is not None]
    deadline = mission.number('solver.deadline')
    if times:
        note = f'longest of {len(times)} plans' if len(times) > 1 else ''
        yield Entry('planner', 'time to solve', 's', deadline, max(times), note=note)
    plans = max([len(mission.figures), *(len(v.plans) for v in mission.vehicles)], default=0)
    if not mission.was_carried_out and not mission.events:
        return
    yield Entry('planner', 'replans', '', None, float(max(plans - 1, 0)))
    refused = mission.counters.get('failures')
    if refused is not None:
        yield Entry('planner', 'requests without a plan', '', None, float(refused))
    yield Entry('planner', 'missed deadlines', '', 0.0, float(missed_deadlines(mission)))
    grave = sum(event.level >= Severity.ERROR for event in mission.events)
    yield Entry('planner', 'errors reported by nodes', '', 0.0, float(grave))


def missed_deadlines(mission: Mission) -> int:
    """Count plans that took longer than allowed, came after their start, or never came."""
    deadline = mission.number('solver.deadline')
    slow = [
        figures
        for figures in mission.figures
        if deadline is not None
        and figures.solve_time is not None
        and figures.solve_time > deadline
    ]
    late = [
        event
        for event in mission.events
        if event.text.startswith('DEADLINE:')
        or re.match(r'plan \d+ is published .* after the start', event.text)
    ]
    return len(slow) + len(late)
