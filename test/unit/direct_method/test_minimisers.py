# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The minimiser and its quadratic programs against known answers and optimality conditions."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.optimize import rosen, rosen_der, rosen_hess
from tdm_planner.direct_method.nonlinear_program import (
    Budget,
    Linearisation,
    NonlinearProgram,
    Point,
)
from tdm_planner.direct_method.trust_region import (
    minimise,
    solve_quadratic_program,
    TrustRegionOptions,
)
from tdm_planner.problems.pendulum.switching_quadratic import solve_compiled


def solved(hessian, gradient, rows, least, lower, upper):
    x, multipliers = np.empty(gradient.size), np.empty(least.size)
    ok = solve_compiled(hessian, gradient, rows, least, lower, upper, x, multipliers)
    return (x, multipliers) if ok else None


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
def test_minimum_is_that_of_the_library_and_optimal(seed):
    program = random_program(seed)
    hessian, gradient, rows, least, lower, upper = program
    library = solve_quadratic_program(*program)
    found = solved(*program), (library.step, library.multipliers)
    for x, multipliers in found:
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
    cost = lambda d: 0.5 * d @ hessian @ d + gradient @ d  # noqa: E731
    assert cost(found[0][0]) == pytest.approx(cost(found[1][0]), rel=1e-6, abs=1e-6)


def test_what_has_no_minimum_is_noticed():
    for seed in range(20):
        program = random_program(seed, feasible=False)
        if len(program[2]) > 2:
            assert solved(*program) is None
            assert solve_quadratic_program(*program) is None
    free = np.zeros((0, 2)), np.zeros(0), np.full(2, -1e12), np.full(2, 1e12)
    assert solved(np.diag([1.0, -1.0]), np.ones(2), *free) is None


TIGHT = TrustRegionOptions(
    penalties=(30.0,), iterations=200, cost_tolerance=1e-12, feasibility=(1e-9,), corrections=4
)


class Smooth(NonlinearProgram):
    """J, c = 0, g >= 0 and their derivatives as functions; Hessian of the Lagrangian clipped."""

    lower, upper = np.full(2, -1e6), np.full(2, 1e6)
    evaluations = 0

    def __init__(self, cost, grad, hess, eq=None, ineq=None, curvature=None):
        self.functions = cost, grad, hess
        none = (lambda x: np.zeros(0)), (lambda x: np.zeros((0, 2)))
        self.eq, self.eq_jac = eq or none
        self.ineq, self.ineq_jac = ineq or none
        self.curvature = curvature or (lambda x, multipliers: np.zeros((2, 2)))

    def evaluate(self, xi):
        self.evaluations += 1
        worst = max(np.abs(self.eq(xi)).max(initial=0), (-self.ineq(xi)).max(initial=0))
        return Point(xi, float(self.functions[0](xi)), np.array([worst]))

    def linearise(self, point, multipliers):
        x, g = point.xi, self.ineq(point.xi)
        hessian = self.functions[2](x)
        if multipliers is not None:
            hessian = hessian - self.curvature(x, multipliers)
        values, vectors = np.linalg.eigh(hessian)
        hessian = (vectors * np.maximum(np.abs(values), 1e-3)) @ vectors.T
        rows = self.eq(x), self.eq_jac(x), g, self.ineq_jac(x)
        return Linearisation(self.functions[1](x), hessian, *rows, np.zeros(g.size, dtype=int))

    def correction_rows(self, point, at, active):
        g = self.ineq(point.xi)
        return np.concatenate([self.eq(point.xi), np.minimum(g[active], 0.0)])


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
        program = Smooth(
            lambda x: 2 * (x @ x - 1) - x[0],
            lambda x: 4 * x - np.array([1.0, 0.0]),
            lambda x: 4 * np.eye(2),
            eq=(lambda x: np.array([x @ x - 1]), lambda x: 2 * x[None, :]),
            curvature=lambda x, m: 2 * m.equalities[0] * np.eye(2),
        )
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


def test_steering_reaches_constraints_that_the_first_penalty_would_leave_violated():
    """The multiplier of x = 3 is 600 here; without steering the search first settles short."""
    steep = Smooth(
        lambda x: 100 * x @ x,
        lambda x: 200 * x,
        lambda x: 200 * np.eye(2),
        eq=(lambda x: x[:1] - 3.0, lambda x: np.array([[1.0, 0.0]])),
    )
    options = TIGHT._replace(penalties=(1.0,), largest_penalty=1e4, radius=4.0, corrections=0)
    plain = minimise(steep, np.ones(2), options)
    steered = minimise(steep, np.ones(2), options._replace(steering=True))
    assert steered.converged
    np.testing.assert_allclose(steered.point.xi, [3, 0], atol=1e-6)
    assert steered.iterations < plain.iterations


def test_absolute_terms_are_minimised_exactly():
    """J = x^2 / 2 + 3 |x - 1| has its kink at the minimum x = 1."""

    class Kinked(NonlinearProgram):
        lower, upper = np.full(1, -9.0), np.full(1, 9.0)

        def evaluate(self, xi):
            return Point(xi, float(xi[0] ** 2 / 2 + 3 * abs(xi[0] - 1)), np.zeros(1))

        def linearise(self, point, multipliers):
            empty = np.zeros((0, 1))
            return Linearisation(
                point.xi.copy(), np.eye(1), np.zeros(0), empty, np.zeros(0), empty,
                np.zeros(0, dtype=int), point.xi - 1, np.eye(1), np.array([3.0]),
            )  # fmt: skip

    found = minimise(Kinked(), np.array([-5.0]), TIGHT)
    assert found.converged
    np.testing.assert_allclose(found.point.xi, [1.0], atol=1e-6)
