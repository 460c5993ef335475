# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Figures of plans, from plan files and `plan_summary` messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import json
import math
from typing import Any, cast, get_args

from tdm_planner.exceptions import TdmError
from tdm_planner.plant_kind import Joint, PlantKind, QUANTITIES
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem, problem_names
from tdm_planner.trajectory import Interpolation
from tdm_sim.report import untrusted
from tdm_sim.report.mission import Margin, PlanFigures

_LONGEST_DOCUMENT = 10_000_000  # characters
_SECOND = 1_000_000_000  # ns


@dataclass(frozen=True)
class PlannedVehicle:
    """A vehicle of a summary: how its controls run between samples, and its joints."""

    interpolation: Interpolation | None
    kind: PlantKind | None


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
        time=time,
        cost=untrusted.number(document.get('cost')),
        cost_terms=untrusted.numbers(document.get('cost_terms')),
        solve_time=untrusted.number(document.get('solve_time')),
        summary=untrusted.text(document.get('summary')),
        margins={
            name: Margin(worst, instants.get(name), untrusted.text(units.get(name), 20))
            for name, worst in untrusted.numbers(check.get('worst')).items()
        },
        terminal_error=untrusted.numbers(check.get('terminal_error')),
        parameters=untrusted.parameters(document.get('parameters')),
    )


def read_summary(data: str) -> PlanSummary | None:
    """Return a summary from its JSON; None if it is not one."""
    if len(data) > _LONGEST_DOCUMENT:
        return None
    try:
        document = untrusted.mapping(json.loads(data))
    except (ValueError, RecursionError):
        return None
    stamp = untrusted.numbers(document.get('stamp'))
    sec, nanosec = (stamp.get(name, math.nan) for name in ('sec', 'nanosec'))
    whole = sec.is_integer() and nanosec.is_integer()
    if not (whole and abs(sec) < 2**31 and 0 <= nanosec < _SECOND and 'problem' in document):
        return None
    return PlanSummary(
        start=int(sec) * _SECOND + int(nanosec),
        problem=untrusted.text(document['problem'], 100),
        document=document,
        vehicles={
            name: _vehicle(untrusted.mapping(item))
            for name, item in untrusted.mapping(document.get('vehicles')).items()
        },
    )


def _vehicle(document: Mapping[str, Any]) -> PlannedVehicle:
    told = document.get('interpolation')
    joints = tuple(
        Joint(name, *(untrusted.text(untrusted.mapping(j).get(what), 60) for what in QUANTITIES))
        for name, j in untrusted.mapping(document.get('joints')).items()
    )
    given = untrusted.mapping(document.get('units'))
    units = {name: untrusted.text(u, 20) for name, u in given.items()}
    named = [name for joint in joints for name in (joint.position, joint.velocity) if name]
    states = tuple(dict.fromkeys([*(name for name in units if name in named), *named]))
    controls = tuple(joint.effort for joint in joints if joint.effort)
    kind = PlantKind(
        state_names=states,
        control_names=controls,
        joints=joints,
        state_units=tuple(units.get(name, '') for name in states),
        control_units=tuple(units.get(name, '') for name in controls),
    )
    return PlannedVehicle(
        cast(Interpolation, told) if told in get_args(Interpolation) else None,
        kind if joints else None,
    )


def problem_of(
    name: str, parameters: Mapping[str, object], given: type[Problem] | None
) -> tuple[Problem | None, str]:
    """
    Return the problem that was planned for, or None and the reason where it is not known.

    It is of the class `given` if that has the name, else an installed one: a module that a
    recording names is not imported.
    """
    if given is None or given.name != name:
        if name not in problem_names():
            absent = (
                f"The problem '{name}' is not installed: goal, limits and picture are not known. "
                '`--problem module:Class` tells them.'
            )
            return None, absent if name else ''
        given = load_problem(name)
    if not parameters:
        return None, ''
    try:
        return given.from_parameters(parameters), ''
    except TdmError as error:
        return None, f'Limits are not known: the recorded parameters are invalid ({error}).'
