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
    Duration,
    Integrated,
    Output,
    PowerProducts,
    SineSeries,
    symmetric_powers,
)
from tdm_planner.direct_method.bases import PolynomialBasis
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


WHOLE = [
    (lambda v: SineSeries(v), 'must be an integer from 1 to 100'),
    (lambda v: symmetric_powers(v), 'must be an integer from 1 to 100'),
    (lambda v: PowerProducts([(v, 1)]), 'must be an integer from 1 to 100'),
    (lambda v: PowerProducts([(1, v)]), 'must be an integer from 1 to 100'),
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


def shaped(shapes, start=(0.0,), end=(0.0,)):
    return lambda: output_basis('x', Output(start, end, shapes=shapes), 0)


CASES = [
    (lambda: PolynomialBasis.of((1,), (1,)), 'do not determine'),
    (lambda: PolynomialBasis.of((), ()), 'at least one'),
    (shaped(SineSeries(2), (None, 0.0)), 'value at the start is missing'),
    (shaped(SineSeries(2), (0.0,), ()), 'value at the end is missing'),
    (shaped(SineSeries(1), (0.0, 1.0), (0.0, 1.0)), '1 shapes cannot meet'),
    (shaped(SineSeries(4), {0: 0.0, 2: 1.0}), '4 shapes cannot meet'),
    (shaped(symmetric_powers(4), (0, 1), (0, 1)), 'cannot meet'),
    (shaped(SineSeries(2) + SineSeries(2)), 'sums of others'),
    (shaped(SineSeries(2) + symmetric_powers(2) + PowerProducts([(2, 2)])), 'sums of others'),
    (lambda: PowerProducts([(0, 1)]), 'exponent of (0, 1) = 0 is not allowed'),
    (lambda: PowerProducts('ab'), ''),
    # Outputs, durations, integrated states.
    (lambda: Output(shapes='start'), 'family of shapes'),  # type: ignore[arg-type]
    (lambda: Output(start={0: 0.0, -1: 1.0}), 'order of a derivative given'),
    (lambda: Output(scale=0.0), 'must be a positive number'),
    (lambda: Integrated(0.0, scale=0.0), 'must be a positive number'),
    (lambda: Output(free=2, shapes=SineSeries(2)), 'free = 2 is for polynomials'),
    (lambda: Duration(guess=0.0), 'guess'),
    (lambda: Duration(shortest=0.0), 'shortest'),
    (lambda: Duration(longest=0.0), 'longest'),
    (lambda: Duration(1.0, shortest=2.0), 'shortest'),
    (lambda: Duration(fixed=True, speed_factor_order=2), 'fixed'),
    (lambda: output_basis('x', Output((0.0, None, 1.0), (0.0,)), 2), 'all lower ones'),
]


@pytest.mark.parametrize(('make', 'words'), CASES)
def test_what_makes_no_sense_together(make, words):
    assert words in refused(make)


def test_numbers_of_any_kind_are_numbers():
    assert Output(start=(np.float32(1), 2, Decimal(3))).conditions('start') == {0: 1, 1: 2, 2: 3}
