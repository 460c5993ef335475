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

"""Figures of reaching the goal: when, at what cost, with which error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math

import numpy as np
from tdm_sim.report.entries import Entry
from tdm_sim.report.margins import Limits
from tdm_sim.report.mission import Mission, Signals, Vehicle
from tdm_sim.report.outcome import arrival, could_arrive, landing_errors
from tdm_sim.verdict import planned_instants


def _several(mission: Mission) -> str:
    count = len(mission.figures)
    return f'planned: the first of {count} plans' if count > 1 else ''


def duration_entries(mission: Mission, arrivals: Mapping[str, float | None]) -> Iterator[Entry]:
    """
    How long plans are, and when the goal is reached for good, from the start of the first plan.

    A plan ends at rest in the goal. The goal counts as reached within the tolerances of the
    verdict, before that: planned and measured states are judged alike.
    """
    planned = [vehicle for vehicle in mission.vehicles if vehicle.plans]
    lengths = [_length(vehicle, _several(mission)) for vehicle in planned]
    if len(lengths) > 1:
        longest = max(row.planned for row in lengths if row.planned is not None)
        yield Entry('duration', 'duration of all plans', 's', longest, note=_several(mission))
    yield from lengths
    rows = [
        _duration(vehicle, arrivals[vehicle.name], _several(mission))
        for vehicle in planned
        if vehicle.states is not None
    ]
    if len(rows) > 1:
        due = [row.planned for row in rows if row.planned is not None]
        done = [row.achieved for row in rows if row.achieved is not None]
        yield Entry(
            kind='duration',
            name='time until all are at the goal',
            unit='s',
            planned=max(due) if len(due) == len(rows) else None,
            achieved=max(done) if len(done) == len(rows) else None,
            note=_several(mission),
        )
    yield from rows


def _length(vehicle: Vehicle, note: str) -> Entry:
    first = vehicle.plans[0]
    return Entry(
        kind='duration',
        name='duration of the plan',
        unit='s',
        planned=first.trajectory.duration,
        planned_at=first.end,
        vehicle=vehicle.name,
        note=note,
    )


def _planned_arrival(vehicle: Vehicle) -> float | None:
    """Return when the first plan's own states are within the tolerances for good [s]."""
    first = vehicle.plans[0]
    times = first.start + planned_instants(first.trajectory)
    names = first.trajectory.state_names
    states = Signals(times, first.states(times), names, ('',) * len(names))
    reached = arrival(replace(vehicle, plans=(first,), states=states))
    return reached if reached is not None and math.isfinite(reached) else None


def _duration(vehicle: Vehicle, reached: float | None, note: str) -> Entry:
    first = vehicle.plans[0]
    due = _planned_arrival(vehicle)
    known = reached is not None and math.isfinite(reached)
    if reached == math.inf:
        early = could_arrive(vehicle)
        note = 'the recording ends before' if early else 'the goal was not held to the end'
    return Entry(
        kind='duration',
        name='time to the goal',
        unit='s',
        planned=None if due is None else due - first.start,
        achieved=max(reached - first.start, 0.0) if known and reached is not None else None,
        planned_at=due,
        achieved_at=reached if known else None,
        vehicle=vehicle.name,
        note=note,
    )


def cost_entries(
    mission: Mission, limits: Limits, arrivals: Mapping[str, float | None]
) -> Iterator[Entry]:
    """Yield performance index and its terms, as planned and for the motion as it was measured."""
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
    """
    Terms of J for the measured motion; empty where not known.

    All terms span the same time of every vehicle: until the planned end, where the plan is at
    rest, or, if the goal was reached later, until then.
    """
    times = {}
    for vehicle in mission.vehicles:
        reached = arrivals[vehicle.name]
        if reached is None or math.isinf(reached):
            return {}
        until = max(reached, vehicle.plans[-1].end)
        if vehicle.states is None or vehicle.states.times[-1] < until:
            return {}
        times[vehicle.name] = until - vehicle.plans[0].start
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
    """
    Return the integral of the thrust [N s] from the first plan's start on for `duration` s.

    A command holds until the next one.
    """
    if robot.controls is None or 'thrust' not in robot.controls:
        return None
    start = robot.plans[0].start
    during = robot.controls.between(start, start + duration)
    thrust = during.column('thrust')
    known = np.isfinite(thrust)
    held = np.diff(during.times[known], append=start + duration)
    return float(thrust[known] @ held) if known.any() else None


def landing_entries(mission: Mission) -> Iterator[Entry]:
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
