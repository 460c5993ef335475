# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The nonlinear programs of the three methods of swing-up: derivatives, peaks, minima."""

from __future__ import annotations

from functools import partial

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.optimize import minimize
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.pendulum_kernels import roll_states
from tdm_planner.problems.pendulum.shooting import ARRIVED, shoot
from tdm_planner.problems.pendulum.switching_minimiser import minimise
from tdm_planner.problems.pendulum.switching_motion import (
    arc_program,
    ArcProgram,
    curvature,
    evaluate_arcs,
    SMALLEST_CURVATURE,
)
from tdm_planner.problems.pendulum.switching_seeds import starts
from tdm_planner.problems.pendulum.task import SwingUpTask

PLANT = RotaryPendulum()


W0 = PLANT.natural_frequency


START = np.array([np.pi, 0.2, 1.0, -2.0])


DURATIONS = st.lists(st.floats(0.02, 0.12), min_size=4, max_size=7).map(np.array)
OPTIONS = TrustRegionOptions(
    penalties=(30.0, 30.0),
    radius=0.5,
    iterations=60,
    cost_tolerance=1e-6,
    feasibility=(1e-8, 1e-8),
    corrections=4,
)


def program(arcs: int, disk_angle: float = 2.0) -> ArcProgram:
    return arc_program(PLANT, START, 0.09 * (-1.0) ** np.arange(arcs), 0, disk_angle, 12)


def differences(xi: np.ndarray, read, step: float = 1e-6) -> np.ndarray:
    changes = step * np.eye(xi.size)
    return np.stack([(read(xi + c) - read(xi - c)) / (2 * step) for c in changes], axis=-1)


@given(DURATIONS, st.integers(0, 100))
@settings(max_examples=20)
def test_derivatives_of_arcs_match_finite_differences(durations, seed):
    made, xi = program(durations.size, 0.3), durations * W0
    point = evaluate_arcs(made, xi)
    expected = differences(xi, lambda x: evaluate_arcs(made, x).residual)
    np.testing.assert_allclose(point.jacobian, expected, atol=1e-5 * (1 + np.abs(expected).max()))
    step = 1e-6
    for i in range(xi.size):
        change = step * (np.arange(xi.size) == i)
        ahead, behind = (evaluate_arcs(made, x).margins for x in (xi + change, xi - change))
        # Where the peak changes its node or its side the margin has a kink: not differentiable.
        smooth = np.abs(ahead - 2 * point.margins + behind) < 1e-9
        central = (ahead - behind)[smooth] / (2 * step)
        np.testing.assert_allclose(point.slopes[smooth, i], central, atol=1e-4, rtol=1e-4)
    # The curvature is that along the end conditions.
    duals = np.random.default_rng(seed).normal(size=4)
    found = curvature(made, point, duals)
    basis = np.linalg.svd(point.jacobian)[2]
    across, along = basis[:4], basis[4:]
    second = differences(xi, lambda x: duals @ evaluate_arcs(made, x).jacobian, 1e-5)
    values = np.linalg.eigvalsh(along @ (0.5 * (second + second.T)) @ along.T)
    expected = np.sort(np.maximum(np.abs(values), SMALLEST_CURVATURE))
    reduced = np.linalg.eigvalsh(along @ found @ along.T)
    np.testing.assert_allclose(reduced, expected, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(across @ found, SMALLEST_CURVATURE * across, atol=1e-9)


def arrivals(disk_angle: float) -> list[tuple[ArcProgram, np.ndarray]]:
    """Programs with a motion each that arrives, the quickest first."""
    task = SwingUpTask(PLANT, START, 0.09, 0.09, disk_angle, 0)
    batch = starts(task, np.random.default_rng(0), 200, 6)
    shoot(PLANT, START, batch, disk_angle, 12, lambda: False)
    found = []
    totals = np.where(batch.costs < ARRIVED, batch.durations.sum(axis=1), np.inf)
    for index in np.argsort(totals)[:5]:
        assert batch.costs[index] < ARRIVED
        n = batch.arcs[index]
        torques = batch.torques[index, :n].copy()
        made = arc_program(PLANT, START, torques, 0, disk_angle, 12)
        found.append((made, batch.durations[index, :n] * W0))
    return found


def local_minimum(program: ArcProgram, xi: np.ndarray) -> float:
    """Return the least cost that SLSQP finds from there."""
    at = partial(evaluate_arcs, program)
    ends = {'type': 'eq', 'fun': lambda x: at(x).residual, 'jac': lambda x: at(x).jacobian}
    limits = {'type': 'ineq', 'fun': lambda x: np.minimum(at(x).margins, 1.0)}
    limits['jac'] = lambda x: at(x).slopes
    task = {'bounds': [(0.0, None)] * xi.size, 'constraints': [ends, limits]}
    return float(minimize(np.sum, xi, jac=np.ones_like, method='SLSQP', tol=1e-10, **task).fun)


@pytest.mark.parametrize('disk_angle', [2.0, 0.9])
def test_minimum_is_feasible_and_the_best_around(disk_angle):
    converged = 0
    for program, xi in arrivals(disk_angle):
        found = minimise(program, xi, OPTIONS, Budget(60.0))
        if not found.converged:
            continue
        converged += 1
        # Steering looks at |psi| at nodes only: within the limit between them takes longer.
        assert found.point.cost <= xi.sum() * (1 + 2e-3)
        assert found.point.cost <= local_minimum(program, found.point.xi) * (1 + 1e-4)
        durations = found.point.xi / W0
        assert evaluate_arcs(program, found.point.xi).ends < 1e-6 / W0
        fine = np.repeat(durations / 200, 200), np.repeat(program.torques, 200)
        assert np.abs(roll_states(PLANT, START, *fine)[:, 1]).max() <= disk_angle + 1e-3
    assert converged >= 3


def test_when_the_minimiser_gives_up():
    made = arrivals(2.0)
    assert minimise(*made[0], OPTIONS, Budget(0.0)).iterations <= 4
    options = OPTIONS._replace(cutoff=1e-3, cost_tolerance=1e-12)
    found = minimise(*made[-1], options, Budget(60.0))
    assert not found.converged or found.iterations <= 5
    found = minimise(program(4), np.full(4, 1e6), OPTIONS, Budget(60.0))  # nothing is computed
    assert found.point.violation == np.inf
    assert found.iterations == 0
