# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A problem stated wrongly is refused by `solve` with one sentence, and prints nothing."""

from dataclasses import dataclass
from typing import Any, ClassVar
import warnings

import numpy as np
import pytest
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.exceptions import Infeasible, InvalidProblem, TdmError
from tdm_planner.parameters import group, Validated
from tdm_planner.problems import DirectProblem, SolverParameters


@dataclass(frozen=True)
class Cart(DirectProblem, Validated):
    """Least effort over a fixed time."""

    name: ClassVar[str] = 'cart'
    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)
    solver: SolverParameters = group(SolverParameters)

    def outputs(self):
        return {'x': Output((1.0, 0.0), (0.0, 0.0), free=3)}

    def duration(self):
        return Duration(2.0, fixed=True)

    def invert(self, y, z):
        return y['x'][:2], y['x'][2:]

    def derivative(self, x, u):
        return x[1], u[0]

    def margins(self, t, x, u):
        return {'force': 1.0 - (u[0] / 10.0) ** 2}

    def running_cost(self, t, x, u):
        return u[0] ** 2


def solve(change: dict[str, Any]) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        return type('Changed', (Cart,), change)(solver=SolverParameters(deadline=20.0)).solve()


def fails(self, *arguments):
    return [][1]


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'invert': fails}, 'invert of Changed raises IndexError'),
        ({'derivative': fails}, 'derivative of Changed raises IndexError'),
        ({'margins': fails}, 'margins of Changed raises IndexError'),
        ({'running_cost': fails}, 'running_cost of Changed raises IndexError'),
        ({'outputs': fails}, 'outputs of Changed raises IndexError'),
        ({'duration': lambda self: 1 // 0}, 'duration of Changed raises ZeroDivisionError'),
        ({'outputs': lambda self: None}, 'outputs returns None'),
        ({'outputs': lambda self: {'x': Output(free='3')}}, "free = '3' is not allowed"),
        ({'state_names': 'xv'}, "state_names = 'xv' must be a tuple of names"),
        ({'state_names': ('x', 'x')}, 'the same name twice'),
        ({'control_names': (), 'control_units': ()}, 'control_names = () must be a tuple'),
        ({'integrated': lambda self: {'w': Integrated(0.0)}}, "'w' is not one of the states"),
        ({'running_cost': lambda self, t, x, u: np.sum(u[0] ** 2)}, 'two candidates'),
    ],
)
def test_mistakes_are_named(change, words):
    with pytest.raises(InvalidProblem) as caught:
        solve(change)
    assert words in str(caught.value)
    assert '\n' not in str(caught.value)


def test_a_cost_that_is_no_number_on_the_way_only_bars_the_way():
    """The integrand exists only for |u| < 1.7; the least effort of 1.5 is found all the same."""
    logarithm = {'running_cost': lambda s, t, x, u: u[0] ** 2 - 1e-9 * np.log(1.7 - u[0])}
    assert solve(logarithm).cost == pytest.approx(12 / 2.0**3, rel=1e-5)


def test_a_function_that_fails_on_the_way():
    calls = []

    def invert(self, y, z):
        calls.append(1)
        return 1 / 0 if len(calls) > 12 else Cart.invert(self, y, z)

    with pytest.raises(TdmError, match='invert of Changed raises ZeroDivisionError'):
        solve({'invert': invert})


def test_no_margin_left_anywhere():
    with pytest.raises(Infeasible, match='force'):
        solve({'margins': lambda s, t, x, u: {'force': -1.0 - u[0] ** 2}})
