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

"""Figures of what was kept on the way: margins, distances, tracking errors, deadlines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math
import re

import numpy as np
from tdm_sim.report.entries import Entry, ROUNDING
from tdm_sim.report.margins import History, smallest, THRUST
from tdm_sim.report.mission import Margin, Mission, Severity, Signals, Vehicle


def margin_entries(mission: Mission, histories: Mapping[str, History]) -> Iterator[Entry]:
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
            planned = _planned_margin(vehicle, name, own.get(name), drawn.get(name))
            row = _margin(name, planned, measured.get(name), vehicle.name)
            if row.planned is not None or row.achieved is not None:
                yield replace(row, mark=_mark(row, vehicle, name))
    for name, margin in said.items():
        if name not in used and not name.startswith('separation '):
            yield _margin(name, margin, None, '')


def _planned_margin(
    vehicle: Vehicle, name: str, said: Margin | None, drawn: Margin | None
) -> Margin | None:
    """
    Return what the planner's check found or, where it said nothing, that of the plan as drawn.

    The check takes both limits of a thrust together: the margin is 0 whenever a robot coasts.
    """
    if vehicle.plant != 'robot' or name != THRUST:
        return said or drawn
    violated = said is not None and said.worst < -ROUNDING
    return said if drawn is None and violated else drawn


def _mark(row: Entry, vehicle: Vehicle, name: str) -> str:
    """Say of a control that it was at its limit: the plant could not do more."""
    if row.achieved is None or abs(row.achieved) > ROUNDING or vehicle.plan is None:
        return ''
    return 'saturated' if name in vehicle.plan.trajectory.control_names else ''


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


def distance_entries(mission: Mission, history: History, minimum: float | None) -> Iterator[Entry]:
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


def tracking_entries(errors: Mapping[str, Signals]) -> Iterator[Entry]:
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


def planner_entries(mission: Mission) -> Iterator[Entry]:
    """
    Solving times, and how often plans were made anew, refused or late.

    Errors count from the start of the first plan's motion on: before, nodes wait for each other.
    """
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
    yield Entry('planner', 'errors reported by nodes', '', 0.0, float(_errors(mission)))


def _errors(mission: Mission) -> int:
    """Count errors since the motion started, those that a node had not got over by then too."""
    said_last: dict[str, Severity] = {}
    count = 0
    for event in mission.events:
        if mission.is_early(event):
            said_last[event.source] = event.level
        else:
            count += event.level >= Severity.ERROR
    return count + sum(level >= Severity.ERROR for level in said_last.values())


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
