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

"""Figures of plans, from plan files and `plan_summary` messages or, failing these, diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import json
import re
from typing import Any, cast, get_args

from tdm_planner.plant_kind import Joint, QUANTITIES
from tdm_planner.trajectory import Interpolation
from tdm_sim.report import untrusted
from tdm_sim.report.mission import Margin, PlanFigures

_LONGEST_DOCUMENT = 10_000_000  # characters
_SECOND = 1_000_000_000  # ns


@dataclass(frozen=True)
class PlannedVehicle:
    """What a summary says of a vehicle's samples: how to read between them, units, joints."""

    interpolation: Interpolation | None
    units: Mapping[str, str]
    joints: tuple[Joint, ...] = ()


@dataclass(frozen=True)
class PlanSummary:
    """A `plan_summary` message: start of the motion [ns], problem, figures, vehicles by name."""

    start: int
    problem: str
    document: Mapping[str, Any]
    vehicles: Mapping[str, PlannedVehicle]

    def figures(self, origin: int) -> PlanFigures:
        """Return the figures, with times that count from `origin` [ns]."""
        return plan_figures(self.document, (self.start - origin) / _SECOND)


def plan_figures(document: Mapping[str, Any], time: float) -> PlanFigures:
    """Return the figures of a plan file or summary, whose motion starts at `time` [s]."""
    check = untrusted.mapping(document.get('verification'))
    instants = untrusted.numbers(check.get('worst_times'))
    units = untrusted.mapping(check.get('units'))
    return PlanFigures(
        plan_id=_plan_id(document.get('plan_id')),
        time=time,
        duration=untrusted.number(document.get('duration')),
        cost=untrusted.number(document.get('cost')),
        cost_terms=untrusted.numbers(document.get('cost_terms')),
        penalty=untrusted.number(document.get('penalty')),
        solve_time=untrusted.number(document.get('solve_time')),
        evaluations=untrusted.whole(document.get('evaluations')),
        summary=untrusted.text(document.get('summary')),
        margins={
            name: Margin(worst, instants.get(name), untrusted.text(units.get(name), 20))
            for name, worst in untrusted.numbers(check.get('worst')).items()
        },
        terminal_error=untrusted.numbers(check.get('terminal_error')),
        parameters=untrusted.parameters(document.get('parameters')),
    )


def _plan_id(value: object) -> str:
    found = untrusted.whole(value)
    return untrusted.text(value, 40) if found is None else str(found)


def read_summary(data: str) -> PlanSummary | None:
    """Return a summary from its JSON; None if it is not one."""
    if len(data) > _LONGEST_DOCUMENT:
        return None
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return None
    document = untrusted.mapping(document)
    stamp = untrusted.mapping(document.get('stamp'))
    sec, nanosec = (untrusted.whole(stamp.get(name)) for name in ('sec', 'nanosec'))
    if sec is None or nanosec is None or 'problem' not in document:
        return None
    if not (abs(sec) < 2**31 and 0 <= nanosec < _SECOND):
        return None
    return PlanSummary(
        start=sec * _SECOND + nanosec,
        problem=untrusted.text(document['problem'], 100),
        document=document,
        vehicles={
            name: _vehicle(untrusted.mapping(item))
            for name, item in untrusted.mapping(document.get('vehicles')).items()
        },
    )


def _vehicle(document: Mapping[str, Any]) -> PlannedVehicle:
    kind = document.get('interpolation')
    units = untrusted.mapping(document.get('units'))
    return PlannedVehicle(
        cast(Interpolation, kind) if kind in get_args(Interpolation) else None,
        {name: untrusted.text(unit, 20) for name, unit in units.items()},
        tuple(
            Joint(name, *(untrusted.text(item.get(what), 60) for what in QUANTITIES))
            for name, item in (
                (untrusted.text(name, 60), untrusted.mapping(item))
                for name, item in untrusted.mapping(document.get('joints')).items()
            )
        ),
    )


def diagnosed_figures(values: Mapping[str, str], time: float) -> PlanFigures | None:
    """Return the figures that the planner's diagnostics give of the plan in force, if any."""
    plan_id = values.get('plan id', '0')
    if plan_id == '0' or not re.fullmatch(r'\d{1,9}', plan_id):
        return None
    found = {name: _parsed(value) for name, value in values.items()}
    margins = {
        name.removeprefix('margin of '): Margin(value)
        for name, value in found.items()
        if name.startswith('margin of ') and value is not None
    }
    evaluations = found.get('evaluations')
    return PlanFigures(
        plan_id=plan_id,
        time=time,
        duration=found.get('duration [s]'),
        cost=found.get('cost'),
        penalty=found.get('penalty'),
        solve_time=found.get('solve time [s]'),
        evaluations=None if evaluations is None else int(evaluations),
        margins=margins,
    )


def _parsed(value: str) -> float | None:
    try:
        return untrusted.number(float(value))
    except ValueError:
        return None
