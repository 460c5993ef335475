# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Statements: bases, graphs without kinks; each mistake is a sentence that names it."""

from collections.abc import Callable
from decimal import Decimal
from functools import partial
from itertools import count
from unittest.mock import Mock
import warnings

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from stated import Cart, changed, refused
from tdm_planner.direct_method import Duration, Integrated, Output, PowerProducts, SineSeries
from tdm_planner.direct_method.arc_basis import output_basis
from tdm_planner.direct_method.bases import chebyshev_nodes, PolynomialBasis
from tdm_planner.direct_method.formulation import symmetric_powers
from tdm_planner.direct_method.graphs import Rounded, Unfolded
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.exceptions import InvalidProblem

SETS = st.sets(st.integers(0, 4), min_size=1)


@given(SETS, SETS, st.floats(0, 1))
@settings(max_examples=60)
def test_every_polynomial_meets_one_condition_and_its_derivatives_are_derivatives(first, last, s):
    try:
        basis = PolynomialBasis.of(tuple(first), tuple(last))
    except InvalidProblem as error:
        assert 'do not determine' in str(error)
        return
    for at, orders, offset in ((0.0, basis.start, 0), (1.0, basis.end, len(first))):
        for index, order in enumerate(orders):
            unit = np.eye(len(first) + len(last))[offset + index]
            np.testing.assert_allclose(basis.values(at, order), unit, atol=1e-10)
    step = 1e-5
    for order in range(1, 4):
        slope = (basis.values(s + step, order - 1) - basis.values(s - step, order - 1)) / 2 / step
        scale = 1 + np.abs(basis.values(np.linspace(0, 1, 9), order + 2)).max()
        np.testing.assert_allclose(basis.values(s, order), slope, atol=1e-5 * scale)


SINES = SineSeries(6)
PRODUCTS = PowerProducts([(1, 1), (2, 1), (2, 2), (3, 2), (3, 3)])
MIXED = SineSeries(3) + PowerProducts([(2, 1), (1, 2), (2, 3), (3, 2)])
ORDERS = st.integers(0, 4)


@given(ORDERS, ORDERS, st.integers(0, 12), st.sampled_from([None, SINES, PRODUCTS, MIXED]))
@settings(max_examples=80)
def test_conditions_hold_and_free_shapes_are_orthonormal(at_start, at_end, free, shapes):
    if shapes is not None:
        highest = 2 if shapes is SINES else 3
        at_start, at_end = min(at_start, highest), min(at_end, highest)
        free = 2 + shapes.size - (at_start + at_end)
    if at_start + at_end + free == 0:
        return
    output = Output((1.0,) * at_start, (1.0,) * at_end, 0 if shapes else free, shapes)
    basis = output_basis('x', output, 0)
    assert basis.size == free
    for s, orders, offset in ((0.0, basis.start, 0), (1.0, basis.end, at_start)):
        for index, order in enumerate(orders):
            unit = np.eye(at_start + at_end)[offset + index]
            np.testing.assert_allclose(basis.given(s, order), unit, atol=1e-8)
            np.testing.assert_allclose(basis.varied(s, order), 0.0, atol=1e-7)
    points, weights = np.polynomial.legendre.leggauss(60)
    s = (points + 1) / 2
    gram = sum(basis.varied(s, k).T @ (weights[:, None] / 2 * basis.varied(s, k)) for k in (0, 2))
    np.testing.assert_allclose(gram, np.eye(free), atol=1e-7)


@pytest.mark.parametrize('shapes', [SINES, PRODUCTS, MIXED])
def test_shapes_are_what_they_say_and_their_derivatives_are_derivatives(shapes):
    s, step = np.linspace(0.02, 0.98, 25), 1e-5
    for order in range(1, 5):
        ahead, behind = (shapes.values(s + h, order - 1) for h in (step, -step))
        scale = 1 + np.abs(shapes.values(s, order + 2)).max()
        slope = (ahead - behind) / 2 / step
        np.testing.assert_allclose(shapes.values(s, order), slope, atol=1e-9 * scale + 1e-5)
    np.testing.assert_allclose(SINES.values(s)[:, 2], np.sin(3 * np.pi * s), atol=1e-12)
    np.testing.assert_allclose(PRODUCTS.values(s)[:, 3], s**3 * (s - 1) ** 2, atol=1e-12)


