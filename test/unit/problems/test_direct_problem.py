# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A problem of one's own from statement to verified plan, and what is said of wrong ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar
import warnings

import numpy as np
import pytest
from tdm_planner.direct_method import Duration, Integrated, Output, PowerProducts, SineSeries
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.exceptions import (
    DeadlineExceeded,
    Infeasible,
    InvalidProblem,
    TdmError,
    VerificationFailed,
)
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem, DirectSolverParameters, SolverParameters
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.verification import replay


@dataclass(frozen=True)
class Cart(DirectProblem, Validated):
    """Least effort over a fixed time: the optimum is the cubic, J = 12 x^2/t_f^3."""

    name: ClassVar[str] = 'cart'
    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)

    start: float = parameter(1.0, 'position', unit='m')
    time: float = parameter(2.0, 'time', unit='s', allowed=POSITIVE)
    limit: float = parameter(10.0, 'largest acceleration', unit='m/s^2')
    solver: SolverParameters = group(SolverParameters)

    def outputs(self):
        return {'x': Output((self.start, 0.0), (0.0, 0.0), free=3)}

    def duration(self):
        return Duration(self.time, fixed=True)

    def invert(self, y, z):
        return y['x'][:2], y['x'][2:]

    def derivative(self, x, u):
        return x[1], u[0]

    def margins(self, t, x, u):
        return {'force': 1.0 - (u[0] / self.limit) ** 2}

    def running_cost(self, t, x, u):
        return u[0] ** 2


@dataclass(frozen=True)
class Sprint(DirectProblem):
    """From rest to rest, 1 m, at no more than 1 m/s^2: 2 s; nothing is said of a solver."""

    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)
    way: float = parameter(1.0, 'way', unit='m')

    def outputs(self):
        return {'x': Output((0.0, 0.0), (self.way, 0.0), free=3)}

    def duration(self):
        return Duration(guess=3.0)

    invert, derivative = Cart.invert, Cart.derivative

    def control_limits(self):
        return {'u': (-1.0, 1.0)}

    def final_cost(self, t, x):
        return t


LONG = SolverParameters(deadline=60.0)
DIRECT = DirectSolverParameters(deadline=60.0, refine=False)


