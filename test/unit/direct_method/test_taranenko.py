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
import pytest
from tdm_planner.direct_method import (
    PolynomialReference,
    power_products,
    ReferenceBasis,
    ReferenceFunction,
    SineSeries,
    symmetric_powers,
    TaranenkoReference,
)
from tdm_planner.exceptions import InvalidProblem

VALUES = st.floats(-10, 10)
PRODUCTS = power_products([(i, j) for i in range(1, 4) for j in range(1, 4)])
FAMILIES = {
    'sines': (SineSeries(6), 1),
    'products': (PRODUCTS, 2),
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
@settings(deadline=None, max_examples=150, derandomize=True)
def test_every_boundary_condition_holds_whatever_is_varied(drawn):
    x, start, end, span = drawn
    assert len(x.varied_indices) == x.basis.shapes.size - (len(start) + len(end) - 2)
    for tau, wanted in ((x.tau_0, start), (x.tau_f, end)):
        for k, value in wanted.items():
            assert x(tau, k) * span**k == pytest.approx(value * span**k, abs=1e-8)


@given(references())
@settings(deadline=None, max_examples=60, derandomize=True)
def test_derivatives_are_those_of_the_values(drawn):
    """Against a polynomial fitted through the values at Chebyshev points."""
    x, _, _, span = drawn
    fitted = np.polynomial.Chebyshev.interpolate(lambda s: x(x.tau_0 + span * s), 32, [0, 1])
    s = np.linspace(0, 1, 9)
    for order in (1, 2, 3):
        expected = fitted.deriv(order)(s)
        found = x(x.tau_0 + span * s, order) * span**order
        np.testing.assert_allclose(found, expected, atol=1e-6 * (1 + np.abs(expected).max()))


@given(references(), st.integers(0, 3))
@settings(deadline=None, max_examples=60, derandomize=True)
def test_jacobian_is_exact(drawn, order):
    x = drawn[0]
    tau = np.linspace(x.tau_0, x.tau_f, 7)
    jacobian = x.jacobian(tau, order)
    change = np.arange(1.0, 1 + len(x.varied_indices))
    difference = x.with_varied(x.varied + change)(tau, order) - x(tau, order)
    scale = 1 + np.abs(x(tau, order)).max() + np.abs(difference).max()
    np.testing.assert_allclose(jacobian @ change, difference, atol=1e-10 * scale)


def test_the_paper_s_form_of_the_power_products():
    """x_0 + (x_f - x_0)/(tau_f - tau_0) (tau - tau_0) + A (tau - tau_0)^2 (tau - tau_f)^3."""
    tau_0, tau_f, a = 1.0, 3.0, 0.7
    x = TaranenkoReference(
        power_products([(2, 3)]), {0: 5.0}, {0: -1.0}, tau_f, tau_0, [a * 2.0**5]
    )
    tau = np.linspace(tau_0, tau_f, 11)
    expected = 5.0 - 3.0 * (tau - tau_0) + a * (tau - tau_0) ** 2 * (tau - tau_f) ** 3
    np.testing.assert_allclose(x(tau), expected, atol=1e-12)


def test_products_span_the_polynomials():
    """With all derivatives up to the second given, nine products hold the paper's quintic."""
    start, end = {0: 1.0, 1: -2.0, 2: 0.5}, {0: 3.0, 1: 1.0, 2: 0.0}
    quintic = PolynomialReference(start, end, 2.0)
    shapes = power_products([(1, 1), (2, 1), (2, 2), (3, 2)])
    x = TaranenkoReference(shapes, start, end, 2.0)
    tau = np.linspace(0, 2, 9)
    np.testing.assert_allclose(x(tau), quintic(tau), atol=1e-11)


def test_values_may_be_vectors():
    x = TaranenkoReference(
        SineSeries(4), {0: [0.0, 1.0], 1: [1.0, 0.0]}, {0: [2.0, 1.0]}, 2.0, varied=np.ones((3, 2))
    )
    assert x(np.zeros((5, 3)), 1).shape == (5, 3, 2)
    np.testing.assert_allclose(x(0.0, 1), [1.0, 0.0], atol=1e-12)


def test_families_satisfy_the_protocols():
    polynomial = PolynomialReference({0: 0.0}, {0: 1.0}, 1.0)
    series = TaranenkoReference(SineSeries(2), {0: 0.0}, {0: 1.0}, 1.0)
    assert isinstance(polynomial, ReferenceFunction)
    assert isinstance(series, ReferenceFunction)
    assert isinstance(series.basis, ReferenceBasis)


ZERO = {0: 0.0}


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ((SineSeries(2), {1: 0.0}, ZERO, 1.0), 'value at the start is missing'),
        ((SineSeries(2), ZERO, {}, 1.0), 'value at the end is missing'),
        ((SineSeries(2), ZERO, ZERO, 0.0), 'must end after it starts'),
        ((SineSeries(2), ZERO, ZERO, float('nan')), 'tau_f = nan'),
        ((SineSeries(1), {0: 0.0, 1: 1.0}, {0: 0.0, 1: 1.0}, 1.0), 'only 1 shapes'),
        ((SineSeries(4), {0: 0.0, 2: 1.0}, ZERO, 1.0), 'contradict'),
        ((symmetric_powers(4), {0: 0.0, 1: 1.0}, {0: 0.0, 1: 1.0}, 1.0), 'contradict'),
        ((SineSeries(2), {0: float('inf')}, ZERO, 1.0), 'not a finite number'),
        ((SineSeries(2), {0: [0.0, 1.0]}, {0: [1.0, 2.0, 3.0]}, 1.0), 'share a shape'),
        ((SineSeries(2), {0: 0.0, -1: 1.0}, ZERO, 1.0), 'from 0 to 60'),
        ((SineSeries(2), ZERO, ZERO, 1.0, 0.0, [1.0]), r'shape \(1,\), expected \(2,\)'),
        ((SineSeries(2), ZERO, ZERO, 1.0, 0.0, [1.0, np.nan]), 'varied coefficient'),
    ],
)
def test_mistakes_are_named(arguments, words):
    with pytest.raises(InvalidProblem, match=words):
        TaranenkoReference(*arguments)


def test_a_condition_that_always_holds_is_no_contradiction():
    x = TaranenkoReference(SineSeries(3), {0: 0.0, 2: 0.0}, {0: 1.0}, 1.0)
    assert len(x.varied_indices) == 3