NOT_NUMBERS = [None, 'fast', np.nan, 10**400, 1.0 + 2.0j, [1.0, [2.0, 3.0]], object()]
NOT_WHOLE = [*NOT_NUMBERS, 1.5, -1, 10**6, True]
WHOLE = [
    (SineSeries, 'must be an integer from 1 to 100'),
    (lambda v: PowerProducts([(1, v)]), 'must be an integer from 1 to 100'),
    (lambda v: Output(free=v), 'free = '),
    (lambda v: Output(derivatives=v), 'derivatives = '),
    (lambda v: Duration(speed_factor_order=v), 'speed_factor_order = '),
]
NUMBERS = [(Integrated, 'the start of an integrated state'), (Duration, 'guess')]
NUMBERS_OR_NONE = [
    (lambda v: Output(start=(0.0, v)), 'the value of order 1 at the start'),
    (lambda v: Output(scale=v), 'scale'),
    (lambda v: Duration(shortest=v), 'shortest'),
    (lambda v: Duration(longest=v), 'longest'),
    (lambda v: Integrated(0.0, v), 'the end of an integrated state'),
]


@pytest.mark.parametrize('value', NOT_WHOLE)
def test_whole_numbers(value):
    for make, words in WHOLE:
        assert words in refused(lambda make=make: make(value), 250)


@pytest.mark.parametrize('value', NOT_NUMBERS)
def test_numbers(value):
    for make, words in [*NUMBERS, *(NUMBERS_OR_NONE if value is not None else [])]:
        assert words in refused(lambda make=make: make(value), 250)
    if value is not None:
        refused(lambda: Output(end=value), 250)
    # those of any kind are
    assert Output(start=(np.float32(1), 2, Decimal(3))).conditions('start') == {0: 1, 1: 2, 2: 3}


def shaped(shapes, start=(0.0,), end=(0.0,)):
    return lambda: output_basis('x', Output(start, end, shapes=shapes), 0)


CASES = [
    (lambda: PolynomialBasis.of((1,), (1,)), 'do not determine'),
    (lambda: PolynomialBasis.of((), ()), 'at least one'),
    (shaped(SineSeries(1), (0.0, 1.0), (0.0, 1.0)), '3 functions cannot meet'),
    (shaped(SineSeries(2) + symmetric_powers(2) + PowerProducts([(2, 2)])), 'sums of others'),
    (lambda: PowerProducts([(0, 1)]), 'exponent of (0, 1) = 0 is not allowed'),
    (lambda: Output(shapes='start'), 'family of shapes'),  # type: ignore[arg-type]
    (lambda: Output(start={0: 0.0, -1: 1.0}), 'order of a derivative given'),
    (lambda: Output(free=10**5000), 'free = an integer of 16610 bits is not allowed'),
    (lambda: Output(scale=0.0), 'must be a positive number'),
    (lambda: Output(free=2, shapes=SineSeries(2)), 'free = 2 is for polynomials'),
    *((partial(Duration, **{name: 0.0}), name) for name in ('guess', 'shortest', 'longest')),
    (lambda: Duration(1.0, shortest=2.0), 'shortest'),
    (lambda: Duration(fixed=True, speed_factor_order=2), 'fixed'),
    (lambda: output_basis('x', Output((0.0, None, 1.0), (0.0,)), 2), 'all lower ones'),
]


@pytest.mark.parametrize(('make', 'words'), CASES)
def test_what_makes_no_sense_together(make, words):
    assert words in refused(make, 250)


LOADED = changed(
    Cart,
    states={'x': 'm', 'v': 'm/s', 'angle': 'rad'},
    outputs=lambda s: {'x': Output((1.0, 0.0), (0.0, 0.0), free=2)},
    integrated=lambda s: {'angle': Integrated(0.3)},
    duration=lambda s: Duration(2.0),
    invert=lambda s, y, z: ((*y['x'][:2], z['angle']), y['x'][2:]),
    derivative=lambda s, x, u: (x[1], u[0], -x[2] - u[0]),
    final_cost=lambda s, t, x: x[2] ** 2,
)
FUNCTIONS = ('outputs', 'integrated', 'duration', 'invert', 'derivative', 'margins')
FUNCTIONS += ('running_cost', 'final_cost', 'end_conditions')


def begin(formulation) -> Transcription:
    program = Transcription(formulation, chebyshev_nodes(21))
    program.begin(program.first_guess)
    return program


def refusal(**change) -> str:
    return refused(lambda: begin(changed(LOADED, **change)()))


def returns(value) -> Callable:
    return lambda self, *arguments: value


