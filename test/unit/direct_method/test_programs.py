# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Nonlinear programs: made of a stated problem, and minimised; compiled replays."""

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from replays import by_scipy, central
from scipy.optimize import rosen, rosen_der, rosen_hess
from stated import Cart, changed, forced
from tdm_planner.direct_method import Budget, Duration, Formulation, Integrated, Output, SineSeries
from tdm_planner.direct_method import nonlinear_program as programs
from tdm_planner.direct_method.bases import chebyshev_nodes, quadrature_weights
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation_program import CollocationProgram
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.trust_region import (
    minimise,
    solve_quadratic_program,
    TrustRegionOptions,
)
from tdm_planner.exceptions import DeadlineExceeded, NotFinite
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.trajectory import lines, to_nanoseconds, Trajectory

PENDULUM = changed(
    Formulation,  # no dataclass
    __doc__='Pendulum on a cart: its position is prescribed, the angle integrated.',
    states={'x': 'm', 'v': 'm/s', 'angle': 'rad', 'rate': 'rad/s'},
    controls={'u': 'm/s^2'},
    running_cost=Cart.running_cost,
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
TIGHT = TrustRegionOptions((30.0,), iterations=200, cost_tolerance=1e-12, feasibility=(1e-9,))
TIGHT = TIGHT._replace(corrections=4)


@pytest.mark.parametrize('form', FORMS.values(), ids=FORMS)
def test_derivatives_agree_with_differences(form):
    """First those of all rows, then those of the Lagrangian's gradient, at random multipliers."""
    program, rng = Transcription(form(), chebyshev_nodes(41)), np.random.default_rng(3)
    program.begin(program.first_guess)
    xi = program.first_guess + 0.2 * rng.normal(size=program.size)
    point = program.evaluate(xi)
    at, limits = program.linearise(point, None), point.cache[0].size - 2
    multipliers = programs.Multipliers(rng.normal(size=1), rng.random(limits), np.arange(limits))
    jacobian, hessian = program.derivatives(point, multipliers)

    def lagrangian(x):
        rows, _ = program.derivatives(program.evaluate(x), multipliers)
        return rows[0] + multipliers.equalities @ rows[1:2] - multipliers.inequalities @ rows[2:]

    rows, slopes = (central(of, xi) for of in (lambda x: program.evaluate(x).cache[0], lagrangian))
    for found, expected, allowed in ((jacobian, rows, 1e-7), (hessian, slopes, 1e-6)):
        scale = 1 + np.abs(expected).max(axis=0)
        np.testing.assert_allclose(found / scale, expected / scale, rtol=1e-7, atol=allowed)
    motion = program.motion(xi)
    assert motion.states[[0, -1], :2] == pytest.approx(np.array([[0.2, -0.1], [1.0, 0.4]]))
    assert form is FORMS['sines'] or motion.controls[0, 0] == pytest.approx(0.3)
    np.testing.assert_array_equal(at.gradient, jacobian[0])
    np.testing.assert_array_equal(at.inequality_jacobian, jacobian[2:][at.tags])
    assert (np.linalg.eigvalsh(at.hessian) > 0).all()


def test_a_program_of_pieces_has_the_derivatives_that_casadi_finds_for_the_whole():
    form = changed(
        PENDULUM,
        margins=lambda s, t, x, u: {
            'force': 1.0 - (u[0] / 5.0) ** 2,
            'track': 2.0 - x[0],
            'stop': 3.0 + 2.0 * x[0] - t,
            'fast': 4.0 - np.abs(x[1]),
        },
    )
    program = CollocationProgram(Trace.of(CheckedFormulation(form())), 5)
    z, p, f, g = (program.nlp[name] for name in 'xpfg')
    rng = np.random.default_rng(4)
    at, numbers = (rng.uniform(0.5, 1.5, size=part.numel()) for part in (z, p))
    weights = rng.normal(size=g.numel())
    lagrangian = 0.7 * f + ca.dot(weights, g)
    whole = {
        'grad_f': ca.gradient(f, z),
        'jac_g': ca.jacobian(g, z),
        'hess_lag': ca.triu(ca.hessian(lagrangian, z)[0]),
    }
    given = {'hess_lag': (at, numbers, 0.7, weights)}
    for name, matrix in whole.items():
        expected = np.array(ca.Function(name, [z, p], [matrix])(at, numbers))
        *_, found = program.derivatives[name].call(given.get(name, (at, numbers)))
        np.testing.assert_allclose(np.array(found), expected, rtol=1e-9, atol=1e-9)


def test_a_first_guess_is_fitted():
    def first_guess(self, s):
        return {'x': 0.2 + 0.8 * s + 0.7 * np.sin(np.pi * s) ** 2}

    def away(form):
        program = Transcription(form(), chebyshev_nodes(41))
        wanted = first_guess(None, program.nodes)['x']
        return np.abs(program.motion(program.first_guess).states[:, 0] - wanted).max()

    assert away(changed(PENDULUM, first_guess=first_guess)) < 0.2 * away(PENDULUM)


def test_a_reserve_is_kept_whatever_was_asked_before():
    plain, kept = (
        Transcription(f, chebyshev_nodes(41), trace=Trace.of(CheckedFormulation(f)))
        for f in (PENDULUM(), changed(PENDULUM, reserve={'force': 0.99})())
    )
    xi = plain.first_guess
    assert plain.evaluate(xi).violations[1] == 0.0
    assert kept.evaluate(xi).violations[1] > 0.1


def test_quadrature_is_exact_for_polynomials():
    nodes = chebyshev_nodes(12)
    for power in range(12):
        assert quadrature_weights(nodes) @ nodes**power == pytest.approx(1 / (power + 1))


def damped(damping=0.1):
    return changed(
        Cart,
        outputs=lambda s: {'x': Output((0.3, 0.0), (1.0, 0.0), free=1)},
        duration=lambda s: Duration(2.0),
        **forced(lambda x, v: -9.81 * np.sin(x) - damping * v),
    )()


ESCAPING = changed(Cart, **forced(lambda x, v: v**3))


def plan(intervals, interpolation='linear', size=20.0):
    controls = size * np.random.default_rng(0).normal(size=(intervals + 1, 1))
    times = to_nanoseconds(np.linspace(0.0, 2.0, intervals + 1))
    states = np.tile([0.3, -0.5], (intervals + 1, 1))
    return Trajectory.of(Cart, times, states, controls, interpolation)


def test_a_motion_shorter_than_a_nanosecond_is_none():
    plant = DirectPlant(damped(0.1))
    with np.errstate(all='ignore'):
        held = lines(np.zeros(3), np.zeros((3, 1)))
    assert plant.trace.integrator(held, np.zeros(2), plant.numbers) is None


@pytest.mark.parametrize('interpolation', ['linear', 'zero_order_hold', 'cubic'])
@pytest.mark.parametrize('intervals', [1, 5, 40])
@pytest.mark.parametrize('damping', [0.1, 300.0])
def test_it_flies_as_scipy_does(intervals, damping, interpolation):
    plant, times = DirectPlant(damped(damping)), np.linspace(0.0, 2.0, 777)
    trajectory = plan(intervals, interpolation)
    compiled, plain = plant.replay(trajectory), by_scipy(plant, trajectory)
    np.testing.assert_allclose(compiled.states(times), plain.states(times), rtol=0, atol=1e-6)
    assert set(trajectory.times) <= set(compiled.steps)


def test_what_cannot_be_flown_or_takes_too_long_is_told():
    with pytest.raises(NotFinite, match='not finite everywhere'):
        DirectPlant(ESCAPING()).replay(plan(4, size=5.0))
    with pytest.raises(DeadlineExceeded, match='longer than 0 s'):
        DirectPlant(damped()).replay(plan(4), Budget(0.0))


def random_program(seed, feasible=True):
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 9), rng.integers(0, 15)
    root = rng.normal(size=(n, n))
    hessian = root @ root.T + 10.0 ** rng.uniform(-4, 0) * np.eye(n)
    rows, inside = rng.normal(size=(m, n)), rng.normal(size=n)
    if m > 4:
        rows[1] = -rows[0]  # both sides of one
        rows[3] = rows[2]
    slack = rng.uniform(0.0, 1.0, size=m) * rng.integers(0, 2, size=m)
    least = rows @ inside - slack
    if not feasible:
        rows, least = np.vstack([rows, rows[:1], -rows[:1]]), np.append(least, [1.0, 1.0])
    wide = rng.uniform(0.0, 2.0, size=(2, n))
    lower, upper = inside - wide[0], inside + wide[1]
    lower[rng.uniform(size=n) < 0.3], upper[rng.uniform(size=n) < 0.3] = -1e12, 1e12
    return hessian, 3.0 * rng.normal(size=n), rows, least, lower, upper


