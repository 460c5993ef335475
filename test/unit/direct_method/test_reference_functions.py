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
import pytest
from tdm_planner.direct_method import (
    arc_derivatives,
    Output,
    PolynomialReference,
    power_products,
    ReferenceFunction,
    SineSeries,
    symmetric_powers,
    TaranenkoReference,
    time_derivatives,
)
from tdm_planner.direct_method.output_basis import output_basis

NUMBERS = st.floats(-1e3, 1e3).filter(lambda v: v == 0 or abs(v) > 1e-6)
VALUES = st.floats(-10, 10)


@st.composite
def conditions(draw):
    """Consecutive derivatives at both ends, order up to 11, span from 1e-3 to 1e3."""
    at_start, at_end = draw(st.integers(1, 6)), draw(st.integers(1, 6))
    span = 10 ** draw(st.floats(-3, 3))
    start = {k: draw(NUMBERS) / span**k for k in range(at_start)}
    end = {k: draw(NUMBERS) / span**k for k in range(at_end)}
    return start, end, span, draw(st.floats(-10, 10))


@given(conditions())
@settings(max_examples=200)
def test_polynomials_meet_every_boundary_condition(given_conditions):
    start, end, span, tau_0 = given_conditions
    x = PolynomialReference(start, end, tau_0 + span, tau_0)
    assert x.order == len(start) + len(end) - 1
    for tau, wanted in ((x.tau_0, start), (x.tau_f, end)):
        for k, value in wanted.items():
            assert x(tau, k) == pytest.approx(value, rel=1e-10, abs=0 if value else 1e-300)


def test_vector_values_and_lacunary_conditions():
    start = {0: [0.0, 1.0], 1: [0.5, 0.0]}
    end = {0: [2.0, -1.0], 1: [0.0, 0.0], 3: [1.0, 2.0]}
    tau = np.linspace(0, 2, 5)
    x = PolynomialReference(start, end, 2.0)
    assert x(tau, 1).shape == (5, 2)
    assert x(1.0).shape == (2,)
    data = np.array([*start.values(), *end.values()])
    for k in range(4):
        np.testing.assert_allclose(x.jacobian(tau, k) @ data, x(tau, k), atol=1e-12)
    np.testing.assert_allclose(x(2.0, 3), [1.0, 2.0])
    y = TaranenkoReference(SineSeries(4), start, {0: [2.0, 1.0]}, 2.0, varied=np.ones((3, 2)))
    assert y(np.zeros((5, 3)), 1).shape == (5, 3, 2)
    np.testing.assert_allclose(y(0.0, 1), [0.5, 0.0], atol=1e-12)
    # A condition that always holds is no contradiction.
    y = TaranenkoReference(SineSeries(3), {0: 0.0, 2: 0.0}, {0: 1.0}, 1.0)
    assert len(y.varied_indices) == 3


FAMILIES = {
    'sines': (SineSeries(6), 1),
    'products': (power_products([(i, j) for i in range(1, 4) for j in range(1, 4)]), 2),
    'mixed': (SineSeries(3) + power_products([(2, 1), (1, 2), (2, 3), (3, 2)]), 2),
}


@st.composite
def references(draw):
    """Return a function with end derivatives given, its conditions, and what is varied."""
    shapes, highest = FAMILIES[draw(st.sampled_from(sorted(FAMILIES)))]
    span, tau_0 = 10 ** draw(st.floats(-2, 2)), draw(st.floats(-5, 5))
    start = {k: draw(VALUES) / span**k for k in range(draw(st.integers(1, highest + 1)))}
    end = {k: draw(VALUES) / span**k for k in range(draw(st.integers(1, highest + 1)))}
    x = TaranenkoReference(shapes, start, end, tau_0 + span, tau_0)
    varied = [draw(VALUES) for _ in x.varied_indices]
    return x.with_varied(varied), start, end, span


