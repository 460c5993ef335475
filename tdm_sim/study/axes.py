# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a study varies: parameters and their values, and all combinations of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product
import math
import re
from typing import Any, Literal

import numpy as np
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import parse_yaml
from tdm_planner.parameters import shown
from tdm_planner.problems.problem import Problem, problem_parameters
import yaml

Spacing = Literal['linear', 'log', 'list', 'random']
Point = dict[str, Any]

_RANGE = re.compile(r'([^:]+):([^:]+):\s*(log|random)?\s*(\d+)')
_FORMS = (
    'NAME=LOW:HIGH:N, NAME=LOW:HIGH:log N, NAME=LOW:HIGH:random N or NAME=VALUE,VALUE,...; '
    'N must be in [1, 1e6]'
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
    name, equals, given = text.partition('=')
    if not (name and equals and given.strip()):
        raise _unusable(text)
    found = _RANGE.fullmatch(given.strip())
    if found is None:
        try:
            values = parse_yaml(f'[{given}]')
        except yaml.YAMLError:
            raise _unusable(text) from None
        if ':' in given or not isinstance(values, list):
            raise _unusable(text)
        return Axis(name, tuple(values))
    try:
        low, high, count = float(found[1]), float(found[2]), int(found[4])
    except ValueError:
        raise _unusable(text) from None
    spacing: Any = found[3] or 'linear'
    if not (math.isfinite(low) and math.isfinite(high) and 1 <= count <= _MOST):
        raise _unusable(text)
    if spacing == 'log' and not (low > 0.0 and high > 0.0):
        raise InvalidProblem(
            f"'{shown(text)}' is not allowed: both ends of a log range must be > 0"
        )
    if spacing == 'random':  # the same whenever it is asked for, another for another parameter
        generator = np.random.default_rng([count, *name.encode()])
        values = generator.uniform(low, high, count)
    else:
        values = (np.geomspace if spacing == 'log' else np.linspace)(low, high, count)
    return Axis(name, tuple(values.tolist()), spacing)


def _unusable(text: str) -> InvalidProblem:
    return InvalidProblem(f"'{shown(text)}' is not allowed: must be {_FORMS}")


def checked(axis: Axis, problem: type[Problem], parameters: Mapping[str, Any]) -> Axis:
    """
    Return an axis whose values have the type that the problem declares for the parameter.

    Raise InvalidProblem if the problem has no such parameter, or does not allow a value of it.
    """
    spec = problem.parameter_specifications(parameters).get(axis.name)
    values = []
    for value in axis.values:
        if spec is not None and spec.kind is int and isinstance(value, float):
            whole = math.isfinite(value) and abs(value - round(value)) < _WHOLE
            value = round(value) if whole else value
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
    names = [axis.name for axis in axes]
    for name in names:
        if names.count(name) > 1:
            raise InvalidProblem(f"parameter '{shown(name)}' is varied twice")
    random = [axis for axis in axes if axis.spacing == 'random']
    if len({len(axis.values) for axis in random}) > 1:
        raise InvalidProblem(
            'random parameters are drawn together and must have as many values each: '
            + ', '.join(f'{axis.name} has {len(axis.values)}' for axis in random)
        )
    groups = [[axis] for axis in axes if axis.spacing != 'random'] + ([random] if random else [])
    order = [axis.name for group in groups for axis in group]
    values = [zip(*(axis.values for axis in group), strict=True) for group in groups]
    points = [dict(zip(order, chain(*cell), strict=True)) for cell in product(*values)]
    return [{name: point[name] for name in names} for point in points]
