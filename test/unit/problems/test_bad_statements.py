# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Mistakes in the statement of a problem: one sentence that names the function, and a way out."""

from dataclasses import dataclass
import math

from fuzzing import tried
import numpy as np
import pytest
from random_statements import outcome_of, STATEMENTS
from rich.console import Console
from scipy.interpolate import CubicSpline
from stated import Car, Cart, changed, forced, LONG, refused, solve
from tdm_planner import exceptions
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.drawing import Disc
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.parameters import parameter
from tdm_planner.problem_check import check_problem
from tdm_planner.problems import DirectProblem, DirectSolverParameters, SolverParameters
from tdm_planner.problems.registry import load_problem


def limits(**pairs):
    return {'control_limits': lambda self: pairs}


def margins_of(**functions):
    return {'margins': lambda s, t, x, u: {name: f(x) for name, f in functions.items()}}


JUMP = (
    {'final_cost': lambda s, t, x: t + np.where(x[0] > 0.0, 1.0, 0.0)},
    ['final_cost jumps by 1', 'np.tanh'],
)
BAD = [
    *(
        (margins_of(pole=pole), ['margins of Changed', *words])
        for pole, *words in (
            (lambda x: math.sqrt(x[0] ** 2 + x[1] ** 2) - 0.5, 'TypeError', 'np.sqrt(x)'),
            (lambda x: x[0] - 1.0 if x[0] > 0.0 else x[1], 'ValueError', 'np.where'),
            (lambda x: min(x[0] ** 2, 4.0) - 5.0, 'ValueError', 'np.minimum'),
            (lambda x: x @ np.eye(4) @ x - 0.5, 'ValueError', 'write the formula by components'),
        )
    ),
    (
        margins_of(pole=lambda x: np.vectorize(math.sqrt)(np.asarray(x[0]) ** 2 + 1.0) - 0.5),
        ['margins of Changed cannot be traced', 'math.sqrt', 'use numpy'],
    ),
    (
        margins_of(pole=lambda x: CubicSpline([-9.0, 0.0, 9.0], [9.0, 0.1, 9.0])(x[0])),
        ['margins of Changed cannot be traced', 'use np.interp or a polynomial'],
    ),
    (
        margins_of(pole=lambda x: (x[0] ** 2 + 9.0).astype(float)),
        ['margins of Changed cannot be traced', 'leave astype out'],
    ),
    (
        {'invert': lambda s, y, z: Car.invert(s, {'x': y['x'], 'y': z['y']}, z)},
        ['invert of Changed raises KeyError', "'y' is in neither outputs() nor integrated()"],
    ),
    *(
        (
            {'invert': lambda s, y, z, jet=jet: Car.invert(s, {'x': jet(y['x']), 'y': y['y']}, z)},
            ['invert of Changed raises ValueError', 'as Output(derivatives=2) says: 3 arrays'],
        )
        for jet in (lambda jet: jet[:2], lambda jet: [*jet, jet[0]])
    ),
    (margins_of(wall=lambda x: 1.5 - x[0]), ["the end violates the limit 'wall' by 0.5"]),
    (margins_of(wall=lambda x: 1.0), ["'wall'", 'remove it']),
    (
        {'first_guess': lambda s, s_: {'x': np.log(s_)}},
        ["first_guess gives 'x' = -inf at s = 0: it must be a number"],
    ),
    ({'control_names': ('ax', 'y')}, ["has the name of a state, 'y'"]),
    JUMP,
    (limits(force=(-1, 1)), ["control_limits names 'force'", 'ax, ay']),
    (limits(ax=(1.0, -1.0)), ["control_limits gives 'ax'", 'lowest']),
    ({'reserve': {'speed': 0.1}}, ["reserve names 'speed'", 'pole']),
    ({'reserve': {'ax': 1.0}}, ["reserve gives 'ax' = 1"]),
    ({'first_guess': lambda s, at: {'z': at}}, ["first_guess names 'z'", 'x, y']),
    (
        margins_of(**{'ax, lowest': lambda x: x[0] + 9.0}),
        ["margins names 'ax, lowest', as a limit of control_limits"],
    ),
    (
        {'invert': lambda s, y, z: (s.contrl_names, y)},
        ["Changed has no 'contrl_names': did you mean control_names", 'in line'],
    ),
    (
        {'outputs': lambda s: {'x': Output(start=('2.0',))}},
        ["the value of order 0 at the start = '2.0'", 'number: line', 'Output(start='],
    ),
]
FOR_OTHERS = [  # what only a tracker or a picture would meet
    (
        {'feedback_weights': lambda self: (np.eye(3), np.eye(2))},
        ['gives Q of shape (3, 3), expected (4, 4)'],
    ),
    (
        {'drawing': lambda self, x: [Disc((math.sin(x[0]), x[1]), 0.1)]},
        ['drawing of Changed raises TypeError', "use numpy's functions", 'in line'],
    ),
    (
        {'drawing': lambda self, x: Disc((x[0], x[1]), 0.1)},
        ['drawing of Changed raises TypeError: one shape is returned, expected a sequence'],
    ),
    ({'joints': lambda s: {'arm': ('x',)}}, ['joints must give every joint by name the']),
    ({'joints': lambda s: {'y': ('x', 'vx')}}, ["joints gives the name 'y' of a state that is"]),
]


