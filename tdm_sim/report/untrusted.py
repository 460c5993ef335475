# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Values and plans out of files and messages that anybody may have written: checked, bounded."""

from __future__ import annotations

from collections.abc import Mapping
import itertools
import json
import math
from typing import Any, cast, get_args

from tdm_planner.exceptions import TdmError
from tdm_planner.plant_kind import Joint, PlantKind, QUANTITIES
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem, problem_names
from tdm_planner.trajectory import Interpolation, SECOND
from tdm_sim.report.mission import PlanFigures

LONGEST_TEXT = 500
MOST_ENTRIES = 2000
_LONGEST_DOCUMENT = 10_000_000  # characters


def text(value: object, longest: int = LONGEST_TEXT) -> str:
    """Return a string on one line, without control characters, not overlong; '' if it is none."""
    if not isinstance(value, str):
        return ''
    start = value[: 4 * longest]
    line = ' '.join(''.join(c if c.isprintable() else ' ' for c in start).split())
    return line if len(line) <= longest and len(start) == len(value) else line[:longest] + '...'


def number(value: object) -> float | None:
    """Return a finite number; None if it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None


def mapping(value: object) -> dict[str, Any]:
    """Return a mapping with clean names; empty if it is none."""
    if not isinstance(value, Mapping):
        return {}
    return {text(str(k), 200): v for k, v in itertools.islice(value.items(), MOST_ENTRIES)}


def numbers(value: object) -> dict[str, float]:
    """Return the finite numbers of a mapping, by name."""
    found = {name: number(item) for name, item in mapping(value).items()}
    return {name: item for name, item in found.items() if item is not None}


def parameters(value: object) -> dict[str, object]:
    """Return a mapping's values that a parameter may have: scalars and flat lists of them."""
    return {
        name: [*map(_scalar, item[:MOST_ENTRIES])] if isinstance(item, list) else _scalar(item)
        for name, item in mapping(value).items()
    }


def _scalar(value: object) -> object:
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int):
        return value if number(value) is not None else None
    return text(value) if isinstance(value, str) else number(value)


def plan_figures(document: Mapping[str, Any]) -> PlanFigures:
    """Return the figures of a plan file or summary, as if its motion started at the origin."""
    check = mapping(document.get('verification'))
    return PlanFigures(
        time=0.0,
        cost=number(document.get('cost')),
        cost_terms=numbers(document.get('cost_terms')),
        solve_time=number(document.get('solve_time')),
        summary=text(document.get('summary')),
        terminal_error=numbers(check.get('terminal_error')),
        parameters=parameters(document.get('parameters')),
        problem=text(document.get('problem'), 100),
        vehicles={
            name: _vehicle(mapping(item))
            for name, item in mapping(document.get('vehicles')).items()
        },
        document=document,
    )


def read_summary(data: str) -> tuple[int, PlanFigures] | None:
    """Return start of the motion [ns] and figures from a summary's JSON; None if it is none."""
    if len(data) > _LONGEST_DOCUMENT:
        return None
    try:
        document = mapping(json.loads(data))
    except (ValueError, RecursionError):
        return None
    stamp = numbers(document.get('stamp'))
    sec, nanosec = (stamp.get(name, math.nan) for name in ('sec', 'nanosec'))
    whole = sec.is_integer() and nanosec.is_integer()
    if not (whole and abs(sec) < 2**31 and 0 <= nanosec < SECOND and 'problem' in document):
        return None
    return int(sec) * SECOND + int(nanosec), plan_figures(document)


def _vehicle(document: Mapping[str, Any]) -> PlantKind:
    told = document.get('interpolation')
    joints = tuple(
        Joint(name, *(text(mapping(j).get(what), 60) for what in QUANTITIES))
        for name, j in mapping(document.get('joints')).items()
    )
    given = mapping(document.get('units'))
    units = {name: text(u, 20) for name, u in given.items()}
    named = [name for joint in joints for name in (joint.position, joint.velocity) if name]
    states = tuple(dict.fromkeys([*(name for name in units if name in named), *named]))
    controls = tuple(joint.effort for joint in joints if joint.effort)
    return PlantKind(
        state_names=states,
        control_names=controls,
        joints=joints,
        state_units=tuple(units.get(name, '') for name in states),
        control_units=tuple(units.get(name, '') for name in controls),
        interpolation=cast(Interpolation, told) if told in get_args(Interpolation) else None,
    )


def problem_of(figures: PlanFigures, given: type[Problem] | None) -> tuple[Problem | None, str]:
    """
    Return the problem that was planned for, or None and the reason where it is not known.

    It is of the class `given` if that has the name, else an installed one: a module that a
    recording names is not imported.
    """
    name = figures.problem
    if given is None or given.name != name:
        if name not in problem_names():
            absent = (
                f"The problem '{name}' is not installed: goal, limits and picture are not known. "
                '`--problem module:Class` tells them.'
            )
            return None, absent if name else ''
        given = load_problem(name)
    if not figures.parameters:
        return None, ''
    try:
        return given.from_parameters(figures.parameters), ''
    except TdmError as error:
        return None, f'Limits are not known: the recorded parameters are invalid ({error}).'
