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
from tdm_planner.direct_method.polynomial import PolynomialBasis, PolynomialReference
from tdm_planner.exceptions import InvalidProblem

VALUES = st.floats(-1e3, 1e3).filter(lambda v: v == 0 or abs(v) > 1e-6)


@st.composite
def conditions(draw):
    """Consecutive derivatives at both ends, order up to 11, span from 1e-3 to 1e3."""
    at_start, at_end = draw(st.integers(1, 6)), draw(st.integers(1, 6))
    span = 10 ** draw(st.floats(-3, 3))
    start = {k: draw(VALUES) / span**k for k in range(at_start)}
    end = {k: draw(VALUES) / span**k for k in range(at_end)}
    return start, end, span, draw(st.floats(-10, 10))


@given(conditions())
@settings(deadline=None, max_examples=200, derandomize=True)
def test_every_boundary_condition_holds(given_conditions):
    start, end, span, tau_0 = given_conditions
    x = PolynomialReference(start, end, tau_0 + span, tau_0)
    assert x.order == len(start) + len(end) - 1
    for tau, wanted in ((x.tau_0, start), (x.tau_f, end)):
        for k, value in wanted.items():
            assert x(tau, k) == pytest.approx(value, rel=1e-10, abs=0 if value else 1e-300)


@given(conditions())
@settings(deadline=None, max_examples=60, derandomize=True)
def test_derivatives_are_those_of_the_values(given_conditions):
    """Each derivative, fitted through the values of the one below, by an independent library."""
    start, end, span, tau_0 = given_conditions
    x = PolynomialReference(start, end, tau_0 + span, tau_0)
    s = 0.5 - 0.5 * np.cos(np.pi * np.arange(x.order + 1) / max(x.order, 1))
    nodes = x.tau_0 + span * s
    fitted = Polynomial.fit(s, x(nodes), x.order, domain=[0, 1])
    probe = np.linspace(0, 1, 7)
    for k in (1, 2):
        expected = fitted.deriv(k)(probe) / span**k
        scale = np.abs(x(nodes)).max() / span**k
        np.testing.assert_allclose(
            x(x.tau_0 + span * probe, k), expected, rtol=1e-6, atol=1e-8 * scale + 1e-30
        )


def test_the_quintic_solves_the_papers_equation_4():
    """Row by row the corrected system (4), solved here in raw tau for a tame span."""
    tf = 1.7
    matrix = np.array(
        [
            [1, 0, 0, 0, 0, 0],
            [0, 1, 0, 0, 0, 0],
            [0, 0, 1, 0, 0, 0],
            [1, tf, tf**2 / 2, tf**3 / 6, tf**4 / 12, tf**5 / 20],
            [0, 1, tf, tf**2 / 2, tf**3 / 3, tf**4 / 4],
            [0, 0, 1, tf, tf**2, tf**3],
        ]
    )
    data = np.array([0.3, -1.0, 2.0, 1.5, 0.4, -0.7])
    a = np.linalg.solve(matrix, data)
    tau = np.linspace(0, tf, 11)
    second = a[2] + a[3] * tau + a[4] * tau**2 + a[5] * tau**3
    x = PolynomialReference(dict(enumerate(data[:3])), dict(enumerate(data[3:])), tf)
    np.testing.assert_allclose(x(tau, 2), second, atol=1e-11)


def test_vector_values_and_jacobian():
    start = {0: [0.0, 1.0], 1: [0.5, 0.0]}
    end = {0: [2.0, -1.0], 1: [0.0, 0.0], 3: [1.0, 2.0]}
    tau = np.linspace(0, 2, 5)
    x = PolynomialReference(start, end, 2.0)
    assert x(tau, 1).shape == (5, 2)
    assert x(1.0).shape == (2,)
    data = np.array([*start.values(), *end.values()])
    for k in range(4):
        np.testing.assert_allclose(x.jacobian(tau, k) @ data, x(tau, k), atol=1e-12)


def test_lacunary_conditions():
    """A free slope with given curvature at the end: x'' given, x' left out."""
    x = PolynomialReference({0: 0.0, 1: 1.0}, {0: 1.0, 2: 0.0}, 1.0)
    assert x(1.0, 2) == pytest.approx(0, abs=1e-12)
    assert x(1.0) == pytest.approx(1)


def test_the_basis_is_made_once():
    assert PolynomialBasis.of((0, 1), (0, 1)) is PolynomialBasis.of((0, 1), (0, 1))


@pytest.mark.parametrize(
    ('start', 'end', 'tau_f', 'words'),
    [
        ({0: 1.0}, {0: 0.0}, 0.0, 'tau_f = 0'),
        ({0: 1.0}, {0: 0.0}, float('nan'), 'tau_f = nan'),
        ({0: float('nan')}, {0: 0.0}, 1.0, 'not a finite number'),
        ({1: 1.0}, {1: 0.0}, 1.0, 'do not determine'),
        ({}, {}, 1.0, 'at least one'),
        ({0: [1.0, 2.0]}, {0: [1.0, 2.0, 3.0]}, 1.0, 'share a shape'),
        ({-1: 1.0}, {0: 0.0}, 1.0, 'from 0 to'),
    ],
)
def test_bad_conditions_are_named(start, end, tau_f, words):
    with pytest.raises(InvalidProblem, match=words):
        PolynomialReference(start, end, tau_f)
