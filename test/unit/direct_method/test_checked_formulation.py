# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What users get wrong when they state a problem: one sentence that names the function."""

from collections.abc import Callable
from itertools import count
from typing import Any
import warnings

import numpy as np
import pytest
from stated import Cart, changed, refused
from tdm_planner.direct_method import Duration, Formulation, Integrated, Output
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.virtual_arc import chebyshev_nodes
from tdm_planner.exceptions import InvalidProblem

LOADED = changed(
    Cart,
    __doc__='A cart with a swinging load: position prescribed, angle integrated.',
    state_names=('x', 'v', 'angle'),
    state_units=('m', 'm/s', 'rad'),
    outputs=lambda s: {'x': Output((1.0, 0.0), (0.0, 0.0), free=2)},
    integrated=lambda s: {'angle': Integrated(0.3)},
    duration=lambda s: Duration(2.0),
    invert=lambda s, y, z: ((*y['x'][:2], z['angle']), y['x'][2:]),
    derivative=lambda s, x, u: (x[1], u[0], -x[2] - u[0]),
    final_cost=lambda s, t, x: x[2] ** 2,
)


def begin(formulation: Formulation) -> Transcription:
    program = Transcription(formulation, chebyshev_nodes(21))
    program.begin(program.first_guess)
    return program


def refusal(**change: Any) -> str:
    """Return the sentence that a cart changed in this way is refused with."""
    return refused(lambda: begin(changed(LOADED, **change)()))


FUNCTIONS = ('outputs', 'integrated', 'duration', 'invert', 'derivative', 'margins')
FUNCTIONS += ('running_cost', 'final_cost', 'end_conditions')


def raises(error: Exception) -> Callable[..., Any]:
    def function(self: Any, *arguments: Any) -> Any:
        raise error

    return function


def returns(value: Any) -> Callable[..., Any]:
    return lambda self, *arguments: value


@pytest.mark.parametrize('function', FUNCTIONS)
def test_errors_of_the_user_are_the_cause_and_refusals_are_passed_on(function):
    for error in (ZeroDivisionError('division by zero'), AttributeError('no force')):
        with pytest.raises(InvalidProblem, match=f'{function} of Changed raises') as caught:
            begin(changed(LOADED, **{function: raises(error)})())
        assert caught.value.__cause__ is error
        assert type(error).__name__ in str(caught.value)
    begin(LOADED())
    heavy = InvalidProblem('the cart is too heavy')
    assert refusal(**{function: raises(heavy)}) == 'the cart is too heavy'
    assert function in refusal(**{function: returns(None)})


NAN_BEHIND = lambda s, x, u: (x[1], u[0], np.where(x[0] < 0.5, np.nan, 0.0))  # noqa: E731


def nan_at_the_start(self, y, z):
    x, v, _ = y['x']
    u = np.where(np.logical_and(x == 1.0, v == 0.0), np.nan, 0.0)
    return (x, v, z['angle']), (u,)


SUMMED = '{} of Changed gives ... when it is traced, but ... there are no sums over nodes'
NAMES = [
    ('x', 'must be a tuple of names'),
    ((), 'must be a tuple of names'),
    (('x', 'v', 'x'), 'the same name twice'),
    (('x', 3, 'v'), 'must be strings'),
]
NUMBER = count()
COSTS = [
    (np.zeros(5), 'gives J ... of shape (5,), expected'),
    (np.nan, 'gives J = nan at node'),
    (1.0j, 'gives J ... which is not a real number'),
]
REFUSED = {  # function: (what it is instead or returns, words)
    'outputs': [
        ({'x': 3.0}, "gives 'x' = 3.0, expected an"),
        ({}, 'at least one output'),
        ({'x': Output()}, "output 'x': a polynomial needs at least one boundary condition"),
    ],
    'integrated': [
        ({'x': 3.0}, "gives 'x' = 3.0, expected an"),
        ({'speed': Integrated(0.0)}, "'speed' is not one of the states x, v, angle"),
    ],
    'invert': [
        (((0.0, 0.0, 0.0),), 'expected a pair'),
        (((0.0, 0.0), (0.0,)), 'as states has 2 components, expected 3'),
        (((0.0, 0.0, 0.0), (0.0, 0.0)), 'as controls has 2 components, expected 1'),
        (((0.0, None, 0.0), (0.0,)), 'component 1 = array(None, dtype=object), not a real number'),
        (((0.0, [1.0, [2.0]], 0.0), (0.0,)), 'expected a sequence of 3 components'),
        (((0.0, np.zeros(6), 0.0), (0.0,)), 'components of shapes (), (6,), (), expected'),
        (((0.0, 1.0j, 0.0), (0.0,)), 'component 1 = ... not a real number'),
        ((3.0, (0.0,)), 'expected a sequence of 3 components'),
        (nan_at_the_start, "control 'u' = nan at node 0 of 21 (s = 0, t = 0 s)"),
    ],
    'derivative': [
        ((0.0, 0.0), 'what derivative returns has 2 components, expected 3'),
        ((0.0, 0.0, np.zeros(4)), 'what derivative returns has components of shapes (), (), (4,)'),
        ((0.0, 0.0, 1.0j), 'what derivative returns has component 2 = ... not a real number'),
        (NAN_BEHIND, "derivative gives the rate of 'angle' = nan at node 11 of 21"),
    ],
    'margins': [
        ({'force': np.zeros(4)}, "margins gives 'force' of shape (4,), expected (7,)"),
        ({'force': 1.0j}, "margins gives 'force' = 1j, which is not a real number"),
        ({3: 1.0}, 'must be strings'),
        ({'force': np.nan}, "margins gives 'force' = nan at node 0 of 21"),
        ([1.0], 'expected a mapping by name'),
        (
            lambda s, t, x, u: {f'force {next(NUMBER)}': 1.0 - u[0] ** 2},
            'must always be the same',
        ),
        (lambda s, t, x, u: {'force': 9.0 - np.sum(u[0] ** 2)}, SUMMED.format('margins')),
    ],
    'running_cost': [
        (lambda s, t, x, u: 1.0 / t, 'running_cost gives J = inf at node 0 of 21'),
        *COSTS,
    ],
    'final_cost': [
        (lambda s, t, x: np.log(-t), 'gives J = nan at node 20 of 21 (s = 1, t = 2 s)'),
        (lambda s, t, x: x**2, 'final_cost gives J of shape (3, 7), expected (7,)'),
        (lambda s, t, x: np.sum(x[2] ** 2), SUMMED.format('final_cost')),
        *COSTS,
    ],
    'end_conditions': [
        ((np.zeros(5),), 'end_conditions gives number 0 of shape (5,)'),
        ((0.0, np.nan), 'end_conditions gives number 1 = nan'),
        ({'x': 0.0}, 'expected a sequence'),
        (lambda s, t, x: (np.sum(x[2]),), SUMMED.format('end_conditions')),
    ],
}


@pytest.mark.parametrize(
    ('function', 'value', 'words'),
    [(function, *case) for function, cases in REFUSED.items() for case in cases],
)
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
    """Beyond the first guess a number that is not finite makes a point infinitely bad."""
    program = begin(changed(LOADED, running_cost=lambda s, t, x, u: np.sqrt(30.0 - u[0] ** 2))())
    far = program.first_guess * np.array([0.3, 1.0, 1.0])
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        point = program.evaluate(far)
    assert point.cost == np.inf
    assert point.violation == np.inf
