# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A problem stated wrongly is refused by `solve` with one sentence, and prints nothing."""

from dataclasses import dataclass
import re
from typing import Any, ClassVar
import warnings

import numpy as np
import pytest
from tdm_planner.direct_method import Budget, Duration, Integrated, Output
from tdm_planner.exceptions import (
    DeadlineExceeded,
    Infeasible,
    InvalidProblem,
    TdmError,
    VerificationFailed,
)
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
        (
            {'outputs': lambda self: {'x': Output(free='3')}},  # type: ignore[arg-type]
            "free = '3' is not allowed",
        ),
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


@pytest.mark.parametrize(
    'tolerance',
    [1e-3, 'ab', (1e-3,), (1e-3, 1e-3, 1e-3), (-1e-3, 1e-3), (0, 1), (np.nan, 1), ((1,), (1, 2))],
)
def test_tolerances(tolerance):
    with pytest.raises(InvalidProblem) as caught:
        solve({'terminal_tolerance': tolerance})
    assert 'terminal_tolerance = ' in str(caught.value)
    assert 'must be 2 positive numbers' in str(caught.value)


def test_a_tolerance_may_be_infinite():
    assert solve({'terminal_tolerance': (np.inf, 1e-3)}).verification.ok


def test_a_state_whose_end_may_be_anywhere_must_move_as_written():
    def backwards(self, x, u):
        return -x[1], u[0]

    change = {'terminal_tolerance': (np.inf, 1e-3), 'derivative': backwards}
    with pytest.raises(VerificationFailed, match='x as written differs by'):
        solve(change)


@pytest.mark.parametrize('place', [100.0, 3601.3, 7000.7])
def test_what_is_narrow_on_an_hour_s_way_is_not_overlooked(place):
    """The cart passes the pole within a second or two, between any samples of its plan."""
    change = {
        'outputs': lambda self: {'x': Output((0.0, 0.0), (7200.0, 0.0), free=3)},
        'duration': lambda self: Duration(3600.0, fixed=True),
        'margins': lambda self, t, x, u: {'pole': abs(x[0] - place) - 0.5},
    }
    with pytest.raises(Infeasible, match='pole'):
        solve(change)


@pytest.mark.parametrize('what', ['nodes', 'starts'])
@pytest.mark.parametrize('value', [0, -1, 41.5, '41', None, True, 10**9])
def test_numbers_of_nodes_and_starts(what, value):
    with pytest.raises(InvalidProblem, match=f'{what} = .* must be an integer from'):
        solve({what: value})


@pytest.mark.parametrize('units', ['ms', 'm', None, (1, 2)])
def test_units(units):
    with pytest.raises(InvalidProblem, match=r'state_units = .* must be a tuple of units'):
        solve({'state_units': units})
    with pytest.raises(InvalidProblem, match=r'control_units = .* must be a tuple of units'):
        solve({'control_units': units})


@pytest.mark.parametrize('other', ['x', 3, {}, [None]])
def test_a_warm_start_that_is_no_plan(other):
    with pytest.raises(InvalidProblem, match=r'warm_start = .* must be a Solution'):
        Cart().solve(warm_start=other)


def test_a_warm_start_from_another_kind_of_problem():
    plan = solve({'name': 'other_cart'})
    with pytest.raises(InvalidProblem, match="plan of 'other_cart' and not of 'cart'"):
        Cart().solve(warm_start=plan)


@pytest.mark.parametrize(
    ('sign', 'words'), [(1, 'at its shortest allowed value, 0.03 s'), (-1, 'longest')]
)
def test_a_duration_that_nothing_but_its_bounds_limits(sign, words):
    unlimited = {'margins': lambda s, t, x, u: {}, 'final_cost': lambda s, t, x: sign * t}
    assert words in solve({**QUICKEST, **unlimited}).summary


def test_a_duration_within_its_bounds_is_not_remarked_on():
    assert 'allowed value' not in solve(QUICKEST).summary
    assert 'allowed value' not in solve({}).summary


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


def test_where_a_function_has_no_value_another_candidate_may_do():
    """The cheapest at the nodes goes to where the formula ends, and beyond between them."""
    solution = solve({**QUICKEST, 'invert': missing_above(0.8)})
    assert np.isfinite(solution.trajectory.controls).all()


def test_a_function_without_a_value_is_named_when_no_candidate_does():
    def derivative(self, x, u):
        return x[1], u[0] + 0 * np.sqrt(0.9 - u[0])

    with pytest.raises(VerificationFailed) as caught:
        solve({**QUICKEST, 'derivative': derivative})
    assert re.search(
        r"derivative gives the rate of 'v' = nan at node \d+ of \d+ \(s = [.\d]+, t = [.\d]+ s\)",
        str(caught.value),
    )


def test_a_rate_without_a_value_in_the_replay_rejects_the_candidate():
    calls = []

    def derivative(self, x, u):
        calls.append(np.ndim(x[0]))
        lost = np.nan if calls[-1] == 0 and np.real(x[0]) < 0.5 else 0.0
        return x[1], u[0] + lost

    with pytest.raises(VerificationFailed) as caught:
        solve({'derivative': derivative})
    assert re.search(r"rate of 'v' = nan in state .* at t = [.\d]+ s", str(caught.value))
    assert 0 in calls


def test_a_candidate_whose_refinement_was_cut_short_says_so():
    problem = type('Changed', (Cart,), {'derivative': lambda s, x, u: (x[1], 1.1 * u[0])})(
        solver=SolverParameters(deadline=20.0)
    )
    budget = Budget(20.0)
    search = problem.search(budget, np.random.default_rng(0), None)
    candidate = next(iter(search.candidates()))
    search.rejected = 'x ends far from the goal'
    plans = search.plans(candidate)
    assert not next(plans).verification.ok
    budget.seconds = 0.0
    search._program.integrated['x'] = Integrated(1.0)  # so that more nodes might help
    assert next(plans, None) is None
    assert search.rejected.endswith('it was not refined further: the time was up')
    assert isinstance(search.failure(), DeadlineExceeded)


def starting_at(speed: float, **more: Any) -> dict[str, Any]:
    return {'integrated': lambda self: {'v': Integrated(speed)}, **more}


def test_an_integrated_state_that_is_inverted_as_well_is_a_contradiction():
    with pytest.raises(InvalidProblem) as caught:
        solve(starting_at(5.0))
    assert "invert gives the state 'v' = 0 at node 0 of 41 (s = 0)" in str(caught.value)
    assert 'but integrated gives 5' in str(caught.value)


def test_an_integrated_state_that_invert_passes_on_is_none():
    """The speed is integrated from the acceleration that the position prescribes: the same."""
    passed_on = starting_at(0.0, invert=lambda s, y, z: ((y['x'][0], z['v']), y['x'][2:]))
    assert solve(passed_on).cost == pytest.approx(12 / 2.0**3, rel=1e-4)
