# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.direct_method import (
    arc_derivatives,
    path_speed,
    PolynomialReference,
    SpeedFactor,
    time_derivatives,
    TimeFactor,
)
from tdm_planner.exceptions import InvalidProblem

COEFFICIENTS = st.lists(st.floats(0.05, 20.0), min_size=1, max_size=6)


def test_time_of_a_linear_speed_factor_is_a_logarithm():
    factor = SpeedFactor([0.5, 3.0], 4.0, 1.0)
    tau = np.linspace(1.0, 4.0, 13)
    slope = 2.5 / 3.0
    expected = np.log((0.5 + slope * (tau - 1.0)) / 0.5) / slope
    np.testing.assert_allclose(factor.time(tau), expected, rtol=1e-12)
    np.testing.assert_allclose(factor(tau), 0.5 + slope * (tau - 1.0))
    np.testing.assert_allclose(factor(tau, 1), slope)
    assert (factor(tau, 2) == 0).all()


def test_time_of_a_polynomial_time_factor_is_exact():
    factor = TimeFactor([1.0, 2.0, 5.0], 3.0)  # mu = 1 + 2 s + 2 s^2
    s = np.linspace(0, 1, 9)
    np.testing.assert_allclose(factor.time(3.0 * s), s + s**2 + 2 / 3 * s**3, rtol=1e-14)
    np.testing.assert_allclose(factor(3.0 * s), 3.0 / (1 + 2 * s + 2 * s**2), rtol=1e-14)
    assert factor.duration == pytest.approx(8 / 3)


@pytest.mark.parametrize('kind', [SpeedFactor, TimeFactor])
@given(coefficients=COEFFICIENTS, span=st.floats(0.1, 50.0))
@settings(deadline=None, max_examples=40, derandomize=True)
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
    # the quadrature's error, some 1e-11 of the time, is divided by the step
    np.testing.assert_allclose(slope * factor(inner), 1.0, rtol=1e-4)
    for order in (1, 2):
        below = (factor(inner + step, order - 1) - factor(inner - step, order - 1)) / (2 * step)
        scale = np.abs(factor(tau)).max() / span**order
        np.testing.assert_allclose(factor(inner, order), below, atol=2e-3 * scale, rtol=1e-3)


def test_time_beyond_the_arc_is_clipped():
    factor = TimeFactor([1.0], 2.0)
    assert factor.arc_at([-1.0, 5.0]).tolist() == [0.0, 2.0]


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
@settings(deadline=None, max_examples=100, derandomize=True)
def test_conversions_round_trip(values, speed, slopes):
    factor = [speed, *slopes]
    there = arc_derivatives(values, factor)
    np.testing.assert_allclose(time_derivatives(there, factor), values, rtol=1e-9, atol=1e-6)


@given(st.lists(st.floats(-5, 5), min_size=4, max_size=4), st.lists(st.floats(-2, 2), max_size=3))
@settings(deadline=None, max_examples=50, derandomize=True)
def test_conversions_are_those_written_out(x, more):
    speed, slope, curvature = [0.7, *more, 0.0, 0.0, 0.0][:3]
    found = time_derivatives(x, [speed, slope, curvature])
    second = speed**2 * x[2] + speed * slope * x[1]
    third = (
        speed**3 * x[3]
        + 3 * speed**2 * slope * x[2]
        + speed * (speed * curvature + slope**2) * x[1]
    )
    np.testing.assert_allclose(found, [x[0], speed * x[1], second, third], rtol=1e-12, atol=1e-12)


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


@pytest.mark.parametrize(
    ('make', 'words'),
    [
        (lambda: SpeedFactor([1.0, 0.0], 1.0), 'coefficient 1 of the speed factor is 0'),
        (lambda: TimeFactor([-1.0, 2.0], 1.0), 'coefficient 0 of the speed factor is -1'),
        (
            lambda: SpeedFactor([1.0, np.nan], 1.0),
            'coefficient of the speed factor has an element nan',
        ),
        (lambda: SpeedFactor([1.0], 0.0), 'must end after it starts'),
        (lambda: SpeedFactor([[1.0]], 1.0), 'shape'),
        (lambda: SpeedFactor([], 1.0), 'shape'),
        (lambda: time_derivatives([0, 1, 2], [1.0]), 'only 1 are given'),
    ],
)
def test_mistakes_are_named(make, words):
    with pytest.raises(InvalidProblem, match=words):
        make()
