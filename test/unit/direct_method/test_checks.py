# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Bad input to reference functions, speed factors and conversions: one sentence each."""

from decimal import Decimal
import warnings

import numpy as np
import pytest
from tdm_planner.direct_method import (
    arc_derivatives,
    Duration,
    Integrated,
    Output,
    path_speed,
    PolynomialReference,
    power_products,
    SineSeries,
    SpeedFactor,
    symmetric_powers,
    TaranenkoReference,
    time_derivatives,
    TimeFactor,
)
from tdm_planner.exceptions import InvalidProblem

VALUES = {
    'None': None,
    'a string': 'fast',
    'a numeral': '1.0',
    'NaN': float('nan'),
    'inf': float('inf'),
    'huge': 1e300,
    'too huge for a float': 10**400,
    'complex': 1.0 + 2.0j,
    'empty': [],
    'ragged': [1.0, [2.0, 3.0]],
    'a mapping': {0: 1.0},
    'an object': object(),
}
NOT_WHOLE = {**VALUES, 'a fraction': 1.5, 'negative': -1, 'a million': 10**6, 'true': True}


def refused(make) -> str:
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
    return PolynomialReference(
        dict(enumerate(start)), dict(enumerate(end)), **{'tau_f': 2.0, **arc}
    )


def series(start=(0.0, 1.0), end=(2.0, 0.0), **arc):
    return TaranenkoReference(
        power_products([(1, 2), (2, 1), (2, 2)]),
        dict(enumerate(start)),
        dict(enumerate(end)),
        **{'tau_f': 2.0, **arc},
    )


def sines(start=(0.0, 1.0), end=(2.0, 0.0), **arc):
    return TaranenkoReference(
        SineSeries(4), dict(enumerate(start)), dict(enumerate(end)), **{'tau_f': 2.0, **arc}
    )


FUNCTIONS = pytest.mark.parametrize('function', [polynomial, series, sines])
FACTORS = pytest.mark.parametrize('factor', [SpeedFactor, TimeFactor])


@FUNCTIONS
@pytest.mark.parametrize('value', VALUES.values(), ids=VALUES)
def test_boundary_values(function, value):
    if value in (1e300, []):
        return  # numbers like any other; an empty array is a function with no components
    assert 'boundary values' in refused(lambda: function(start=(value, 1.0)))
    assert 'boundary values' in refused(lambda: function(end=(0.0, value)))


@FUNCTIONS
@pytest.mark.parametrize('value', VALUES.values(), ids=VALUES)
def test_ends_of_the_arc(function, value):
    assert 'tau_f = ' in refused(lambda: function(tau_f=value))
    assert 'tau_0 = ' in refused(lambda: function(tau_0=value))


@FUNCTIONS
@pytest.mark.parametrize('tau_f', [0.0, -1.0, 0.5])
def test_an_arc_that_ends_before_it_starts(function, tau_f):
    assert 'must end after it starts' in refused(lambda: function(tau_0=0.5, tau_f=tau_f))


@FUNCTIONS
@pytest.mark.parametrize('order', NOT_WHOLE.values(), ids=NOT_WHOLE)
def test_order_of_a_derivative(function, order):
    x = function()
    for call in (x, x.jacobian):
        assert 'order of a derivative' in refused(lambda call=call: call(0.5, order))


@FUNCTIONS
@pytest.mark.parametrize('tau', VALUES.values(), ids=VALUES)
def test_arguments(function, tau):
    x = function()
    if tau == []:
        assert x(tau).shape == (0,)
    elif tau != 1e300:
        for call in (x, x.jacobian):
            assert 'tau' in refused(lambda call=call: call(tau))