def filled(self, x, u):
    rates = np.zeros(2)
    rates[0] = x[1]
    return rates


OF_A_CART = [
    ({'running_cost': DirectProblem.running_cost}, ['states no performance index']),
    ({'state_units': ('m',)}, ['2 state_names but 1 state_units']),
    ({'state_units': 'ms'}, ['must be a tuple of units']),
    ({'terminal_tolerance': (np.nan, 1)}, ['must be 2 positive numbers']),
    ({'nodes': 41.5}, ['nodes = 41.5 is not allowed: must be an integer from']),
    ({'starts': 0}, ['starts = 0 is not allowed: must be an integer from']),
    (
        {'integrated': lambda self: {'v': Integrated(5.0)}},
        ["invert gives the state 'v' = 0 at node 0 of 25 (s = 0)", 'but integrated gives 5'],
    ),
    (
        {'start_conditions': lambda s, t, x: x[0]},
        ['start_conditions returns one value, expected a sequence'],
    ),
    ({'derivative': lambda s, x, u: (-x[1], u[0])}, ["derivative gives the rate of 'x' ="]),
    (
        forced(lambda x, v: np.where(x > 0.8, -0.1, 0.0)) | {'invert': Cart.invert},
        ["derivative gives the rate of 'v' ="],
    ),
    (margins_of(force=lambda x: x[0] - 1.5), ["the start violates the limit 'force'"]),
    (
        {'outputs': lambda s: Cart.outputs(s) | {'idle': Output((0.0,), (1.0,))}},
        ["invert does not use y['idle']"],
    ),
    ({'reserve': 0.1}, ['reserve = 0.1', 'a mapping of limits to shares']),
    ({'feedback_weights': lambda s: 5}, ['feedback_weights gives 5', 'a pair (Q, R)']),
    ({'feedback_weights': lambda s: (-np.eye(2), 1.0)}, ['gives Q that is not positive']),
    ({'feedback_weights': lambda s: (np.eye(2), 0.0)}, ['gives R that is not positive definite']),
    ({'feedback_weights': lambda s: ('much', 1.0)}, ['gives Q that is no matrix']),
    ({'derivative': lambda s, t, x, u: (x[1], u[0])}, ['it is called as derivative(x, u)']),
    ({'final_cost': lambda s, x: x[0]}, ['it is called as final_cost(t, x)']),
    ({'invert': lambda s, y, z: (y['x'][:2], (y['x'][3],))}, ['Output(derivatives=2)']),
    ({'derivative': lambda s, x, u: (x['v'], u[0])}, ['in the order of the names']),
    ({'derivative': lambda s, x, u: (x.v, u[0])}, ['in the order of the names']),
    ({'derivative': filled}, ['return the components, such as (x[1], u[0])']),
    (
        {'running_cost': lambda s, t, x, u: x[1] > 1.0},
        ['running_cost gives J = True or False, expected a number'],
    ),
    (
        margins_of(log=lambda x: np.log(x[0])),
        ["margins gives 'log'", 'node 24 of 25', 'boundary values fix it there'],
    ),
]


