# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""From a stated problem to a nonlinear program and its derivatives; compiled replays."""

from __future__ import annotations

from differences import central
import numpy as np
import pytest
from stated import Cart, changed
from tdm_planner.direct_method import Budget, Duration, Integrated, Output, SineSeries
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.flight import Flown
from tdm_planner.direct_method.nonlinear_program import Multipliers
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.virtual_arc import chebyshev_nodes, quadrature_weights
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from tdm_planner.verification import fly

PENDULUM = changed(
    Cart,
    __doc__='Pendulum on a cart: its position is prescribed, the angle integrated.',
    state_names=('x', 'v', 'angle', 'rate'),
    state_units=('m', 'm/s', 'rad', 'rad/s'),
    outputs=lambda s: {'x': Output((0.2, -0.1, 0.3), (1.0, 0.4), free=3)},
    integrated=lambda s: {'angle': Integrated(0.3), 'rate': Integrated(-0.2, 0.0)},
    duration=lambda s: Duration(guess=1.5, speed_factor_order=2),
    invert=lambda s, y, z: ((*y['x'][:2], z['angle'], z['rate']), y['x'][2:]),
    derivative=lambda s, x, u: (x[1], u[0], x[3], -9.81 * np.sin(x[2]) - u[0] * np.cos(x[2])),
    margins=lambda s, t, x, u: {'force': 1.0 - (u[0] / 5.0) ** 2},
    final_cost=lambda s, t, x: t,
)
SINES = {'x': Output((0.2, -0.1), (1.0, 0.4), shapes=SineSeries(5))}
FORMS = {
    'polynomial': PENDULUM,
    'sines': changed(PENDULUM, outputs=lambda s: SINES),
    'tau = t': changed(PENDULUM, duration=lambda s: Duration(guess=1.5)),
}


@pytest.mark.parametrize('form', FORMS.values(), ids=FORMS)
def test_derivatives_agree_with_differences(form):
    """First those of all rows, then those of the Lagrangian's gradient, at random multipliers."""
    program, rng = Transcription(form(), chebyshev_nodes(41)), np.random.default_rng(3)
    program.begin(program.first_guess)
    xi = program.first_guess + 0.2 * rng.normal(size=program.size)
    point = program.evaluate(xi)
    at, limits = program.linearise(point, None), point.cache[0].size - 2
    multipliers = Multipliers(rng.normal(size=1), rng.random(limits), np.arange(limits))
    jacobian, hessian = program.derivatives(point, multipliers)

    def lagrangian(x):
        rows, _ = program.derivatives(program.evaluate(x), multipliers)
        return rows[0] + multipliers.equalities @ rows[1:2] - multipliers.inequalities @ rows[2:]

    rows = central(lambda x: program.evaluate(x).cache[0], xi)
    for found, expected, allowed in (
        (jacobian, rows, 1e-7),
        (hessian, central(lagrangian, xi), 1e-6),
    ):
        scale = 1 + np.abs(expected).max(axis=0)
        np.testing.assert_allclose(found / scale, expected / scale, rtol=1e-7, atol=allowed)
    np.testing.assert_array_equal(at.gradient, jacobian[0])
    np.testing.assert_array_equal(at.inequality_jacobian, jacobian[2:][at.tags])
    assert (np.linalg.eigvalsh(at.hessian) > 0).all()


def test_a_first_guess_is_fitted():
    def first_guess(self, s):
        return {'x': 0.2 + 0.8 * s + 0.7 * np.sin(np.pi * s) ** 2}

    guessed, straight = (
        Transcription(cls(), chebyshev_nodes(41))
        for cls in (changed(PENDULUM, first_guess=first_guess), PENDULUM)
    )
    wanted = first_guess(None, guessed.nodes)['x']
    away = [
        np.abs(program.motion(program.first_guess).states[:, 0] - wanted).max()
        for program in (guessed, straight)
    ]
    assert away[0] < 0.2 * away[1]


def test_a_reserve_is_kept_whatever_was_asked_before():
    plain, kept = (
        Transcription(f, chebyshev_nodes(41), trace=Trace.of(CheckedFormulation(f)))
        for f in (PENDULUM(), changed(PENDULUM, reserve={'force': 0.99})())
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


def damped(damping=0.1):
    """Return a damped pendulum, as stiff as one likes."""
    return changed(
        Cart,
        outputs=lambda s: {'x': Output((0.3, 0.0), (1.0, 0.0), free=1)},
        duration=lambda s: Duration(2.0),
        invert=lambda s, y, z: (
            y['x'][:2],
            (y['x'][2] + 9.81 * np.sin(y['x'][0]) + damping * y['x'][1],),
        ),
        derivative=lambda s, x, u: (x[1], u[0] - 9.81 * np.sin(x[0]) - damping * x[1]),
    )()


ESCAPING = changed(
    Cart,
    __doc__='A plant that is at infinity before long.',
    invert=lambda s, y, z: (y['x'][:2], (y['x'][2] - y['x'][1] ** 3,)),
    derivative=lambda s, x, u: (x[1], u[0] + x[1] ** 3),
)


def plan(intervals, interpolation='linear', size=20.0):
    controls = size * np.random.default_rng(0).normal(size=(intervals + 1, 1))
    times = to_nanoseconds(np.linspace(0.0, 2.0, intervals + 1))
    states = np.tile([0.3, -0.5], (intervals + 1, 1))
    return Trajectory.of(Cart, times, states, controls, interpolation)


class Plain(DirectPlant):
    """It is left to scipy."""

    def fly(self, trajectory, until):
        return None


@pytest.mark.parametrize('interpolation', ['linear', 'zero_order_hold'])
@pytest.mark.parametrize('intervals', [1, 5, 40])
@pytest.mark.parametrize('damping', [0.1, 300.0])
def test_it_flies_as_scipy_does(intervals, damping, interpolation):
    pendulum = damped(damping)
    trajectory, times = plan(intervals, interpolation), np.linspace(0.0, 2.0, 777)
    compiled, plain = (fly(plant(pendulum), trajectory) for plant in (DirectPlant, Plain))
    assert isinstance(compiled, Flown)
    assert len(plain.pieces) == intervals
    np.testing.assert_allclose(compiled.states(times), plain.states(times), rtol=0, atol=1e-6)
    assert set(trajectory.times) <= set(compiled.steps)


def test_what_cannot_be_flown_cubic_controls_and_a_spent_budget_are_left_to_scipy():
    trajectory = plan(4, size=5.0)
    compiled, plain = (fly(plant(ESCAPING()), trajectory) for plant in (DirectPlant, Plain))
    times = trajectory.times
    np.testing.assert_allclose(compiled.states(times), plain.states(times), rtol=1e-9)
    assert np.isnan(compiled.states(times)).any()
    plant = DirectPlant(damped())
    assert plant.fly(plan(4, 'cubic'), None) is None
    assert plant.fly(plan(4), Budget(0.0)) is None
