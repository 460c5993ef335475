# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""From a stated problem to a nonlinear program, and how its functions are differentiated."""

from typing import ClassVar

import numpy as np
import pytest
from tdm_planner.direct_method import (
    Budget,
    Duration,
    Formulation,
    Integrated,
    Output,
    SineSeries,
    Transcription,
    transcription,
)
from tdm_planner.direct_method.arc_nodes import chebyshev_nodes, quadrature_weights
from tdm_planner.direct_method.differentiation import absolute, arctan2, choose_scheme, jacobians


class Pendulum(Formulation):
    """Pendulum on a cart: the cart's position is prescribed, the angle integrated."""

    state_names: ClassVar = ('x', 'v', 'angle', 'rate')
    state_units: ClassVar = ('m', 'm/s', 'rad', 'rad/s')
    control_names: ClassVar = ('u',)
    control_units: ClassVar = ('m/s^2',)
    speed_factor_order = 2
    shapes = None

    def outputs(self):
        start, end = (0.2, -0.1, 0.3), (1.0, 0.4)
        if self.shapes is not None:
            return {'x': Output(start[:2], end, shapes=self.shapes)}
        return {'x': Output(start, end, free=3)}

    def integrated(self):
        return {'angle': Integrated(0.3), 'rate': Integrated(-0.2, 0.0)}

    def duration(self):
        return Duration(guess=1.5, speed_factor_order=self.speed_factor_order)

    def invert(self, y, z):
        x, v, u = y['x']
        return (x, v, z['angle'], z['rate']), (u,)

    def derivative(self, x, u):
        return x[1], u[0], x[3], -9.81 * np.sin(x[2]) - u[0] * np.cos(x[2])

    def margins(self, t, x, u):
        return {'force': 1.0 - (u[0] / 5.0) ** 2}

    def final_cost(self, t, x):
        return t

    def running_cost(self, t, x, u):
        return u[0] ** 2


@pytest.fixture(params=['polynomial', 'sines', 'tau = t'])
def program(request):
    formulation = Pendulum()
    formulation.shapes = SineSeries(5) if request.param == 'sines' else None
    formulation.speed_factor_order = 0 if request.param == 'tau = t' else 2
    made = Transcription(formulation, chebyshev_nodes(41))
    made.begin(made.first_guess)
    return made


def changed(program):
    rng = np.random.default_rng(3)
    return program.first_guess + 0.2 * rng.normal(size=program.size)


def test_boundary_conditions_hold_by_time_whatever_is_varied(program):
    motion = program.motion(changed(program)[None])
    np.testing.assert_allclose(motion.states[0, 0], [0.2, -0.1, 0.3, -0.2], atol=1e-9)
    np.testing.assert_allclose(motion.states[0, -1, :2], [1.0, 0.4], atol=1e-9)
    if program.formulation.shapes is None:
        assert motion.controls[0, 0, 0] == pytest.approx(0.3, abs=1e-8)


def test_states_and_controls_are_derivatives_by_time(program):
    """A spline through the positions over time has the velocities and accelerations found."""
    from scipy.interpolate import make_interp_spline

    fine = Transcription(program.formulation, np.linspace(0, 1, 401))
    motion = fine.motion(changed(program)[None])
    spline = make_interp_spline(motion.times[0], motion.states[0, :, 0], k=7)
    inner = slice(20, -20)
    t = motion.times[0, inner]
    np.testing.assert_allclose(spline(t, 1), motion.states[0, inner, 1], atol=1e-6)
    np.testing.assert_allclose(spline(t, 2), motion.controls[0, inner, 0], atol=1e-4)


def test_integration_converges_with_the_fourth_order():
    ends = []
    for count in (21, 41, 81, 641):
        program = Transcription(Pendulum(), chebyshev_nodes(count))
        ends.append(program.motion(changed(program)[None]).states[0, -1, 2:])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert errors[0] / errors[1] > 10
    assert errors[1] / errors[2] > 10