@pytest.mark.parametrize(
    ('of', 'ask', 'change', 'words'),
    [
        *((Car, Car.solve, *case) for case in BAD),
        *((Car, check_problem, *case) for case in (JUMP, *FOR_OTHERS)),
        *((Cart, Cart.solve, *case) for case in OF_A_CART),
    ],
)
def test_a_mistake_is_one_sentence(of, ask, change, words):
    made = changed(of, **change)()
    message = refused(lambda: ask(made), 350)
    assert all(word in message for word in words), message
    if ' violates the limit ' in message or 'derivative gives' in message:  # as the check says
        assert any(words[0] in reason for reason in check_problem(made))


@pytest.mark.parametrize(
    'rates', [lambda s, x, u: (x[1], 1.01 * u[0]), lambda s, x, u: (x[1], u[0] - 0.02 * x[1])]
)
def test_a_small_slip_is_named_by_the_check(rates):
    (reason,) = check_problem(changed(Cart, derivative=rates)())
    assert reason.startswith("derivative gives the rate of 'v' = ")


@pytest.mark.parametrize('name', ['solve', 'duration', 'cost_to_go', 'name', 'solver'])
def test_a_parameter_hides_nothing_and_a_problem_has_a_name_for_topics(name):
    kind = changed(Cart, **{name: parameter(1.0, 'taken'), '__annotations__': {name: float}})
    with pytest.raises(InvalidProblem, match=f"Changed has a parameter '{name}', which hides"):
        dataclass(frozen=True)(kind)()
    with pytest.raises(InvalidProblem, match=r'Changed.name = my cart! is not allowed'):
        changed(Cart, name='my cart!')()


def test_the_check_tells_names_that_are_misspelt_or_taken_and_counts_conditions():
    of_its_own = {'path_cost': Cart.running_cost, 'helper': Cart.derivative}
    of_its_own |= {'derived': Cart.derivative, 'margin': lambda s, x: x[0] + 9.0}  # called below
    of_its_own['derivative'] = lambda s, x, u: s.derived(x, u)
    of_its_own['margins'] = lambda s, t, x, u: {'pole': (lambda: s.margin(x))()}
    made = changed(Cart, **of_its_own, end_conditions=lambda s, t, x: [x[1], t - 2.0])
    console = Console(record=True, width=300)
    assert check_problem(made(), console) == []
    told = console.export_text()
    assert 'path_cost is never used: did you mean final_cost' in told
    assert 'end_conditions: 2 beside these' in told
    assert told.count('is never used') + told.count('beside these') == 2
    assert 'not refined' not in told
    at_rest = Output((0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), free=2)
    assert check_problem(changed(Cart, outputs=lambda s: {'x': at_rest})(), console) == []
    assert "neither a state nor a control: 'x' of order 3 at the end" in console.export_text()
    for name in ('rate', 'mismatch'):
        own = {name: parameter(1.0, 'taken'), '__annotations__': {name: float}}
        (reason,) = check_problem(dataclass(frozen=True)(type('Taken', (Cart,), own))())
        told = f"parameter '{name}' of Taken is one of the nodes' own: rename it, to run "
        assert reason == told + 'tracker and simulated plant'


class Forgotten(Cart):
    track: float = parameter(1.0, 'length', unit='m')


class Plain(DirectProblem):
    """Neither a dataclass nor complete."""


Incomplete = dataclass(frozen=True)(type('Incomplete', (DirectProblem,), {'duration': None}))


def loaded(made):
    return load_problem(f'{__name__}:{made.__name__}')


