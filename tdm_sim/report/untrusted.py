# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Texts and plans out of files and messages that anybody may have written."""

from __future__ import annotations

from collections.abc import Mapping
import json
from typing import Any

from tdm_planner.exceptions import TdmError
from tdm_planner.plant_kind import PlantKind
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem, problem_names
from tdm_planner.trajectory import SECOND
from tdm_sim.report.mission import PlanFigures

LONGEST_TEXT = 500
# what reading something else than a plan or its summary raises
UNREADABLE = (AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError)


def text(value: object, longest: int = LONGEST_TEXT) -> str:
    """Return a string on one line, without control characters, not overlong; '' if it is none."""
    if not isinstance(value, str):
        return ''
    start = value[: 4 * longest]
    line = ' '.join(''.join(c if c.isprintable() else ' ' for c in start).split())
    return line if len(line) <= longest and len(start) == len(value) else line[:longest] + '...'


def plan_figures(document: Mapping[str, Any]) -> PlanFigures:
    """
    Return the figures of a plan file or summary.

    Raise one of `UNREADABLE` where they are not as they are written.
    """
    cost, solve_time = document.get('cost'), document.get('solve_time')
    errors = document.get('verification', {}).get('terminal_error', {})
    return PlanFigures(
        cost=None if cost is None else float(cost),
        cost_terms={text(k, 200): float(v) for k, v in document.get('cost_terms', {}).items()},
        solve_time=None if solve_time is None else float(solve_time),
        summary=text(document.get('summary')),
        terminal_error={name: float(error) for name, error in errors.items()},
        parameters=dict(document.get('parameters', {})),
        problem=text(document['problem'], 100),
        vehicles={
            text(name): PlantKind.from_dict(told)
            for name, told in document.get('vehicles', {}).items()
        },
        document=document,
    )


def read_summary(data: str) -> tuple[int, PlanFigures]:
    """Return start of the motion [ns] and figures from a summary; raise one of `UNREADABLE`."""
    document = json.loads(data)
    stamp = document['stamp']
    start = int(stamp['sec']) * SECOND + int(stamp['nanosec'])
    if not 0 <= start < 2**63:
        raise ValueError('no instant')
    return start, plan_figures(document)


def problem_of(figures: PlanFigures, given: type[Problem] | None) -> tuple[Problem | None, str]:
    """
    Return the problem that was planned for, or None and the reason where it is not known.

    It is of the class `given` if that has the name, else an installed one: a module that a
    recording names is not imported.
    """
    name = figures.problem
    if given is None or given.name != name:
        if name not in problem_names():
            if given is not None:
                return None, f"The plan is of '{name}', not of '{given.name}', the `--problem`."
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
        return (
            None,
            f'Limits are not known: the recorded parameters are invalid ({text(str(error))}).',
        )
