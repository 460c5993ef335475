# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import quad
from tdm_planner.direct_method import (
    arc_derivatives,
    path_speed,
    PolynomialReference,
    ReferenceFunction,
    SpeedFactor,
    time_derivatives,
    TimeFactor,
)
from tdm_planner.exceptions import InvalidProblem

COEFFICIENTS = st.lists(st.floats(0.05, 20.0), min_size=1, max_size=6)


@given(st.floats(-60, 60), st.floats(-60, 60), st.floats(0.0, 1.0))
@settings(max_examples=60)
def test_time_of_a_linear_speed_factor_over_many_orders_of_magnitude(low, high, share):
    first, last = 10.0**low, 10.0**high
    factor = SpeedFactor([first, last], 1.0)
    for tau in (share, 1.0):
        change = (last - first) * tau
        ratio = (first * (1.0 - tau) + last * tau) / first
        logarithm = math.log(ratio) if abs(ratio - 1) > 0.5 else math.log1p(change / first)
        expected = tau * logarithm / change if abs(change) > 1e-12 * first else tau / first
        assert float(factor.time(tau)) == pytest.approx(expected, rel=1e-11)


@given(st.lists(st.floats(-8, 8), min_size=1, max_size=9))
@settings(max_examples=30)
def test_duration_with_whatever_coefficients_is_that_of_adaptive_quadrature(exponents):
    coefficients = 10.0 ** np.array(exponents)
    degree = coefficients.size - 1
    counts = [math.comb(degree, i) for i in range(degree + 1)]

    def integrand(z):  # s = 1/(1 + exp(-z)) draws both ends of the arc apart
        s, rest = 1.0 / (1.0 + np.exp(-z)), 1.0 / (1.0 + np.exp(z))
        terms = [n * c * s**i for i, (n, c) in enumerate(zip(counts, coefficients, strict=True))]
        return s * rest / sum(t * rest ** (degree - i) for i, t in enumerate(terms))

    expected = sum(quad(integrand, z, z + 4, epsabs=0)[0] for z in range(-80, 80, 4))
    assert SpeedFactor(coefficients, 1.0).duration == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize('kind', [SpeedFactor, TimeFactor])
@pytest.mark.parametrize('coefficients', [[1e-12, 1.0], [1.0, 1e-8, 1e-8, 1.0], [1e-6, 1e6, 1e-3]])
def test_arc_is_found_again_though_the_speed_varies_by_orders_of_magnitude(kind, coefficients):
    factor = kind(coefficients, 2.0)
    times = np.linspace(0.0, factor.duration, 33)
    found = factor.arc_at(times)
    np.testing.assert_allclose(factor.time(found), times, atol=1e-9 * factor.duration)


@pytest.mark.parametrize('kind', [SpeedFactor, TimeFactor])
@given(coefficients=COEFFICIENTS, span=st.floats(0.1, 50.0))
@settings(max_examples=40)
def test_time_and_its_inverse(kind, coefficients, span):
    factor = kind(coefficients, 2.0 + span, 2.0)
    tau = np.linspace(2.0, 2.0 + span, 17)
    times = factor.time(tau)
    assert (factor(tau) > 0).all()
    assert (np.diff(times) > 0).all()
    np.testing.assert_allclose(factor.arc_at(times), tau, rtol=1e-9)
    step = 1e-5 * span
    inner = tau[1:-1]
    slope = (factor.time(inner + step) - factor.time(inner - step)) / (2 * step)
    np.testing.assert_allclose(slope * factor(inner), 1.0, rtol=1e-5)
    for order in (1, 2):
        below = (factor(inner + step, order - 1) - factor(inner - step, order - 1)) / (2 * step)
        scale = np.abs(factor(tau)).max() / span**order
        np.testing.assert_allclose(factor(inner, order), below, atol=2e-3 * scale, rtol=1e-3)


@pytest.mark.parametrize('order', range(4))
def test_jacobian_of_the_time_factor(order):
    factor = TimeFactor([1.0, 2.0, 4.0, 0.5], 3.0, 1.0)
    assert isinstance(factor, ReferenceFunction)
    tau = np.linspace(1, 3, 5)
    for column, change in enumerate(1e-5 * np.eye(4)):
        above, below = (
            TimeFactor(factor.coefficients + sign * change, 3.0, 1.0)(tau, order)
            for sign in (1, -1)
        )
        scale = np.abs(factor.jacobian(tau, order)).max()
        found = factor.jacobian(tau, order)[:, column]
        np.testing.assert_allclose(found, (above - below) / 2e-5, atol=1e-7 * scale)


@pytest.mark.parametrize('kind', [SpeedFactor, TimeFactor])
@pytest.mark.parametrize('method', ['__call__', 'jacobian', 'time'])
def test_there_is_no_speed_factor_beyond_the_arc(kind, method):
    factor = kind([1.0, 2.0], 3.0, 1.0)
    for tau in (0.99, 3.01, [2.0, -3.0]):
        with pytest.raises(InvalidProblem, match=r'tau = .* must be in \[1, 3\]'):
            getattr(factor, method)(tau)
    rounding = [1.0 - 1e-12, 3.0 + 1e-12]
    np.testing.assert_array_equal(
        getattr(factor, method)(rounding), getattr(factor, method)([1.0, 3.0])
    )


def test_jacobian_of_the_speed_factor():
    factor = SpeedFactor([1.0, 2.0, 4.0], 2.0)
    tau = np.linspace(0, 2, 5)
    for order in range(3):
        np.testing.assert_allclose(factor.jacobian(tau, order) @ [1, 2, 4], factor(tau, order))


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


@pytest.mark.parametrize('kind', [SpeedFactor, TimeFactor])
def test_motion_along_a_path_has_these_derivatives_by_time(kind):
    """Against a polynomial in time fitted through the motion itself."""
    path = PolynomialReference({0: 1.0, 1: 0.3}, {0: -2.0, 1: 1.0}, 2.0)
    factor = kind([1.0, 0.8, 1.2], 2.0)
    fitted = np.polynomial.Chebyshev.interpolate(
        lambda t: path(factor.arc_at(t)), 40, [0, factor.duration]
    )
    tau = np.linspace(0.1, 1.9, 7)
    jets = time_derivatives([path(tau, k) for k in range(4)], factor.derivatives(tau, 3))
    for order, found in enumerate(jets):
        expected = fitted.deriv(order)(factor.time(tau)) if order else fitted(factor.time(tau))
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(path_speed([path(tau, 1)], factor(tau)), np.abs(jets[1]))