@pytest.mark.parametrize('use', [lambda c: c(), lambda c: c.from_parameters({}), loaded])
@pytest.mark.parametrize(
    ('made', 'told'),
    [
        (Forgotten, 'is no dataclass: put @dataclass(frozen=True) above it'),
        (Plain, 'is no dataclass: put @dataclass(frozen=True) above it'),
        (Incomplete, 'is not complete: define derivative, invert, outputs'),
    ],
)
def test_a_class_that_cannot_be_used_is_named(made, told, use):
    assert refused(lambda: use(made)) == f'{made.__name__} {told}'


def test_a_number_that_decides_is_kept_as_a_number_and_a_table_is_traced():
    """`if` and math on a parameter do not stop the trace; another value is traced anew."""

    def margins(self, t, x, u):
        side = 1.0 if self.drag > 0.05 else -1.0
        return {'side': side * x[1] + math.sqrt(self.limit)}

    made = changed(Car, margins=margins)
    for drag, side in ((0.1, 1.0), (0.01, -1.0)):
        plan = made(drag=drag).solve()
        least = (side * plan.trajectory.states[:, 1] + math.sqrt(2.0)).min()
        assert plan.verification.ok
        assert plan.verification.worst['side'] == pytest.approx(least, abs=1e-3)
    table = margins_of(pole=lambda x: np.interp(x[0], [-2.0, 0.0, 2.0], [1.0, 0.1, 1.0]))
    assert changed(Car, **table)().solve().verification.ok


def test_a_condition_that_collocation_would_lose_is_kept():
    """A jerk given at the end is neither a state nor a control: the plan is not refined."""
    ends = {'x': Output((-2.0, 0.0), (2.0, 0.0, 0.0, 0.0), free=4, derivatives=2)}
    ends['y'] = Output((0.6, 0.0), (0.6, 0.0), free=4)
    plan = changed(Car, outputs=lambda s: ends)().solve()
    assert plan.trajectory.interpolation == 'linear'
    assert 'not refined by collocation' in plan.summary
    assert plan.trajectory.controls[-1, 0] == pytest.approx(0.0, abs=1e-6)


def test_start_conditions_and_a_free_start():
    ends = {'x': Output({1: 0.0}, (2.0, 0.0), free=5, scale=3.0)}
    ends['y'] = Output({1: 0.0}, (0.0, 0.0), free=5, scale=1.0)
    made = changed(
        Car,
        outputs=lambda s: ends,
        start_conditions=lambda s, t, x: ((x[0] + 2.0) ** 2 + x[1] ** 2 - 1.0,),
        margins=DirectProblem.margins,
    )
    x, y = made().solve().trajectory.states[0, :2]
    assert (x + 2.0) ** 2 + y**2 == pytest.approx(1.0, abs=1e-3)
    assert x == pytest.approx(-1.0, abs=0.02)


def test_random_statements_are_planned_for_or_refused():
    # A control that jumps with a force was overlooked by the replay.
    case = {'force': 'wall', 'cost': 'nothing', 'mass': 0.1, 'largest': 7.4, 'speed': 1.65}
    case |= {'goal': 1.16, 'guess': 1.16, 'free': 3, 'solver.refine': False}
    outcome_of(case | {'mistake': 'none'})
    assert any(tried(STATEMENTS, outcome_of, 40))


def test_a_start_inside_a_reserve_is_named_where_no_plan_is_found():
    words = "the start leaves 0.2 to the limit 'pole', less than its reserve 0.5"
    short = {'duration': lambda s: Duration(guess=4.0, longest=4.0)}  # it takes a minute and more
    made = changed(Car, reserve={'pole': 0.5}, **limits(ax=(-1e-3, 1e-3)), **short)
    near = made(start=-math.sqrt(0.44), solver=SolverParameters(deadline=0.3))
    assert check_problem(near) == [words]
    with pytest.raises(Infeasible, match=f'took 4 s, the longest that is allowed; {words}'):
        near.solve()


def test_rates_that_differ_by_rounding_or_at_a_kink_agree():
    stiff = changed(Cart, **forced(lambda x, v: -1e13 * x))
    speedy = changed(  # a kink at rest
        Cart,
        invert=lambda s, y, z: ((y['x'][0], np.abs(y['x'][1])), y['x'][2:]),
        outputs=lambda s: {'x': Output((1.0, 0.0), (2.0, 1.5))},
    )
    assert check_problem(stiff(limit=1e14)) == check_problem(speedy()) == []