@given(st.integers(0, 10**6))
@settings(max_examples=200)
def test_the_minimum_of_a_quadratic_program_is_optimal(seed):
    program = random_program(seed)
    hessian, gradient, rows, least, lower, upper = program
    x, multipliers = solve_quadratic_program(*program)
    scale = 1.0 + np.abs(x).max()
    assert (rows @ x >= least - 1e-8 * scale).all()
    assert (x >= lower - 1e-8 * scale).all()
    assert (x <= upper + 1e-8 * scale).all()
    assert (multipliers >= 0.0).all()
    size = 1.0 + np.abs(multipliers).max(initial=0.0)
    assert np.abs(multipliers * (rows @ x - least)).max(initial=0.0) < 1e-7 * scale * size
    # What is left of the gradient is the bounds' share, of the right sign, at the bounds only.
    left = hessian @ x + gradient - rows.T @ multipliers
    at_lower, at_upper = x < lower + 1e-7 * scale, x > upper - 1e-7 * scale
    assert (left[~at_upper] > -1e-6 * size * scale).all()
    assert (left[~at_lower] < 1e-6 * size * scale).all()


def test_what_has_no_minimum_is_noticed():
    for seed in range(20):
        program = random_program(seed, feasible=False)
        if len(program[2]) > 2:
            assert solve_quadratic_program(*program) is None
    free = np.zeros((0, 2)), np.zeros(0), np.full(2, -1e12), np.full(2, 1e12)
    assert solve_quadratic_program(np.diag([1.0, -1.0]), np.ones(2), *free) is None