@pytest.mark.parametrize('order', [-1, 1.5, '1', None, 10**6, True])
def test_orders_of_conditions(order):
    for make in (
        lambda: PolynomialReference({0: 0.0, order: 1.0}, {0: 1.0}, 1.0),
        lambda: TaranenkoReference(SineSeries(3), {0: 0.0}, {0: 1.0, order: 1.0}, 1.0),
        lambda: Output(start={0: 0.0, order: 1.0}),
    ):
        assert 'order of a derivative given' in refused(make)


@pytest.mark.parametrize('given', [None, (0.0, 1.0), 'start', 3.0, [(0, 1.0)]])
def test_conditions_that_are_no_mapping(given):
    for make in (
        lambda: PolynomialReference(given, {0: 1.0}, 1.0),
        lambda: TaranenkoReference(SineSeries(3), {0: 1.0}, given, 1.0),
    ):
        assert 'must be a mapping' in refused(make)


def test_order_too_low_for_the_conditions():
    words = refused(
        lambda: TaranenkoReference(SineSeries(1), {0: 0.0, 1: 1.0}, {0: 0.0, 1: 2.0}, 1.0)
    )
    assert 'only 1 shapes to meet them' in words


@pytest.mark.parametrize('count', NOT_WHOLE.values(), ids=NOT_WHOLE)
def test_sizes_of_families(count):
    for make in (
        lambda: SineSeries(count),
        lambda: symmetric_powers(count),
        lambda: power_products([(count, 1)]),
        lambda: power_products([(1, count)]),
    ):
        assert 'must be an integer from 1 to 100' in refused(make)


@pytest.mark.parametrize('exponents', [None, 3, [1, 2], [(1, 2, 3)], [(1,)], 'ab', []])
def test_exponents_that_are_no_pairs(exponents):
    refused(lambda: power_products(exponents))


@pytest.mark.parametrize('shapes', [None, 'sine', 3, SineSeries])
def test_shapes_that_are_none(shapes):
    assert 'family of shapes' in refused(
        lambda: TaranenkoReference(shapes, {0: 0.0}, {0: 1.0}, 1.0)
    )
    with pytest.raises(TypeError):
        SineSeries(2) + 'more'


@FACTORS
@pytest.mark.parametrize('value', [*VALUES.values(), 0.0, -1.0], ids=[*VALUES, 'zero', 'negative'])
def test_speed_factors_that_are_not_positive(factor, value):
    if value != 1e300:
        assert 'speed factor' in refused(lambda: factor([1.0, value], 2.0))
        assert 'speed factor' in refused(lambda: factor(value, 2.0))
    assert 'tau_f = ' in refused(
        lambda: factor([1.0], value) if value != 0 else factor([1.0], '0')
    )


@FACTORS
@pytest.mark.parametrize('value', NOT_WHOLE.values(), ids=NOT_WHOLE)
def test_calls_of_speed_factors(factor, value):
    made = factor([1.0, 2.0], 2.0)
    assert 'order of a derivative' in refused(lambda: made(1.0, value))
    if value in (1.5, -1, 10**6, True, 1e300, []):
        return  # an argument like any other
    for call in (made, made.time, made.arc_at):
        refused(lambda call=call: call(value))


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
    ],
)
def test_conversions(convert, values, speed, words):
    assert words in refused(lambda: convert(values, speed))


@pytest.mark.parametrize('speed', [0.0, -1.0, np.nan, None, 'fast', np.ones(2)])
def test_path_speed(speed):
    refused(lambda: path_speed([np.ones(3), np.ones(3)], speed))


@pytest.mark.parametrize('value', VALUES.values(), ids=VALUES)
def test_values_of_an_output(value):
    if value is not None:
        assert 'derivative 1 at the start' in refused(lambda: Output(start=(0.0, value)))
        assert 'scale' in refused(lambda: Output(scale=value))
    if value not in ([], {0: 1.0}) and value is not None:
        refused(lambda: Output(end=value))


@pytest.mark.parametrize('value', NOT_WHOLE.values(), ids=NOT_WHOLE)
def test_counts_of_an_output(value):
    assert 'free = ' in refused(lambda: Output(free=value))
    assert 'derivatives = ' in refused(lambda: Output(derivatives=value))
    assert 'speed_factor_order = ' in refused(lambda: Duration(speed_factor_order=value))