Rolling = changed(
    Car,
    way=Integrated(0.1, 0.0),
    sideways=Output((0.0,), (0.0,), free=4),
    outputs=lambda s: {'x': Car.outputs(s)['x'], 'vy': s.sideways},
    integrated=lambda s: {'y': s.way},
    invert=lambda s, y, z: Car.invert(s, {'x': y['x'], 'y': (z['y'], *y['vy'][:2])}, z),
)


def test_nothing_to_vary_is_said_rates_of_integrated_states_are_not_compared_ends_have_units():
    console = Console(width=120)
    with console.capture() as shown:
        assert check_problem(Rolling(), console) == []
        fixed = {'x': Output((1.0, 0.0), (0.0, 0.0))}
        assert check_problem(changed(Cart, outputs=lambda s: fixed)(), console) == []
    assert 'nothing is varied: no output has' in shown.get()
    (row,) = [line.split() for line in shown.get().splitlines() if 'not compared' in line]
    assert row[1:5:2] == ['y', '-']
    assert 'at neither end: force' in shown.get()
    far = changed(
        Rolling,
        way=Integrated(1.0, 40.0, scale=10.0),
        sideways=Output((0.0,), (1.0,)),  # nothing is left to vary
        duration=lambda self: Duration(1.0, fixed=True),
    )
    with pytest.raises(Infeasible, match=r'the condition at the end on y by 3\d m'):
        far(limit=90.0, solver=DirectSolverParameters(deadline=3.0, refine=False)).solve()


def test_no_plan_is_explained():
    with pytest.raises(Infeasible, match='force'):
        changed(Cart, starts=2)(limit=0.9, solver=LONG).solve()
    with pytest.raises(Infeasible, match='the conditions at the end by'):
        solve(starts=1, end_conditions=lambda self, t, x: (t * (x[0] - 1.0),))
    moving = {'outputs': lambda self: {'x': Output({0: 1.0}, (0.0, 0.0), free=3)}}
    with pytest.raises(Infeasible, match='the conditions at the start by'):
        solve(starts=1, start_conditions=lambda self, t, x: (x[1] ** 2 + 0.4,), **moving)
    with pytest.raises(exceptions.DeadlineExceeded):
        Cart(limit=1.3, solver=SolverParameters(deadline=1e-6)).solve()


def test_warm_starts_that_are_no_plans_of_the_problem():
    for other in ('x', 3, {}, [None]):
        with pytest.raises(InvalidProblem, match=r'warm_start = .* must be a Solution'):
            Cart().solve(warm_start=other)
    with pytest.raises(InvalidProblem, match="plan of 'other_cart' and not of 'cart'"):
        Cart().solve(warm_start=solve(name='other_cart'))


@pytest.mark.parametrize('place', [100.0, 3601.3])
def test_what_is_narrow_on_an_hour_s_way_is_not_overlooked(place):
    """The cart passes the pole within a second or two, between any samples of its plan."""
    with pytest.raises(Infeasible, match='pole'):
        solve(
            outputs=lambda self: {'x': Output((0.0, 0.0), (7200.0, 0.0), free=3)},
            duration=lambda self: Duration(3600.0, fixed=True),
            starts=2,
            **margins_of(pole=lambda x: abs(x[0] - place) - 0.5),
        )


def test_a_function_that_fails_on_the_way():
    calls = []

    def derivative(self, x, u):
        calls.append(1)
        return 1 / 0 if len(calls) > 4 else Cart.derivative(self, x, u)

    told = 'derivative of Changed raises ZeroDivisionError'
    with pytest.raises(exceptions.TdmError, match=told):
        solve(derivative=derivative)


def test_a_parameter_that_is_not_finite_is_told_where_it_spoils_the_motion():
    car = Car()
    object.__setattr__(car, 'drag', math.inf)  # a dataclass need not be Validated
    assert refused(car.solve).endswith("along the initial guess, but the parameter 'drag' = inf")
