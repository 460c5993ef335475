# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Bad input to reference functions, speed factors and conversions: one sentence each."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from typing import Any
import warnings

import numpy as np
import pytest
from tdm_planner.direct_method import (
    arc_derivatives,
    CombinedShapes,
    Duration,
    Integrated,
    Output,
    PolynomialReference,
    power_products,
    PowerProducts,
    SineSeries,
    symmetric_powers,
    TaranenkoReference,
    time_derivatives,
)
from tdm_planner.direct_method.output_basis import output_basis
from tdm_planner.exceptions import InvalidProblem

BAD: dict[str, Any] = {
    'None': None,
    'a string': 'fast',
    'a numeral': '1.0',
    'NaN': float('nan'),
    'inf': float('inf'),
    'too huge for a float': 10**400,
    'complex': 1.0 + 2.0j,
    'ragged': [1.0, [2.0, 3.0]],
    'a mapping': {0: 1.0},
    'an object': object(),
}
BAD_SCALARS = {**BAD, 'huge': 1e300, 'empty': []}
NOT_WHOLE = {**BAD_SCALARS, 'a fraction': 1.5, 'negative': -1, 'a million': 10**6, 'true': True}


def refused(make: Callable[[], Any]) -> str:
    """Return the one clear sentence; nothing is printed by numpy on the way."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(InvalidProblem) as caught:
            make()
    message = str(caught.value)
    assert '\n' not in message
    assert len(message) < 250
    return message


def polynomial(start=(0.0, 1.0), end=(2.0, 0.0), **arc):
    conditions = dict(enumerate(start)), dict(enumerate(end))
    return PolynomialReference(*conditions, **{'tau_f': 2.0, **arc})


def series(start=(0.0, 1.0), end=(2.0, 0.0), shapes=None, **arc):
    shapes = shapes or power_products([(1, 2), (2, 1), (2, 2)])
    conditions = dict(enumerate(start)), dict(enumerate(end))
    return TaranenkoReference(shapes, *conditions, **{'tau_f': 2.0, **arc})


def sines(start=(0.0, 1.0), end=(2.0, 0.0), **arc):
    return series(start, end, SineSeries(4), **arc)


FUNCTIONS = pytest.mark.parametrize('function', [polynomial, series, sines])


@FUNCTIONS
@pytest.mark.parametrize('value', BAD_SCALARS.values(), ids=BAD_SCALARS)
def test_reference_functions(function, value):
    assert 'tau_f = ' in refused(lambda: function(tau_f=value))
    assert 'tau_0 = ' in refused(lambda: function(tau_0=value))
    if value in (1e300, []):
        return  # a number like any other; an empty array is a function with no components
    assert 'boundary values' in refused(lambda: function(start=(value, 1.0)))
    assert 'boundary values' in refused(lambda: function(end=(0.0, value)))
    x = function()
    for call in (x, x.jacobian):
        assert 'tau' in refused(lambda call=call: call(value))


WHOLE = [
    *(
        (call, 'order of a derivative')
        for made in (polynomial(), series(), sines())
        for call in (lambda v, f=made: f(0.5, v), lambda v, f=made: f.jacobian(0.5, v))
    ),
    (lambda v: SineSeries(v), 'must be an integer from 1 to 100'),
    (lambda v: symmetric_powers(v), 'must be an integer from 1 to 100'),
    (lambda v: power_products([(v, 1)]), 'must be an integer from 1 to 100'),
    (lambda v: power_products([(1, v)]), 'must be an integer from 1 to 100'),
    (lambda v: Output(free=v), 'free = '),
    (lambda v: Output(derivatives=v), 'derivatives = '),
    (lambda v: Duration(speed_factor_order=v), 'speed_factor_order = '),
]
NUMBERS = [
    (lambda v: Integrated(v), 'the start of an integrated state'),
    (lambda v: Duration(guess=v), 'guess'),
]
NUMBERS_OR_NONE = [
    (lambda v: Output(start=(0.0, v)), 'derivative 1 at the start'),
    (lambda v: Output(scale=v), 'scale'),
    (lambda v: Duration(shortest=v), 'shortest'),
    (lambda v: Duration(longest=v), 'longest'),
    (lambda v: Integrated(0.0, v), 'the end of an integrated state'),
]


@pytest.mark.parametrize('value', NOT_WHOLE.values(), ids=NOT_WHOLE)
def test_whole_numbers(value):
    for make, words in WHOLE:
        assert words in refused(lambda make=make: make(value))


@pytest.mark.parametrize('value', BAD_SCALARS.values(), ids=BAD_SCALARS)
def test_numbers(value):
    for make, words in [*NUMBERS, *(NUMBERS_OR_NONE if value is not None else [])]:
        assert words in refused(lambda make=make: make(value))
    if value not in (None, [], {0: 1.0}):
        refused(lambda: Output(end=value))


@pytest.mark.parametrize('order', [-1, 1.5, '1', None, 10**6, True])
def test_orders_of_conditions(order):
    for make in (
        lambda: PolynomialReference({0: 0.0, order: 1.0}, {0: 1.0}, 1.0),
        lambda: TaranenkoReference(SineSeries(3), {0: 0.0}, {0: 1.0, order: 1.0}, 1.0),
        lambda: Output(start={0: 0.0, order: 1.0}),
    ):
        assert 'order of a derivative given' in refused(make)


@pytest.mark.parametrize('wrong', [None, (0.0, 1.0), 'start', 3.0, [(0, 1.0)], SineSeries])
def test_what_is_neither_conditions_nor_shapes(wrong):
    assert 'must be a mapping' in refused(lambda: PolynomialReference(wrong, {0: 1.0}, 1.0))
    assert 'must be a mapping' in refused(
        lambda: TaranenkoReference(SineSeries(3), {0: 1.0}, wrong, 1.0)
    )
    assert 'family of shapes' in refused(
        lambda: TaranenkoReference(wrong, {0: 0.0}, {0: 1.0}, 1.0)
    )
    if wrong is not None:
        assert 'family of shapes' in refused(lambda: Output(shapes=wrong))
    with pytest.raises(TypeError):
        SineSeries(2) + 'more'


@pytest.mark.parametrize('exponents', [None, 3, [1, 2], [(1, 2, 3)], [(1,)], 'ab', []])
def test_exponents_that_are_no_pairs(exponents):
    refused(lambda: power_products(exponents))


ZERO = {0: 0.0}
TWO = SineSeries(2)
CASES = [
    # Reference functions.
    *(
        (lambda f=f, end=end: f(tau_0=0.5, tau_f=end), 'must end after it starts')
        for f in (polynomial, series, sines)
        for end in (0.0, -1.0, 0.5)
    ),
    (lambda: PolynomialReference({1: 1.0}, {1: 0.0}, 1.0), 'do not determine'),
    (lambda: PolynomialReference({}, {}, 1.0), 'at least one'),
    (lambda: polynomial(([1.0, 2.0],), ([1.0, 2.0, 3.0],)), 'share a shape'),
    (lambda: polynomial((0, 0, 0, 1e300), (1,), tau_f=1e80), 'up to 1e+300, cannot be computed'),
    (lambda: TaranenkoReference(TWO, {1: 0.0}, ZERO, 1.0), 'value at the start is missing'),
    (lambda: TaranenkoReference(TWO, ZERO, {}, 1.0), 'value at the end is missing'),
    (lambda: series(shapes=SineSeries(1)), 'only 1 shapes to meet them'),
    (lambda: TaranenkoReference(SineSeries(4), {0: 0.0, 2: 1.0}, ZERO, 1.0), 'contradict'),
    (lambda: series((0.0, 1.0), (0.0, 1.0), symmetric_powers(4)), 'contradict'),
    (lambda: series(([0.0, 1.0],), ([1.0, 2.0, 3.0],), TWO), 'share a shape'),
    (lambda: series((0,), (0,), TWO, varied=[1.0]), 'shape (1,), expected (2,)'),
    (lambda: series((0,), (0,), TWO, varied=[1.0, np.nan]), 'varied coefficient'),
    # Shapes.
    (lambda: power_products([(0, 1)]), 'exponent of (0, 1) = 0 is not allowed'),
    (lambda: power_products([(1, 1), (1, 1)]), 'distinct'),
    (lambda: PowerProducts([(1, 1)]), 'exponents = [(1, 1)] must be a tuple of pairs'),
    (lambda: SineSeries(2) + SineSeries(2), 'more than one'),
    (
        lambda: SineSeries(2) + symmetric_powers(2) + power_products([(3, 1), (2, 2)]),
        's^2 (s - 1)^2',
    ),
    (lambda: CombinedShapes((TWO, symmetric_powers(4) + TWO)), 'more than one'),
    # Outputs, durations, integrated states.
    *((lambda v=v: Output(scale=v), 'must be a positive number') for v in (0.0, -1.0)),
    *((lambda v=v: Integrated(0.0, scale=v), 'must be a positive number') for v in (0.0, -1.0)),
    (lambda: Output(free=2, shapes=SineSeries(2)), 'free = 2 is for polynomials'),
    *((lambda v=v: Duration(guess=v), 'guess') for v in (0.0, -1.0)),
    *((lambda v=v: Duration(shortest=v), 'shortest') for v in (0.0, -1.0)),
    *((lambda v=v: Duration(longest=v), 'longest') for v in (0.0, -1.0)),
    (lambda: Duration(1.0, shortest=2.0), 'shortest'),
    (lambda: Duration(fixed=True, speed_factor_order=2), 'fixed'),
    (lambda: output_basis('x', Output((0.0, None, 1.0), (0.0,)), 2), 'all lower ones'),
    (lambda: output_basis('x', Output((0, 1), (0, 1), shapes=symmetric_powers(5)), 0), 'cannot'),
]


@pytest.mark.parametrize(('make', 'words'), CASES)
def test_what_makes_no_sense_together(make, words):
    assert words in refused(make)


@pytest.mark.parametrize('convert', [time_derivatives, arc_derivatives])
@pytest.mark.parametrize(
    ('values', 'speed', 'words'),
    [
        ([], [1.0], 'no derivatives'),
        ([0.0, 1.0, 2.0], [1.0], 'only 1 are given'),
        ([0.0, 1.0], [0.0], 'must be positive'),
        ([0.0, 1.0], [-2.0], 'must be positive'),
        ([0.0, 1.0], [np.nan], 'must be positive'),
        ([np.zeros(3), np.ones(3)], [[1.0, 0.0, 2.0]], 'speed factor is 0'),
        ([np.zeros(3), np.ones(4)], [1.0], 'must share a shape'),
        ([np.zeros(3), np.ones(3)], [np.ones(2)], 'must share a shape'),
        (['a', 1.0], [1.0], 'sequence of numbers'),
        ([0.0, 1.0], ['fast'], 'sequence of numbers'),
        (None, [1.0], 'sequence of numbers'),
        ([0.0, 1.0], None, 'sequence of numbers'),
        ([1.0, np.array([0.0, np.nan])], [1.0], 'derivative 1 is nan'),
        ([1.0, 2.0, 3.0], [1.0, np.inf], 'derivative 1 of the speed factor is inf'),
    ],
)
def test_conversions(convert, values, speed, words):
    assert words in refused(lambda: convert(values, speed))


def test_numbers_of_any_kind_are_numbers():
    assert Output(start=(np.float32(1), 2, Decimal(3))).conditions('start') == {0: 1, 1: 2, 2: 3}
    assert PolynomialReference({np.int64(0): 1}, {0: np.float32(2)}, 1)(1) == 2.0
    assert PolynomialReference({0: 1}, {0: 2}, 1)(0.5, np.int32(1)) == 1.0


@pytest.mark.parametrize('tau_f', [1e99, 1e-99])
def test_arcs_whose_powers_are_no_numbers(tau_f):
    message = refused(lambda: polynomial((0, 0, 0, 0, 1e10), (1,), tau_f=tau_f))
    assert 'derivative 4 cannot be computed on a virtual arc of length' in message
    for function in (polynomial, series):
        x = function((0.0,), (1.0,), tau_f=tau_f)
        assert x(tau_f) == 1.0
        for call in (x, x.jacobian):
            assert 'derivative 4 cannot' in refused(lambda call=call: call(tau_f, 4))
