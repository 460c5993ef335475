# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from tdm_planner.direct_method import Duration, Integrated, Output, power_products, SineSeries
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, InvalidProblem, VerificationFailed
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem, SolverParameters
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


SHAPES = power_products([(1, 2), (2, 1), (2, 2)]) + SineSeries(2)
LONG = SolverParameters(deadline=20.0)


@dataclass(frozen=True)
class TaranenkoCart(Cart):
    """The same in Taranenko's functions, among which the cubic is."""

    def outputs(self):
        return {'x': Output((self.start, 0.0), (0.0, 0.0), shapes=SHAPES)}


@dataclass(frozen=True)
class IntegratedCart(Cart):
    """The same with the acceleration prescribed and the position integrated."""

    def outputs(self):
        return {'u': Output(free=3, derivatives=0, scale=1.0)}

    def integrated(self):
        return {'x': Integrated(self.start, 0.0), 'v': Integrated(0.0, 0.0)}

    def invert(self, y, z):
        return (z['x'], z['v']), y['u']


@dataclass(frozen=True)
class AbruptCart(Cart):
    """The same with functions that a complex step cannot pass."""

    def margins(self, t, x, u):
        return {'force': self.limit - np.abs(u[0])}


@pytest.mark.parametrize(
    ('kind', 'accuracy'),
    [(Cart, 1e-7), (IntegratedCart, 1e-6), (AbruptCart, 1e-6), (TaranenkoCart, 1e-6)],
)
def test_least_effort(kind, accuracy):
    solution = kind(solver=LONG).solve()
    assert solution.cost == pytest.approx(12 / 2.0**3, rel=accuracy)
    assert solution.verification.ok
    assert solution.evaluations > 0
    assert solution.trajectory.interpolation == 'cubic'
    assert solution.trajectory.duration == pytest.approx(2.0)


def test_a_limit_is_kept_between_the_nodes():
    problem = Cart(limit=1.3, solver=LONG)
    solution = problem.solve()
    t = np.linspace(0, 2, 2001)
    assert np.abs(solution.trajectory.sample(t).control).max() <= 1.3 * (1 + 1e-4)
    assert solution.cost > 12 / 2.0**3
    plant_end = replay_end(problem, solution)
    np.testing.assert_allclose(plant_end, 0.0, atol=2e-3)


def replay_end(problem, solution):
    from tdm_planner.problems.direct_problem import DirectPlant

    motion = solution.trajectory
    return replay(DirectPlant(problem), motion, motion.times[-1:])[0]


def test_what_cannot_be_is_refused_with_the_limit_named():
    with pytest.raises(Infeasible, match='force'):
        Cart(limit=0.9, solver=LONG).solve()


def test_no_time():
    with pytest.raises(DeadlineExceeded):
        Cart(limit=1.3, solver=SolverParameters(deadline=1e-6)).solve()


def test_the_same_seed_gives_the_same_plan():
    first, second = (Cart(limit=1.3, solver=LONG).solve(seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.trajectory.states, second.trajectory.states)


def test_a_warm_start_is_quicker():
    before = Cart(limit=1.3, solver=LONG).solve()
    nearby = replace(Cart(limit=1.3, solver=LONG), start=1.001)
    nearby_cold = type('One', (Cart,), {'starts': 1})(start=1.001, limit=1.3, solver=LONG).solve()
    one_start = type('One', (Cart,), {'starts': 1})
    warm = one_start(start=1.001, limit=1.3, solver=LONG).solve(warm_start=before)
    assert warm.cost == pytest.approx(nearby_cold.cost, rel=1e-3)
    assert nearby.solve(warm_start=before).verification.ok


def test_wrong_dynamics_are_caught_by_the_replay():
    wrong = type('Wrong', (Cart,), {'derivative': lambda self, x, u: (x[1], 1.1 * u[0])})
    with pytest.raises(VerificationFailed, match='the goal'):
        wrong(solver=LONG).solve()


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        (
            {'running_cost': DirectProblem.running_cost},
            'states no performance index',
        ),
        ({'state_units': ('m',)}, '2 state_names but 1 state_units'),
        (
            {'derivative': lambda self, x, u: (x[1], np.log(-1.0 - x[0] ** 2))},
            "derivative gives the rate of 'v' = nan at node 0 of",
        ),
        (
            {'derivative': lambda self, x, u: (x[1], u[0], 0.0)},
            'derivative returns has 3 components, expected 2',
        ),
    ],
)
def test_mistakes_are_named(change, words):
    with pytest.raises(InvalidProblem, match=words):
        type('Wrong', (Cart,), change)(solver=LONG).solve()


def test_bad_parameters_are_refused_as_ever():
    with pytest.raises(InvalidProblem, match="'time' = -1"):
        Cart.from_parameters({'time': -1.0})


def test_where_a_plan_begins_is_checked_against_the_start_that_is_asked(monkeypatch):
    """A search whose reference functions begin elsewhere, and say so in nothing."""
    from tdm_planner.direct_method.transcription import Transcription

    asked = Cart(start=1.0, solver=LONG)
    check = asked.solve().verification
    assert check.ok
    moved = Cart(start=1.01, solver=LONG)
    true_motion = Transcription.motion

    def elsewhere(self, xi):
        return true_motion(Transcription(moved, self.nodes), xi)

    monkeypatch.setattr(Transcription, 'motion', elsewhere)
    with pytest.raises(VerificationFailed, match=r'x begins 0\.01 m from the start'):
        asked.solve()


@pytest.mark.parametrize('kind', [Cart, IntegratedCart, TaranenkoCart])
def test_the_stated_start(kind):
    from tdm_planner.direct_method.checked_formulation import CheckedFormulation

    assert CheckedFormulation(kind(start=1.5)).start() == pytest.approx([1.5, 0.0])


def test_a_free_start_is_not_a_number():
    from tdm_planner.direct_method.checked_formulation import CheckedFormulation

    free = type('Free', (Cart,), {'outputs': lambda self: {'x': Output({0: 1.0}, (0.0, 0.0))}})
    np.testing.assert_array_equal(CheckedFormulation(free()).start(), [1.0, np.nan])