@pytest.mark.parametrize('function', FUNCTIONS)
def test_errors_of_the_user_are_the_cause_and_refusals_are_passed_on(function):
    for error in (ZeroDivisionError('division by zero'), AttributeError('no force')):
        with pytest.raises(InvalidProblem, match=f'{function} of Changed raises') as caught:
            begin(changed(LOADED, **{function: Mock(side_effect=error)})())
        assert caught.value.__cause__ is error
        assert type(error).__name__ in str(caught.value)
    begin(LOADED())
    heavy = Mock(side_effect=InvalidProblem('the cart is too heavy'))
    assert refusal(**{function: heavy}) == 'the cart is too heavy'
    assert function in refusal(**{function: returns(None)})


NAN_BEHIND = lambda s, x, u: (x[1], u[0], np.where(x[0] < 0.499, np.nan, 0.0))  # noqa: E731


def nan_at_the_start(self, y, z):
    x, v, _ = y['x']
    u = np.where(np.logical_and(x == 1.0, v == 0.0), np.nan, 0.0)
    return (x, v, z['angle']), (u,)


NAMES = [
    (('x', 'v', 'x'), 'the same name twice'),
    (('x', 3, 'v'), 'must be a tuple of names'),
]
NUMBER = count()
REFUSALS = {  # function: (what it is instead or returns, words)
    'outputs': [
        ({'x': 3.0}, "gives 'x' = 3.0, expected an"),
        ({}, 'at least one output'),
        ({3: Output()}, 'outputs has the name 3, which must be a string'),
        ({'x': Output()}, "output 'x': a polynomial needs at least one boundary condition"),
    ],
    'integrated': [
        ({'speed': Integrated(0.0)}, "'speed', which is not one of the states x, v, angle"),
    ],
    'invert': [
        (((0.0, 0.0, 0.0),), 'expected a pair'),
        (((0.0, 0.0), (0.0,)), 'states, the first ... has 2 components, expected 3: x, v, angle'),
        (
            lambda s, y, z: ((0.0,) * 3, y['x'][0]),
            'controls, the second ... has one array over the nodes',
        ),
        (((0.0, np.zeros(6), 0.0), (0.0,)), "states, the first ... 'v' of shape (6,), expected"),
        (((0.0, 1.0j, 0.0), (0.0,)), "'v' = 1j, which is not a real number"),
        ((3.0, (0.0,)), 'expected a sequence of 3 components'),
        (nan_at_the_start, "control 'u' = nan at node 0 of 21 (s = 0, t = 0 s)"),
    ],
    'derivative': [
        ((0.0, 0.0), 'what derivative returns has 2 components, expected 3'),
        (NAN_BEHIND, "derivative gives the rate of 'angle' = nan at node 11 of 21"),
    ],
    'margins': [
        (
            lambda s, t, x, u: {'force': x[1] < 2.0},
            "margins gives 'force' = True or False, expected a number",
        ),
        ({'force': np.nan}, "margins gives 'force' = nan at node 0 of 21"),
        ([1.0], 'expected a mapping by name'),
        (lambda s, t, x, u: {f'force {next(NUMBER)}': 1.0 - u[0] ** 2}, 'must always be the same'),
        (
            lambda s, t, x, u: {'force': 9.0 - np.sum(u[0] ** 2)},
            'margins of Changed gives ... when it is traced, but ... no sums over nodes',
        ),
    ],
    'running_cost': [(lambda s, t, x, u: 1.0 / t, 'running_cost gives J = inf at node 0 of 21')],
    'final_cost': [
        (lambda s, t, x: np.log(-t), 'gives J = nan at node 20 of 21 (s = 1, t = 2 s)'),
        (lambda s, t, x: x**2, 'final_cost gives J of shape (3, 7), expected (7,)'),
    ],
    'end_conditions': [
        ((0.0, np.nan), 'end_conditions gives number 1 = nan'),
        ({'x': 0.0}, 'expected a sequence'),
    ],
}
EVERY = [(function, *case) for function, cases in REFUSALS.items() for case in cases]


@pytest.mark.parametrize(('function', 'value', 'words'), EVERY)
def test_what_functions_return(function, value, words):
    change = {function: value if callable(value) else returns(value)}
    if function == 'invert' and not callable(value):
        change['integrated'] = returns({})
    message = refusal(**change)
    assert all(part in message for part in words.split(' ... '))


@pytest.mark.parametrize('kind', ['state', 'control'])
@pytest.mark.parametrize(('names', 'words'), NAMES)
def test_names(kind, names, words):
    message = refusal(**{f'{kind}_names': names})
    assert f'{kind}_names = ' in message
    assert words in message


