# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a study varies: parameters and their values, and all combinations of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product
import json
import math
import re
from typing import Any, Literal

import numpy as np
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import parse_yaml
from tdm_planner.parameters import shown
from tdm_planner.problems.planner_parameters import problem_parameters
from tdm_planner.problems.problem import Problem
import yaml

Spacing = Literal['linear', 'log', 'list', 'random']
Point = dict[str, Any]

_RANGE = re.compile(r'([^:]+):([^:]+):\s*(log|random)?\s*(\d+)')
_FORMS = (
    'NAME=LOW:HIGH:N, NAME=LOW:HIGH:log N, NAME=LOW:HIGH:random N or NAME=VALUE,VALUE,...; '
    'N must be in [1, 1e6], both ends of a log range must be > 0'
)
_MOST = 1_000_000  # values of one parameter
_WHOLE = 1e-9  # from an integer


@dataclass(frozen=True)
class Axis:
    """A parameter by its dotted name, the `values` it takes, and how they are spaced."""

    name: str
    values: tuple[Any, ...]
    spacing: Spacing = 'list'


def parse_axis(text: str) -> Axis:
    """
    Return what ``--over`` says: a range, linear, logarithmic or random, or a list of values.

    Raise InvalidProblem if `text` has none of these forms.
    """
    name, _, given = text.partition('=')
    found = _RANGE.fullmatch(given.strip())
    spacing: Any = 'list' if found is None else found[3] or 'linear'
    values: Any = None
    try:
        if found is not None:
            values = _spaced(name, spacing, float(found[1]), float(found[2]), int(found[4]))
        elif given.strip() and ':' not in given:
            values = parse_yaml(f'[{given}]')
    except (ValueError, yaml.YAMLError):
        pass
    if not (name and isinstance(values, list)):
        raise InvalidProblem(f"'{shown(text)}' is not allowed: must be {_FORMS}")
    return Axis(name, tuple(values), spacing)


def _spaced(name: str, spacing: str, low: float, high: float, count: int) -> list[float] | None:
    """Return the values of a range; None if there are none."""
    least = 0.0 if spacing == 'log' else -math.inf
    if not (least < low < math.inf and least < high < math.inf and 1 <= count <= _MOST):
        return None
    if spacing == 'random':  # the same whenever it is asked for, another for another parameter
        generator = np.random.default_rng([count, *name.encode()])
        values = generator.uniform(low, high, count)
    else:
        values = (np.geomspace if spacing == 'log' else np.linspace)(low, high, count)
    return list(values.tolist())


def checked(axis: Axis, problem: type[Problem], parameters: Mapping[str, Any]) -> Axis:
    """
    Return an axis whose values have the type that the problem declares for the parameter.

    Raise InvalidProblem if the problem has no such parameter, or does not allow a value of it.
    """
    spec = problem.parameter_specifications(parameters).get(axis.name)
    values = []
    for value in axis.values:
        number = spec is not None and spec.value_type is int and isinstance(value, float)
        if number and math.isfinite(value) and abs(value - round(value)) < _WHOLE:
            value = round(value)
        found = problem_parameters(problem, {**parameters, axis.name: value})
        if axis.name not in found:
            raise InvalidProblem(
                f"parameter '{shown(axis.name)}' belongs to a node: a study varies those of "
                f'{problem.name}'
            )
        values.append(found[axis.name])
    if not values:
        raise InvalidProblem(f"parameter '{shown(axis.name)}' has no values to vary over")
    return Axis(axis.name, tuple(values), axis.spacing)


def points_of(axes: Sequence[Axis]) -> list[Point]:
    """
    Return every combination of the axes' values by name, the last axis varied first.

    Random axes are drawn together: the n-th values of all of them make one combination.

    Raise InvalidProblem if a parameter is varied twice, or random axes have different numbers of
    values.
    """
    for name, count in Counter(axis.name for axis in axes).items():
        if count > 1:
            raise InvalidProblem(f"parameter '{shown(name)}' is varied twice")
    drawn = [axis for axis in axes if axis.spacing == 'random']
    if len({len(axis.values) for axis in drawn}) > 1:
        raise InvalidProblem(
            'random parameters are drawn together and must have as many values each: '
            + ', '.join(f'{axis.name} has {len(axis.values)}' for axis in drawn)
        )
    groups = [[axis] for axis in axes if axis not in drawn] + [drawn] * bool(drawn)
    names = [axis.name for group in groups for axis in group]
    choices = [zip(*(axis.values for axis in group), strict=True) for group in groups]
    points = [dict(zip(names, chain(*chosen), strict=True)) for chosen in product(*choices)]
    return [{axis.name: point[axis.name] for axis in axes} for point in points]


def cell(value: Any) -> Any:
    """Return a value as the table has it: lists as text."""
    return json.dumps(value) if isinstance(value, (list, tuple)) else value