@pytest.mark.parametrize('scale', [0.0, -1.0])
def test_scales_are_positive(scale):
    assert 'must be a positive number' in refused(lambda: Output(scale=scale))
    assert 'must be a positive number' in refused(lambda: Integrated(0.0, scale=scale))


@pytest.mark.parametrize('shapes', ['sine', 3, SineSeries, [1]])
def test_shapes_of_an_output(shapes):
    assert 'family of shapes' in refused(lambda: Output(shapes=shapes))


def test_shapes_and_free_parameters_contradict_each_other():
    assert 'free = 2 is for polynomials' in refused(lambda: Output(free=2, shapes=SineSeries(2)))


@pytest.mark.parametrize('value', [*VALUES.values(), 0.0, -1.0], ids=[*VALUES, 'zero', 'negative'])
def test_durations(value):
    assert 'guess' in refused(lambda: Duration(guess=value))
    if value is not None:
        assert 'shortest' in refused(lambda: Duration(shortest=value))
        assert 'longest' in refused(lambda: Duration(longest=value))


@pytest.mark.parametrize('value', VALUES.values(), ids=VALUES)
def test_integrated_states(value):
    assert 'the start of an integrated state' in refused(lambda: Integrated(value))
    if value is not None:
        assert 'the end of an integrated state' in refused(lambda: Integrated(0.0, value))


def test_numbers_of_any_kind_are_numbers():
    assert Output(start=(np.float32(1), 2, Decimal(3))).conditions('start') == {0: 1, 1: 2, 2: 3}
    assert PolynomialReference({np.int64(0): 1}, {0: np.float32(2)}, 1)(1) == 2.0
    assert PolynomialReference({0: 1}, {0: 2}, 1)(0.5, np.int32(1)) == 1.0
    assert float(SpeedFactor(np.array(2), 4).duration) == pytest.approx(2.0)


@pytest.mark.parametrize('convert', [time_derivatives, arc_derivatives])
@pytest.mark.parametrize('wrong', [np.nan, np.inf])
def test_conversions_of_what_is_not_finite(convert, wrong):
    message = refused(lambda: convert([1.0, np.array([0.0, wrong])], [1.0]))
    assert f'derivative 1 is {wrong}' in message
    message = refused(lambda: convert([1.0, 2.0, 3.0], [1.0, wrong]))
    assert f'derivative 1 of the speed factor is {wrong}' in message


@pytest.mark.parametrize('tau_f', [1e99, 1e-99])
def test_polynomials_on_arcs_whose_powers_are_no_numbers(tau_f):
    message = refused(
        lambda: PolynomialReference({0: 0, 1: 0, 2: 0, 3: 0, 4: 1e10}, {0: 1}, tau_f)
    )
    assert 'derivative 4 cannot be computed on a virtual arc of length' in message
    x = PolynomialReference({0: 0}, {0: 1}, tau_f)
    assert x(tau_f) == 1.0
    for call in (x, x.jacobian):
        assert 'derivative 4 cannot' in refused(lambda call=call: call(tau_f, 4))


def test_boundary_values_beyond_the_range_of_numbers():
    message = refused(lambda: PolynomialReference({0: 0, 1: 0, 2: 0, 3: 1e300}, {0: 1}, 1e80))
    assert 'up to 1e+300, cannot be computed with' in message


@pytest.mark.parametrize('tau_f', [1e99, 1e-99])
def test_series_on_arcs_whose_powers_are_no_numbers(tau_f):
    x = series(start=(0.0,), end=(1.0,), tau_f=tau_f)
    assert x(tau_f) == 1.0
    for call in (x, x.jacobian):
        assert 'derivative 4 cannot' in refused(lambda call=call: call(tau_f, 4))