@given(references())
@settings(max_examples=150)
def test_every_boundary_condition_holds_whatever_is_varied(drawn):
    x, start, end, span = drawn
    assert len(x.varied_indices) == x.basis.shapes.size - (len(start) + len(end) - 2)
    for tau, wanted in ((x.tau_0, start), (x.tau_f, end)):
        for k, value in wanted.items():
            assert x(tau, k) * span**k == pytest.approx(value * span**k, abs=1e-8)


@given(references(), st.integers(0, 3))
@settings(max_examples=60)
def test_jacobian_is_exact(drawn, order):
    x = drawn[0]
    tau = np.linspace(x.tau_0, x.tau_f, 7)
    jacobian = x.jacobian(tau, order)
    change = np.arange(1.0, 1 + len(x.varied_indices))
    difference = x.with_varied(x.varied + change)(tau, order) - x(tau, order)
    scale = 1 + np.abs(x(tau, order)).max() + np.abs(difference).max()
    np.testing.assert_allclose(jacobian @ change, difference, atol=1e-10 * scale)


START, END = {0: 1.0, 1: -0.5}, {0: 2.0, 1: 0.3}


FUNCTIONS: dict[str, ReferenceFunction] = {
    'polynomial': PolynomialReference({**START, 2: 0.7}, {**END, 3: 1.0}, 3.0, 1.0),
    'sines': TaranenkoReference(SineSeries(5), START, END, 3.0, 1.0, [0.2, -0.1, 0.3]),
    'powers': TaranenkoReference(
        symmetric_powers(3) + power_products([(1, 2)]), START, END, 3.0, 1.0, [0.4, -2.0]
    ),
    'products': TaranenkoReference(
        power_products([(1, 2), (2, 1), (2, 2)]), START, END, 3.0, 1.0, [0.5]
    ),
}


@pytest.mark.parametrize('x', FUNCTIONS.values(), ids=FUNCTIONS)
def test_all_are_called_alike_and_every_order_is_the_derivative_of_the_one_below(x):
    assert isinstance(x, ReferenceFunction)
    for shape in ((), (0,), (2, 1, 4)):
        tau = np.linspace(1.0, 3.0, int(np.prod(shape))).reshape(shape)
        for order in range(4):
            assert x(tau, order).shape == shape
            assert x.jacobian(tau, order).shape[:-1] == shape
            np.testing.assert_array_equal(x(tau, order).ravel(), x(tau.ravel(), order))
    tau, step = np.linspace(1.1, 2.9, 12), 1e-5
    for order in (1, 2, 3, 4):
        slope = (x(tau + step, order - 1) - x(tau - step, order - 1)) / (2 * step)
        scale = 1 + np.abs(slope).max()
        np.testing.assert_allclose(x(tau, order), slope, atol=1e-6 * scale)


SHAPES = [SineSeries(5), symmetric_powers(4), power_products([(1, 1), (1, 3), (4, 2)])]


@pytest.mark.parametrize('shapes', [*SHAPES, SHAPES[0] + SHAPES[2]])
def test_shapes_vanish_at_both_ends_exactly(shapes):
    assert (shapes.values([0.0, 1.0]) == 0).all()
    assert shapes.values(np.zeros((2, 3))).shape == (2, 3, shapes.size)


@given(st.lists(st.tuples(st.integers(1, 5), st.integers(1, 5)), min_size=1, unique=True))
@settings(max_examples=40)
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


@given(st.integers(0, 4), st.integers(0, 4), st.integers(0, 12))
@settings(max_examples=40)
def test_conditions_hold_and_free_shapes_are_orthonormal(at_start, at_end, free):
    if at_start + at_end + free == 0:
        return
    output = Output((1.0,) * at_start, (1.0,) * at_end, free)
    basis = output_basis('x', output, 0)
    assert basis.size == free
    for s, orders, offset in ((0.0, basis.start, 0), (1.0, basis.end, at_start)):
        for index, order in enumerate(orders):
            unit = np.eye(at_start + at_end)[offset + index]
            np.testing.assert_allclose(basis.given(s, order), unit, atol=1e-9)
            np.testing.assert_allclose(basis.varied(s, order), 0.0, atol=1e-7)
    points, weights = np.polynomial.legendre.leggauss(40)
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