class Smooth(programs.NonlinearProgram):
    """J, c = 0 and their derivatives as functions; Hessian of the Lagrangian clipped."""

    lower, upper = np.full(2, -1e6), np.full(2, 1e6)
    evaluations = 0

    def __init__(self, cost, grad, hess, eq=None, curvature=None):
        self.functions = cost, grad, hess
        self.eq, self.eq_jac = eq or ((lambda x: np.zeros(0)), (lambda x: np.zeros((0, 2))))
        self.curvature = curvature or (lambda x, multipliers: np.zeros((2, 2)))

    def evaluate(self, xi):
        self.evaluations += 1
        missed, cost = self.eq(xi), float(self.functions[0](xi))
        worst = np.array([np.abs(missed).max(initial=0)])
        return programs.Point(xi, cost, worst, equalities=missed)

    def linearise(self, point, multipliers):
        x = point.xi
        hessian = self.functions[2](x)
        if multipliers is not None:
            hessian = hessian - self.curvature(x, multipliers)
        values, vectors = np.linalg.eigh(hessian)
        hessian = (vectors * np.maximum(np.abs(values), 1e-3)) @ vectors.T
        rows = self.eq(x), self.eq_jac(x), np.zeros(0), np.zeros((0, 2)), np.zeros(0, dtype=int)
        return programs.Linearisation(self.functions[1](x), hessian, *rows)


def rosenbrock(**constraints):
    return Smooth(rosen, rosen_der, rosen_hess, **constraints)