def solve(change: dict[str, Any], solver: SolverParameters = LONG) -> Any:
    """Solve a cart changed in this way; nothing is printed by numpy."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        return type('Changed', (Cart,), change)(solver=solver).solve()


SHAPES = PowerProducts([(1, 2), (2, 1), (2, 2)]) + SineSeries(2)
KINDS = {
    'polynomial': {},
    'Taranenko': {'outputs': lambda s: {'x': Output((s.start, 0.0), (0.0, 0.0), shapes=SHAPES)}},
    'integrated': {  # the acceleration is prescribed
        'outputs': lambda s: {'u': Output(free=3, derivatives=0, scale=1.0)},
        'integrated': lambda s: {'x': Integrated(s.start, 0.0), 'v': Integrated(0.0, 0.0)},
        'invert': lambda s, y, z: ((z['x'], z['v']), y['u']),
    },
    'abrupt': {'margins': lambda s, t, x, u: {'force': s.limit - np.abs(u[0])}},
    'a controls limit': {
        'margins': DirectProblem.margins,
        'control_limits': lambda s: {'u': (-s.limit, s.limit)},
    },
}


def test_a_statement_need_not_mention_the_solver():
    problem = Sprint.from_parameters({'way': 4.0, 'solver': {'deadline': 60.0}})
    assert problem.solver == DirectSolverParameters(deadline=60.0)
    assert problem.solve().duration == pytest.approx(4.0, rel=1e-3)
    assert next(iter(Sprint.parameter_specifications({}))) == 'way'
    heir = dataclass(frozen=True)(type('Heir', (Sprint,), {}))
    assert heir(way=2.0, solver=LONG).solver is LONG


@pytest.mark.parametrize(
    ('solver', 'interpolation', 'accuracy'),
    [(DIRECT, 'cubic', 1e-6), (LONG, 'linear', 1e-4)],
    ids=['direct method', 'refined'],
)
@pytest.mark.parametrize('change', KINDS.values(), ids=KINDS)
def test_least_effort(change, solver, interpolation, accuracy):
    solution = solve(change, solver)
    assert solution.cost == pytest.approx(12 / 2.0**3, rel=accuracy)
    assert solution.verification.ok
    assert solution.evaluations > 0
    assert solution.trajectory.interpolation == interpolation
    assert solution.trajectory.duration == pytest.approx(2.0)
    stated = CheckedFormulation(type('Changed', (Cart,), change)(start=1.5))
    assert Ends.of(stated).states[0] == pytest.approx([1.5, 0.0])
    assert 'allowed value' not in solution.summary


def test_a_limit_is_kept_between_the_nodes_and_a_plan_is_a_start():
    problem = Cart(limit=1.3, solver=LONG)
    solution = problem.solve()
    motion = solution.trajectory
    fine = motion.sample(np.linspace(0, 2, 2001)).control
    assert np.abs(fine).max() <= 1.3 * (1 + 1e-4)
    assert solution.cost > 12 / 2.0**3
    end = replay(DirectPlant(problem), motion, motion.times[-1:])[0]
    np.testing.assert_allclose(end, 0.0, atol=2e-3)
    nearby = type('One', (Cart,), {'starts': 1})(start=1.001, limit=1.3, solver=LONG)
    warm, cold = nearby.solve(warm_start=solution), nearby.solve()
    assert warm.cost == pytest.approx(cold.cost, rel=1e-3)


def test_no_plan_is_explained():
    with pytest.raises(Infeasible, match='force'):
        type('Two', (Cart,), {'starts': 2})(limit=0.9, solver=LONG).solve()
    with pytest.raises(InvalidProblem, match="the start violates the limit 'force'"):
        solve({'margins': lambda s, t, x, u: {'force': x[0] - 1.5}})
    with pytest.raises(Infeasible, match='the conditions at the end by'):
        solve({'starts': 1, 'end_conditions': lambda self, t, x: (x[0] - 1.0,)})
    with pytest.raises(DeadlineExceeded):
        Cart(limit=1.3, solver=SolverParameters(deadline=1e-6)).solve()
    with pytest.raises(InvalidProblem, match="'time' = -1"):
        Cart.from_parameters({'time': -1.0})


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'running_cost': DirectProblem.running_cost}, 'states no performance index'),
        ({'state_units': ('m',)}, '2 state_names but 1 state_units'),
        *(({'state_units': units}, 'must be a tuple of units') for units in ('ms', (1, 2))),
        *(({'control_units': units}, 'must be a tuple of units') for units in (None,)),
        *(
            ({'terminal_tolerance': given}, 'must be 2 positive numbers')
            for given in (1e-3, ((1,), (1, 2)), (1.0,) * 3, (0, 1), (np.nan, 1))
        ),
        *(
            ({what: count}, f'{what} = {count!r} is not allowed: must be an integer from')
            for what in ('nodes', 'starts')
            for count in (0, 41.5, '41', True, 10**9)
        ),
        ({'integrated': lambda self: {'v': Integrated(5.0)}}, 'but integrated gives 5'),
        (
            {'integrated': lambda self: {'v': Integrated(5.0)}},
            "invert gives the state 'v' = 0 at node 0 of 25 (s = 0)",
        ),
    ],
)
def test_mistakes_are_named(change, words):
    with pytest.raises(InvalidProblem) as caught:
        solve(change)
    assert words in str(caught.value)
    assert '\n' not in str(caught.value)


def test_warm_starts_that_are_no_plans_of_the_problem():
    for other in ('x', 3, {}, [None]):
        with pytest.raises(InvalidProblem, match=r'warm_start = .* must be a Solution'):
            Cart().solve(warm_start=other)
    with pytest.raises(InvalidProblem, match="plan of 'other_cart' and not of 'cart'"):
        Cart().solve(warm_start=solve({'name': 'other_cart'}))


def test_equations_that_contradict_each_other_are_named():
    assert solve({'terminal_tolerance': (np.inf, 1e-3), 'starts': 1}).verification.ok
    for state, wrong in (
        ('v', lambda s, x, u: (x[1], 1.1 * u[0])),
        ('x', lambda s, x, u: (-x[1], u[0])),
    ):
        with pytest.raises(InvalidProblem, match=f"derivative gives the rate of '{state}' ="):
            solve({'derivative': wrong})


def test_where_a_plan_begins_is_checked_against_the_start_that_is_asked(monkeypatch):
    """A search whose reference functions begin elsewhere, and say so in nothing."""
    moved = Cart(start=1.01, solver=LONG)
    true_motion = Transcription.motion

    def elsewhere(self, xi):
        return true_motion(Transcription(moved, self.nodes), xi)

    monkeypatch.setattr(Transcription, 'motion', elsewhere)
    with pytest.raises(VerificationFailed, match=r'x begins 0\.01 m from the start'):
        solve({'starts': 2}, DIRECT)


@pytest.mark.parametrize('place', [100.0, 3601.3])
def test_what_is_narrow_on_an_hour_s_way_is_not_overlooked(place):
    """The cart passes the pole within a second or two, between any samples of its plan."""
    change = {
        'outputs': lambda self: {'x': Output((0.0, 0.0), (7200.0, 0.0), free=3)},
        'duration': lambda self: Duration(3600.0, fixed=True),
        'starts': 2,
        'margins': lambda self, t, x, u: {'pole': abs(x[0] - place) - 0.5},
    }
    with pytest.raises(Infeasible, match='pole'):
        solve(change)


def missing_above(largest: float) -> Any:
    """Return a formula that gives no number for accelerations above `largest`."""

    def invert(self, y, z):
        x, v, u = y['x']
        return (x, v), (u + 0 * np.sqrt(largest - u),)

    return invert


QUICKEST = {
    'outputs': lambda self: {'x': Output((0.0, 0.0), (1.0, 0.0), free=2)},
    'duration': lambda self: Duration(3.0),
    'margins': lambda self, t, x, u: {'force': 1.0 - u[0], 'brake': 1.0 + u[0]},
    'final_cost': lambda self, t, x: t,
    'running_cost': DirectProblem.running_cost,
}


@pytest.mark.parametrize(
    ('sign', 'words'), [(1, 'at its shortest allowed value, 0.03 s'), (-1, 'longest')]
)
def test_a_duration_that_nothing_but_its_bounds_limits(sign, words):
    unlimited = {'margins': lambda s, t, x, u: {}, 'final_cost': lambda s, t, x: sign * t}
    assert words in solve({**QUICKEST, **unlimited}).summary
    quickest = solve(QUICKEST)
    assert 'allowed value' not in quickest.summary
    made = type('Changed', (Cart,), QUICKEST)()
    assert 2.0 < quickest.cost == pytest.approx(quickest.duration)
    assert made.cost_to_go(quickest, 0.0) == pytest.approx(quickest.cost)


def test_a_cost_that_is_no_number_on_the_way_only_bars_the_way():
    """The integrand exists only for |u| < 1.7; the least effort of 1.5 is found all the same."""
    logarithm = {'running_cost': lambda s, t, x, u: u[0] ** 2 - 1e-9 * np.log(1.7 - u[0])}
    assert solve(logarithm).cost == pytest.approx(12 / 2.0**3, rel=1e-5)
    # The cheapest at the nodes goes to where the formula ends, and beyond between them.
    solution = solve({**QUICKEST, 'invert': missing_above(0.8)})
    assert np.isfinite(solution.trajectory.controls).all()
    assert 'allowed value' not in solution.summary


def test_a_function_that_fails_on_the_way():
    calls = []

    def derivative(self, x, u):
        calls.append(1)
        return 1 / 0 if len(calls) > 4 else Cart.derivative(self, x, u)

    with pytest.raises(TdmError, match='derivative of Changed raises ZeroDivisionError'):
        solve({'derivative': derivative})


def test_a_function_without_a_value_is_named_when_no_candidate_does():
    def derivative(self, x, u):
        return x[1], u[0] + 0 * np.sqrt(0.9 - u[0])

    with pytest.raises(VerificationFailed) as caught:
        solve({**QUICKEST, 'derivative': derivative})
    assert "derivative gives the rate of 'v' = nan" in str(caught.value)