def test_jacobian_agrees_with_differences(program):
    xi = changed(program)
    at = program.linearise(program.evaluate(xi), None)
    assert program.scheme == 'complex_step'
    step = 1e-6
    for k in range(program.size):
        moved = [program.evaluate(xi + sign * step * np.eye(program.size)[k]) for sign in (1, -1)]
        slope = (moved[0].cache - moved[1].cache) / (2 * step)
        scale = 1 + np.abs(slope).max()
        assert at.gradient[k] == pytest.approx(slope[0], abs=1e-6 * scale)
        np.testing.assert_allclose(at.equality_jacobian[:, k], slope[1:2], atol=1e-6 * scale)
        rows = at.inequality_jacobian[:, k]
        np.testing.assert_allclose(rows, slope[2:][at.tags], atol=1e-6 * scale)
    assert (np.linalg.eigvalsh(at.hessian) > 0).all()


def test_quadrature_is_exact_for_polynomials_and_that_of_a_spline_on_other_nodes():
    nodes = chebyshev_nodes(12)
    for power in range(12):
        assert quadrature_weights(nodes) @ nodes**power == pytest.approx(1 / (power + 1))
    nodes = np.linspace(0, 1, 101)
    assert quadrature_weights(nodes) @ np.exp(nodes) == pytest.approx(np.e - 1, rel=1e-8)


def test_no_time_is_spent_on_a_hessian_past_the_deadline(program):
    xi = changed(program)
    point = program.evaluate(xi)
    in_time = program.linearise(point, None)
    program.budget = Budget(0.0)
    before = program.evaluations
    late = program.linearise(point, None)
    assert program.evaluations - before == program.size  # the Jacobian alone
    np.testing.assert_array_equal(late.gradient, in_time.gradient)


def test_the_hessian_is_the_same_in_batches(program, monkeypatch):
    point = program.evaluate(changed(program))
    at_once = program.linearise(point, None).hessian
    monkeypatch.setattr(transcription, '_HESSIAN_BATCH', 1)
    np.testing.assert_allclose(program.linearise(point, None).hessian, at_once, atol=1e-9)


POINTS = np.array([[0.3, -1.2], [2.0, 0.5]])


def smooth(x):
    return np.stack([np.sin(x[:, 0]) * x[:, 1], np.exp(x[:, 0]), x[:, 1] ** 3], axis=1)


@pytest.mark.parametrize(('scheme', 'accuracy'), [('complex_step', 1e-15), ('central', 1e-8)])
def test_both_schemes(scheme, accuracy):
    assert choose_scheme(smooth, POINTS[0]) == 'complex_step'
    found = jacobians(smooth, POINTS, scheme)
    expected = [[[np.cos(x) * y, np.sin(x)], [np.exp(x), 0.0], [0.0, 3 * y**2]] for x, y in POINTS]
    np.testing.assert_allclose(found, expected, atol=10 * accuracy)


@pytest.mark.parametrize(
    'function', [lambda x: np.abs(x), lambda x: np.arctan2(x, 1.0), lambda x: np.real(x) ** 2]
)
def test_differences_where_it_does_not(function):
    assert choose_scheme(function, POINTS[0]) == 'central'


def test_functions_that_let_a_complex_step_pass():
    def function(x):
        return np.stack([arctan2(x[:, 1], x[:, 0]), absolute(x[:, 1])], axis=1)

    assert choose_scheme(function, POINTS[0]) == 'complex_step'
    x, y = POINTS[0]
    square = x**2 + y**2
    expected = [[-y / square, x / square], [0.0, -1.0]]
    np.testing.assert_allclose(jacobians(function, POINTS[:1], 'complex_step')[0], expected)
    assert arctan2(-1.0, -1.0) == np.arctan2(-1.0, -1.0)
    np.testing.assert_array_equal(absolute(np.array([-2.0, 3.0])), [2.0, 3.0])