def test_what_is_not_finite_on_the_way_is_only_not_taken():
    """Beyond the initial guess a number that is not finite makes a point infinitely bad."""
    program = begin(changed(LOADED, running_cost=lambda s, t, x, u: np.sqrt(30.0 - u[0] ** 2))())
    far = program.first_guess * np.array([0.3, 1.0, 1.0])
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        point = program.evaluate(far)
    assert (point.cost, point.violation) == (np.inf, np.inf)


LARGEST = np.array([2.0])  # p: a limit


@pytest.mark.parametrize(
    ('limit', 'rows'),
    [
        (lambda t, x, u, p: p - np.abs(u[0]), 2),
        (lambda t, x, u, p: 1.0 - np.abs(u[0] * x[1]) / p, 2),
        (lambda t, x, u, p: np.minimum(x[0] - t, np.minimum(x[1], u[0])), 3),
        (lambda t, x, u, p: p - np.maximum(np.abs(x[0]), np.abs(u[1])), 4),
        (lambda t, x, u, p: p - np.abs(x[0]) - np.abs(x[1]), 4),
        # The greater branch would do, and a slope that depends on the motion: the kink stays.
        (lambda t, x, u, p: np.abs(x[0]) - p, 1),
        (lambda t, x, u, p: np.maximum(x[0], x[1]) - p, 1),
        (lambda t, x, u, p: p - x[0] * np.abs(u[0]), 1),
        (lambda t, x, u, p: p - np.abs(np.abs(x[0]) - 1.0), 3),
        (lambda t, x, u, p: p - x[0] ** 2, 1),
    ],
)
def test_the_least_row_is_the_limit(limit, rows) -> None:
    t, x, u, p = (ca.SX.sym(name, size) for name, size in (('t', 1), ('x', 2), ('u', 2), ('p', 1)))
    both = ca.vertcat(1.0 + x[1], limit(t, ca.vertsplit(x), ca.vertsplit(u), p))
    margins = ca.Function('margins', [t, x, u, p], [both])
    found = Unfolded(margins, LARGEST)
    assert found.limit.tolist() == [0] + [1] * rows
    rng = np.random.default_rng(3)
    for _ in range(50):
        at = rng.normal(), rng.normal(size=2), 2.0 * rng.normal(size=2), LARGEST
        least, wanted = (np.array(function(*at)).ravel() for function in (found.rows, margins))
        assert [least[found.limit == k].min() for k in (0, 1)] == pytest.approx(wanted)


def test_many_kinks_do_not_multiply_without_end() -> None:
    x = ca.SX.sym('x', 20)
    one = [ca.SX.sym('t'), x, ca.SX.sym('u'), ca.SX.sym('p')]
    margins = ca.Function('margins', one, [1.0 - ca.sum1(ca.fabs(x))])
    found = Unfolded(margins, LARGEST)
    assert found.limit.size <= 64
    at = 0.0, np.linspace(-0.1, 0.1, 20), 0.0, LARGEST
    assert float(np.min(found.rows(*at))) == pytest.approx(float(margins(*at)))


def test_numbers_that_turn_a_fold_round_unfold_anew() -> None:
    t, x, u, p = (ca.SX.sym(name) for name in 'txup')
    margins = ca.Function('margins', [t, x, u, p], [x + p * (1.0 - ca.fabs(u))])
    found = Unfolded(margins, np.array([2.0]))
    assert found.limit.tolist() == [0, 0]
    assert found.takes_same_branches(np.array([0.1]))
    assert not found.takes_same_branches(np.array([-2.0]))
    assert Unfolded(margins, np.array([-2.0])).limit.tolist() == [0]


def test_kinks_within_kinks_are_rounded_and_measured() -> None:
    x, p = ca.SX.sym('x', 2), ca.SX.sym('p')
    stated = ca.sqrt(ca.fmax(x[0] - p, ca.fabs(x[1])))
    rounded = Rounded(ca.Function('stated', [x, p], [stated]))
    assert rounded.count == 3
    at = [3.0, -0.5], 2.0
    sizes = np.array(rounded.sizes(*at)).ravel()
    # |x1|, the difference, the root
    assert sorted(np.abs(sizes)) == pytest.approx([0.5, 0.5, 1.0])
    exact, near = (float(rounded.value(*at, e)) for e in (np.zeros(3), np.full(3, 1e-3)))
    assert exact == pytest.approx(1.0)
    assert near == pytest.approx(exact, abs=1e-4)
    slopes = ca.Function('slopes', [x, p], [ca.jacobian(rounded.value(x, p, np.full(3, 1e-3)), x)])
    assert np.isfinite(np.array(slopes([2.0, 0.0], 2.0))).all()
