# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""From a stated problem to a nonlinear program and its derivatives; compiled replays."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest
from tdm_planner.direct_method import Budget, Duration, Formulation, Integrated, Output, SineSeries
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.flight import Flown
from tdm_planner.direct_method.nonlinear_program import Multipliers
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.virtual_arc import chebyshev_nodes, quadrature_weights
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from tdm_planner.verification import fly


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


def test_states_and_controls_are_derivatives_by_time(program):
    """A spline through the positions over time has the velocities and accelerations found."""
    from scipy.interpolate import make_interp_spline

    fine = Transcription(program.formulation, np.linspace(0, 1, 401))
    motion = fine.motion(changed(program))
    spline = make_interp_spline(motion.times, motion.states[:, 0], k=7)
    inner = slice(20, -20)
    t = motion.times[inner]
    np.testing.assert_allclose(spline(t, 1), motion.states[inner, 1], atol=1e-6)
    np.testing.assert_allclose(spline(t, 2), motion.controls[inner, 0], atol=1e-4)


def test_derivatives_agree_with_differences(program):
    """First those of all rows, then those of the Lagrangian's gradient, at random multipliers."""
    xi, rng, step = changed(program), np.random.default_rng(4), 1e-6
    point = program.evaluate(xi)
    at = program.linearise(point, None)
    values = point.cache[0]
    ends, limits = 1, values.size - 2
    multipliers = Multipliers(rng.normal(size=ends), rng.random(limits), np.arange(limits))
    jacobian, hessian = program.derivatives(point, multipliers)

    def lagrangian(at):
        rows, _ = program.derivatives(at, multipliers)
        return rows[0] + multipliers.equalities @ rows[1:2] - multipliers.inequalities @ rows[2:]

    for k in range(program.size):
        moved = [program.evaluate(xi + sign * step * np.eye(program.size)[k]) for sign in (1, -1)]
        slope = (moved[0].cache[0] - moved[1].cache[0]) / (2 * step)
        scale = 1 + np.abs(slope).max()
        np.testing.assert_allclose(jacobian[:, k], slope, atol=1e-7 * scale)
        assert at.gradient[k] == jacobian[0, k]
        bend = (lagrangian(moved[0]) - lagrangian(moved[1])) / (2 * step)
        np.testing.assert_allclose(hessian[:, k], bend, atol=1e-6 * (1 + np.abs(bend).max()))
    np.testing.assert_array_equal(at.inequality_jacobian, jacobian[2:][at.tags])
    assert (np.linalg.eigvalsh(at.hessian) > 0).all()


def test_a_first_guess_is_fitted():
    def first_guess(self, s):
        return {'x': 0.2 + 0.8 * s + 0.7 * np.sin(np.pi * s) ** 2}

    guessed = type('Guessed', (Pendulum,), {'first_guess': first_guess})()
    program = Transcription(guessed, chebyshev_nodes(41))
    x = program.motion(program.first_guess).states[:, 0]
    wanted = first_guess(guessed, program.nodes)['x']
    plain = Transcription(Pendulum(), chebyshev_nodes(41))
    straight = plain.motion(plain.first_guess).states[:, 0]
    assert np.abs(x - wanted).max() < 0.2 * np.abs(straight - wanted).max()


def test_a_reserve_is_kept_whatever_was_asked_before():
    formulation = type('Kept', (Pendulum,), {'reserve': {'force': 0.99}})()
    plain, kept = (
        Transcription(f, chebyshev_nodes(41), trace=Trace.of(CheckedFormulation(f)))
        for f in (Pendulum(), formulation)
    )
    xi = plain.first_guess
    assert plain.evaluate(xi).violations[1] == 0.0
    assert kept.evaluate(xi).violations[1] > 0.1


def test_quadrature_is_exact_for_polynomials_and_that_of_a_spline_on_other_nodes():
    nodes = chebyshev_nodes(12)
    for power in range(12):
        assert quadrature_weights(nodes) @ nodes**power == pytest.approx(1 / (power + 1))
    nodes = np.linspace(0, 1, 101)
    assert quadrature_weights(nodes) @ np.exp(nodes) == pytest.approx(np.e - 1, rel=1e-8)


class Damped(Formulation):
    """A damped pendulum, whose `damping` makes it as stiff as one likes."""

    state_names: ClassVar = ('angle', 'rate')
    state_units: ClassVar = ('rad', 'rad/s')
    control_names: ClassVar = ('torque',)
    control_units: ClassVar = ('1/s^2',)
    damping = 0.1

    def outputs(self):
        return {'angle': Output((0.3, 0.0), (1.0, 0.0), free=1)}

    def duration(self):
        return Duration(2.0)

    def invert(self, y, z):
        angle, rate, acceleration = y['angle']
        return (angle, rate), (acceleration + 9.81 * np.sin(angle) + self.damping * rate,)

    def derivative(self, x, u):
        return x[1], u[0] - 9.81 * np.sin(x[0]) - self.damping * x[1]

    def final_cost(self, t, x):
        return t


class Escaping(Damped):
    """A plant that is at infinity before long."""

    def invert(self, y, z):
        angle, rate, acceleration = y['angle']
        return (angle, rate), (acceleration - rate**3,)

    def derivative(self, x, u):
        return x[1], u[0] + x[1] ** 3


def plan(intervals, interpolation='linear', size=20.0):
    controls = size * np.random.default_rng(0).normal(size=(intervals + 1, 1))
    times = to_nanoseconds(np.linspace(0.0, 2.0, intervals + 1))
    return Trajectory.of(
        Damped, times, np.tile([0.3, -0.5], (intervals + 1, 1)), controls, interpolation
    )


class Plain(DirectPlant):
    """It is left to scipy."""

    def fly(self, trajectory, until):
        return None


@pytest.mark.parametrize('interpolation', ['linear', 'zero_order_hold'])
@pytest.mark.parametrize('intervals', [1, 5, 40])
@pytest.mark.parametrize('damping', [0.1, 300.0])
def test_it_flies_as_scipy_does(intervals, damping, interpolation):
    pendulum = type('Damped', (Damped,), {'damping': damping})()
    trajectory, times = plan(intervals, interpolation), np.linspace(0.0, 2.0, 777)
    compiled, plain = (fly(plant(pendulum), trajectory) for plant in (DirectPlant, Plain))
    assert isinstance(compiled, Flown)
    assert len(plain.pieces) == intervals
    np.testing.assert_allclose(compiled.states(times), plain.states(times), rtol=0, atol=1e-6)
    assert set(trajectory.times) <= set(compiled.steps)


def test_a_plan_that_cannot_be_flown_is_left_to_scipy():
    trajectory = plan(4, size=5.0)
    compiled, plain = (fly(plant(Escaping()), trajectory) for plant in (DirectPlant, Plain))
    times = trajectory.times
    np.testing.assert_allclose(compiled.states(times), plain.states(times), rtol=1e-9)
    assert np.isnan(compiled.states(times)).any()


def test_cubic_controls_and_a_spent_budget_are_left_to_scipy():
    plant = DirectPlant(Damped())
    assert plant.fly(plan(4, 'cubic'), None) is None
    assert plant.fly(plan(4), Budget(0.0)) is None
