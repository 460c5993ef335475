# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.polynomial import Polynomial
import pytest
from tdm_planner.direct_method import (
    CombinedShapes,
    power_products,
    PowerProducts,
    SineSeries,
    symmetric_powers,
)
from tdm_planner.exceptions import InvalidProblem

FAMILIES = [SineSeries(5), symmetric_powers(4), power_products([(1, 1), (1, 3), (4, 2)])]


@pytest.mark.parametrize('shapes', [*FAMILIES, FAMILIES[0] + FAMILIES[2]])
def test_shapes_vanish_at_both_ends_exactly(shapes):
    assert (shapes.values([0.0, 1.0]) == 0).all()
    assert shapes.values(np.zeros((2, 3))).shape == (2, 3, shapes.size)


@given(st.lists(st.tuples(st.integers(1, 5), st.integers(1, 5)), min_size=1, unique=True))
@settings(deadline=None, max_examples=40, derandomize=True)
def test_power_products_are_the_polynomials_they_say(exponents):
    s = np.linspace(-0.2, 1.2, 9)
    shapes = power_products(exponents)
    for column, (m1, m2) in enumerate(exponents):
        product = Polynomial([0, 1]) ** m1 * Polynomial([-1, 1]) ** m2
        for derivative in range(5):
            expected = product.deriv(derivative)(s) if derivative else product(s)
            found = shapes.values(s, derivative)[:, column]
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-8)


def test_sines_and_their_derivatives():
    s = np.linspace(0, 1, 23)
    k = np.arange(1, 6)
    for derivative in range(6):
        expected = (k * np.pi) ** derivative * np.sin(
            k * np.pi * s[:, None] + derivative * np.pi / 2
        )
        found = SineSeries(5).values(s, derivative)
        np.testing.assert_allclose(found, expected, atol=1e-11 * (5 * np.pi) ** derivative)


@pytest.mark.parametrize(
    ('make', 'words'),
    [
        (lambda: SineSeries(0), 'an integer from 1'),
        (lambda: symmetric_powers(0), 'an integer from 1'),
        (lambda: power_products([]), 'at least one pair'),
        (lambda: power_products([(0, 1)]), r'exponent of \(0, 1\) = 0 is not allowed'),
        (lambda: power_products([(1, 1), (1, 1)]), 'distinct'),
        (
            lambda: PowerProducts([(1, 1)]),  # type: ignore[arg-type]
            r'exponents = \[\(1, 1\)\] must be a tuple of pairs',
        ),
        (lambda: SineSeries(2) + SineSeries(2), r'sin\(1 pi s\).* more than one'),
        (
            lambda: SineSeries(2) + symmetric_powers(2) + power_products([(3, 1), (2, 2)]),
            r's\^2 \(s - 1\)\^2.* more than one',
        ),
        (lambda: CombinedShapes((FAMILIES[0], FAMILIES[1] + FAMILIES[0])), 'more than one'),
    ],
)
def test_families_that_make_no_sense_are_refused(make, words):
    with pytest.raises(InvalidProblem, match=words):
        make()