def test_bounds_are_kept_at_every_evaluation():
    program = rosenbrock()
    program.upper = np.full(2, 0.5)
    evaluate, seen = program.evaluate, []
    program.evaluate = lambda xi: (seen.append(xi), evaluate(xi))[1]
    found = minimise(program, np.array([-1.2, 1.0]), TIGHT)
    assert (np.array(seen) <= 0.5).all()
    np.testing.assert_allclose(found.point.xi, [0.5, 0.25], atol=1e-5)


def test_second_order_correction_overcomes_the_maratos_effect():
    """Minimise 2 (x^2 + y^2 - 1) - x on the unit circle."""

    def circle(corrections):
        cost, slope = (lambda x: 2 * (x @ x - 1) - x[0]), (lambda x: 4 * x - np.eye(2)[0])
        unit = (lambda x: np.array([x @ x - 1])), (lambda x: 2 * x[None, :])
        bent = lambda x, m: 2 * m.equalities[0] * np.eye(2)  # noqa: E731
        program = Smooth(cost, slope, lambda x: 4 * np.eye(2), unit, bent)
        options = TIGHT._replace(corrections=corrections)
        return minimise(program, np.array([np.cos(1.5), np.sin(1.5)]), options)

    with_correction, without = circle(4), circle(0)
    assert with_correction.converged
    np.testing.assert_allclose(with_correction.point.xi, [1, 0], atol=1e-5)
    assert with_correction.iterations <= without.iterations


def test_searches_that_end_without_convergence():
    contradiction = (lambda x: np.array([x @ x + 1.0])), (lambda x: 2 * x[None, :])
    found = minimise(rosenbrock(eq=contradiction), np.array([0.5, 0.5]), TIGHT)
    assert not found.converged
    assert found.point.violation >= 1.0
    start, program = np.array([-1.2, 1.0]), rosenbrock()
    found = minimise(program, start, TIGHT, Budget(0.0))
    assert not found.converged
    assert (found.iterations, program.evaluations) == (0, 1)
    found = minimise(rosenbrock(), start, TIGHT._replace(cutoff=-1.0))  # feasible, but dear
    assert not found.converged
    assert found.iterations <= 6


@pytest.mark.parametrize('sign', [1.0, -1.0])  # an equality presses from either side
def test_steering_reaches_constraints_that_the_first_penalty_would_leave_violated(sign):
    """The multiplier of x = 3 is 600 here; without steering the search first settles short."""
    cost = (lambda x: 100 * x @ x), (lambda x: 200 * x), (lambda x: 200 * np.eye(2))
    three = (lambda x: sign * (x[:1] - 3.0)), (lambda x: np.array([[sign, 0.0]]))
    steep = Smooth(*cost, eq=three)
    options = TIGHT._replace(penalties=(1.0,), largest_penalty=1e4, radius=4.0, corrections=0)
    plain = minimise(steep, np.ones(2), options)
    steered = minimise(steep, np.ones(2), options._replace(steering=True))
    assert steered.converged
    np.testing.assert_allclose(steered.point.xi, [3, 0], atol=1e-6)
    assert steered.iterations < plain.iterations


def test_absolute_terms_are_minimised_exactly():
    """J = x^2 / 2 + 3 |x - 1| has its kink at the minimum x = 1."""

    class Kinked(programs.NonlinearProgram):
        lower, upper = np.full(1, -9.0), np.full(1, 9.0)

        def evaluate(self, xi):
            return programs.Point(xi, float(xi[0] ** 2 / 2 + 3 * abs(xi[0] - 1)), np.zeros(1))

        def linearise(self, point, multipliers):
            empty = np.zeros((0, 1))
            return programs.Linearisation(
                point.xi.copy(), np.eye(1), np.zeros(0), empty, np.zeros(0), empty,
                np.zeros(0, dtype=int), point.xi - 1, np.eye(1), np.array([3.0]),
            )  # fmt: skip

    found = minimise(Kinked(), np.array([-5.0]), TIGHT)
    assert found.converged
    np.testing.assert_allclose(found.point.xi, [1.0], atol=1e-6)
