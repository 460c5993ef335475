# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of planning: those that no problem has for itself, and the check of a problem's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, MISSING
from typing import Any, cast, TYPE_CHECKING

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import ros_parameters
from tdm_planner.parameters import (
    flatten,
    group,
    parameter,
    positive,
    Range,
    SEED,
    shown,
    specifications,
    suggestion,
    Validated,
)

if TYPE_CHECKING:
    from tdm_planner.problems.problem import Problem

_FEW = 30  # parameters that a message can list


@dataclass(frozen=True)
class SolverParameters(Validated):
    """How long and how hard to search."""

    deadline: float = positive(
        0.5, 'longest time to search for a plan; the search may end earlier', 's'
    )
    seed: int = parameter(
        0,
        'seed of the random initial guesses; the same seed gives the same plan where the deadline '
        'cuts no stage of the search short',
        allowed=SEED,
    )
    tolerance: float = positive(
        1e-8, 'largest penalty that minimisers count as feasible, eps of (10)'
    )


@dataclass(frozen=True)
class StartParameters(Validated):
    """Where the start state of a plan comes from, and when the motion starts."""

    source: str = parameter(
        'measured',
        'plan from the newest measured state or from the start.* parameters',
        choices=('measured', 'parameters'),
    )
    max_age: float = positive(0.5, 'oldest measured state that may be planned from', 's')
    delay: float = parameter(
        1.0,
        'time from the request to the start of the motion; more than solver.deadline, or a plan '
        'may come late',
        unit='s',
        allowed=Range(0.0, 3600.0),
    )


@dataclass(frozen=True)
class ReplanParameters(Validated):
    """Receding-horizon replanning."""

    rate: float = parameter(
        0.0,
        'reviews of the active plan per second, each of which may replace it; 0 switches them off',
        unit='Hz',
        allowed=Range(0.0, 100.0),
    )
    delay: float = parameter(
        0.15,
        'time from a measured state to the start of the plan made from it: planning, '
        'publishing, preparing the feedback',
        unit='s',
        allowed=Range(0.0, 10.0, lower_open=True),
    )
    improvement: float = parameter(
        0.1,
        'a plan that still works is replaced only if the new one saves more than this share of '
        'the cost still to come',
        allowed=Range(0.0, 1.0),
    )
    deviation: float = positive(
        0.05,
        'not for pendulum and robots: deviation of a state from the active plan that requires a '
        'new one, as a share of the largest range of the states of that unit',
    )


@dataclass(frozen=True)
class PlannerParameters(Validated):
    """What the planner node knows beside the problem's own parameters."""

    problem: str = parameter(
        'pendulum_swing_up', 'name of the problem to plan for', read_only=True
    )
    autostart: bool = parameter(
        True,
        'become active at the start; false: wait for a lifecycle manager',
        read_only=True,
    )
    start: StartParameters = group(StartParameters)
    replan: ReplanParameters = group(ReplanParameters)


def problem_parameters(cls: type[Problem], parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Flatten and check a mapping of parameters for a problem; node parameters are ignored.

    Raise InvalidProblem for a name the problem does not have, or a value that is not allowed.
    """
    cls.check_class()
    for item in fields(cast(Any, cls)):
        if item.init and item.default is MISSING and item.default_factory is MISSING:
            raise InvalidProblem(
                f'{cls.__name__}.{item.name} has no default: declare it by parameter(...)'
            )
    values = flatten(parameters)
    if any('.ros__parameters.' in name for name in values):  # a whole file's document
        values = ros_parameters(parameters)
    specs = cls.parameter_specifications(values)
    known = {*specs, *specifications(PlannerParameters), 'use_sim_time'}
    unknown = [name for name in values if name not in known]
    if unknown:
        plain = {item.name for item in fields(cast(Any, cls))} - {n.split('.')[0] for n in specs}
        hint = 'it is a field without parameter(...)' if unknown[0] in plain else ''
        hint = hint or _left_out(unknown[0], values) or suggestion(unknown[0], specs)
        listed = '; it has: ' + ', '.join(specs) if len(specs) <= _FEW else ''
        raise InvalidProblem(
            f"parameter '{shown(unknown[0])}' is unknown to {cls.name}"
            + (f': {hint}' if hint else listed)
        )
    return {name: specs[name].check(value) for name, value in values.items() if name in specs}


def _left_out(name: str, values: Mapping[str, Any]) -> str:
    """Say of a parameter of a robot that the robot is not among those that `values` name."""
    robot, robots = name.removeprefix('formation.').split('.')[0], values.get('robots')
    named = any(value.startswith(f'{robot}.start.') for value in values)
    if not named or not isinstance(robots, list | tuple) or robot in robots:
        return ''
    return f"'{shown(robot)}' is not among robots = [{', '.join(map(str, robots))}]"
