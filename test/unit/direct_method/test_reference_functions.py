# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Polynomials, Taranenko's functions, their shapes, speed factors, and the bases of outputs."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.polynomial import Polynomial
from tdm_planner.direct_method import Output, PowerProducts, SineSeries
from tdm_planner.direct_method.bases import PolynomialBasis
from tdm_planner.direct_method.output_basis import output_basis
from tdm_planner.direct_method.virtual_arc import arc_derivatives, time_derivatives
from tdm_planner.exceptions import InvalidProblem


@given(
    st.sets(st.integers(0, 4), min_size=1), st.sets(st.integers(0, 4), min_size=1), st.floats(0, 1)
)
@settings(max_examples=60)
def test_every_polynomial_meets_one_condition_and_its_derivatives_are_derivatives(first, last, s):
    """In exact arithmetic made, so to the last bits; where the conditions determine one."""
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


@given(st.lists(st.tuples(st.integers(1, 5), st.integers(1, 5)), min_size=1, unique=True))
@settings(max_examples=40)
def test_power_products_are_the_polynomials_they_say(exponents):
    s = np.linspace(-0.2, 1.2, 9)
    shapes = PowerProducts(exponents)
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


SINES = SineSeries(6)
PRODUCTS = PowerProducts([(1, 1), (2, 1), (2, 2), (3, 2), (3, 3)])
MIXED = SineSeries(3) + PowerProducts([(2, 1), (1, 2), (2, 3), (3, 2)])


@given(
    st.integers(0, 4),
    st.integers(0, 4),
    st.integers(0, 12),
    st.sampled_from([None, SINES, PRODUCTS, MIXED]),
)
@settings(max_examples=80)
def test_conditions_hold_and_free_shapes_are_orthonormal(at_start, at_end, free, shapes):
    if shapes is not None:
        highest = 2 if shapes is SINES else 3
        at_start, at_end = min(max(at_start, 1), highest), min(max(at_end, 1), highest)
        free = shapes.size - (at_start + at_end - 2)
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


def test_conditions_with_a_gap():
    output = Output(start=(0.0, None, 2.0), end={0: 1.0}, free=1)
    basis = output_basis('x', output, 0)
    assert basis.start == (0, 2)
    np.testing.assert_allclose(basis.varied(0.0, 2), 0.0, atol=1e-12)
    assert abs(basis.varied(0.0, 1)).max() > 0.1


@given(
    st.lists(st.floats(-10, 10), min_size=5, max_size=5),
    st.floats(0.1, 10),
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
)
@settings(max_examples=100)
def test_conversions_round_trip(values, speed, slopes):
    factor = [speed, *slopes]
    there = arc_derivatives(values, factor)
    np.testing.assert_allclose(time_derivatives(there, factor), values, rtol=1e-9, atol=1e-6)
