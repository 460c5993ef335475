# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The nonlinear programs of the three methods of swing-up: derivatives, peaks, minima."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.pendulum_kernels import roll_states
from tdm_planner.plants.pendulum_steering import ARRIVED, steer
from tdm_planner.problems.smooth_program import SmoothProgram, VARIED
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_minimiser import minimise
from tdm_planner.problems.switching_motion import (
    arc_program,
    ArcProgram,
    curvature,
    evaluate_arcs,
    SMALLEST_CURVATURE,
)
from tdm_planner.problems.switching_seeds import starts
from tdm_planner.problems.virtual_arc_program import reference_shape, VirtualArcProgram

PLANT = RotaryPendulum()


W0 = PLANT.natural_frequency


START = np.array([np.pi, 0.2, 1.0, -2.0])


TORQUE = 0.09
DURATIONS = st.lists(st.floats(0.02, 0.12), min_size=4, max_size=7).map(np.array)
OPTIONS = TrustRegionOptions(
    penalties=(30.0, 30.0),
    radius=0.5,
    iterations=60,
    cost_tolerance=1e-6,
    feasibility=(1e-8, 1e-8),
    corrections=4,
)


def task(*start: float, torque: float = TORQUE) -> SwingUpTask:
    return SwingUpTask(PLANT, np.array(start), torque, torque, 2.0, None)


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


def test_peak_between_the_nodes_is_found():
    made, durations = program(2, disk_angle=0.3), np.array([0.1, 0.12])
    margins = evaluate_arcs(made, durations * W0).margins
    fine = roll_states(
        PLANT, START, np.repeat(durations / 2000, 2000), np.repeat(made.torques, 2000), 1
    )
    peaks = np.abs(fine[1:, 1]).reshape(2, 2000).max(axis=1)
    np.testing.assert_allclose(0.3 - margins, peaks, atol=2e-4)


def test_violations_count_both_groups_and_motions_that_run_away_are_infinitely_bad():
    point = evaluate_arcs(program(4, disk_angle=0.21), np.full(4, 0.1 * W0))
    assert point.ends == pytest.approx(np.abs(point.residual).max())
    assert point.beyond == pytest.approx(-point.margins.min())
    assert point.beyond > 0
    assert point.cost == pytest.approx(0.4 * W0)
    point = evaluate_arcs(program(4), np.full(4, 1e6))
    assert point.ends == point.beyond == np.inf


def arrivals(disk_angle: float) -> list[tuple[ArcProgram, np.ndarray]]:
    """Programs with a motion each that arrives, the quickest first."""
    task = SwingUpTask(PLANT, START, 0.09, 0.09, disk_angle, 0)
    batch = starts(task, np.random.default_rng(0), 200, 6)
    steer(PLANT, START, batch, disk_angle, 12, lambda: False)
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
        states = roll_states(PLANT, START, durations, program.torques, 12)
        assert np.abs(states[-1]).max() < 1e-6
        fine = np.repeat(durations / 200, 200), np.repeat(program.torques, 200)
        assert np.abs(roll_states(PLANT, START, *fine, 1)[:, 1]).max() <= disk_angle + 1e-3
    assert converged >= 3


def test_when_the_minimiser_gives_up():
    made = arrivals(2.0)
    assert minimise(*made[0], OPTIONS, Budget(0.0)).iterations <= 4
    options = replace(OPTIONS, cutoff=1e-3, cost_tolerance=1e-12)
    found = minimise(*made[-1], options, Budget(60.0))
    assert not found.converged or found.iterations <= 5
    found = minimise(program(4), np.full(4, 1e6), OPTIONS, Budget(60.0))  # nothing is computed
    assert found.point.violation == np.inf
    assert found.iterations == 0


TASK = SwingUpTask(PLANT, np.array([3.0, 0.4, 1.0, -3.0]), 0.09, 0.09, 2.0, None)


FREE = 2 * len(VARIED)


XI = st.tuples(
    st.floats(2.0, 6.0), st.lists(st.floats(-0.5, 0.5), min_size=FREE, max_size=FREE)
).map(lambda parts: np.array([parts[0], *parts[1]]))


@given(XI)
@settings(max_examples=10)
def test_smooth_motions_keep_their_ends_and_match_finite_differences(xi):
    made = SmoothProgram(TASK, 0, 30)
    motion = made.motion(xi)
    np.testing.assert_allclose(motion.states[0], TASK.start, atol=1e-9)
    np.testing.assert_allclose(motion.states[-1, [1, 3]], 0.0, atol=1e-8)
    for found, read in (
        (motion.states_jacobian, lambda x: made.motion(x).states),
        (motion.torque_jacobian, lambda x: made.motion(x).torque),
    ):
        expected = differences(xi, read)
        for i in range(xi.size):
            scale = 1e-3 + np.abs(expected[..., i]).max()
            np.testing.assert_allclose(found[..., i], expected[..., i], atol=1e-5 * scale)


ARCS = TORQUE * np.array([-1.0, 1.0, -1.0, 1.0])


@given(slope=st.floats(0.0, 2.0))
@settings(max_examples=30)
def test_the_reference_function_is_monotone_and_ends_at_rest(slope):
    tau = np.linspace(0.0, 1.0, 401)
    values = reference_shape(tau, slope)
    assert (values[0], values[-1]) == (0.0, pytest.approx(1.0))
    assert (np.diff(values) > 0).all()
    assert values[1] / tau[1] == pytest.approx(slope, abs=0.01)
    assert (values[-1] - values[-2]) < 4 * tau[1] ** 2


@pytest.mark.parametrize('start', [(3.0, 0.1, 0.0, 0.2), (3.0, -0.2, -9.0, 1.0)])
def test_derivatives_along_a_virtual_arc_match_finite_differences(start):
    made = VirtualArcProgram(task(*start), ARCS, 0, 12, 0.3)
    xi = np.array([0.35, 0.25, 0.2])
    at = made.linearise(made.evaluate(xi), None)
    slope = differences(xi, lambda x: np.array(made.evaluate(x).cost), 1e-7)
    np.testing.assert_allclose(at.gradient, slope, rtol=1e-5, atol=1e-6)
    rows = differences(xi, lambda x: made.evaluate(x).cache.equalities, 1e-7)
    np.testing.assert_allclose(at.equality_jacobian, rows, rtol=1e-4, atol=1e-5)


def passage(start: tuple[float, ...], angle: float) -> np.ndarray:
    """Integrate the plant to where theta reaches an angle: what the scheme integrates there."""

    def reached(t, x):
        return x[0] - angle

    reached.terminal = True  # type: ignore[attr-defined]
    held = np.array([-TORQUE])
    way = solve_ivp(
        lambda t, x: PLANT.derivative(x, held),
        (0.0, 3.0),
        start,
        'DOP853',
        events=reached,
        rtol=1e-11,
        atol=1e-12,
    )
    _, psi, theta_dot, psi_dot = way.y[:, -1]
    return np.array([theta_dot**2, psi, psi_dot, way.t[-1]])


@pytest.mark.parametrize('start', [(3.0, 0.1, 0.0, 0.2), (3.0, 0.1, -6.0, 0.2)])
def test_the_virtual_arc_is_of_second_order_to_the_motion_of_the_plant(start):
    worst = []
    for steps in (80, 160):
        made = VirtualArcProgram(task(*start), np.array([-TORQUE, TORQUE]), 0, steps)
        xi = np.array([[0.35]])
        error = made.along(xi)[0, steps] - passage(start, made.angles(xi)[0, steps])
        worst.append((np.abs(error) / [100.0, 1.0, 10.0, 0.3]).max())
    assert worst[1] < 2e-4
    assert worst[0] / worst[1] > 3.0


def test_switches_are_nodes_and_the_arcs_fill_the_time():
    program = VirtualArcProgram(task(3.0, 0.0, -9.0, 0.0), ARCS, 0, 10)
    xi = np.array([0.3, 0.3, 0.1])
    states = program.along(xi[None])[0]
    durations = program.durations(xi)
    assert durations.shape == (4,)
    assert durations.sum() == pytest.approx(states[-1, 3])
    theta = program.angles(xi[None])[0]
    slope = 2 * 9.0 / (9.0 + 3.0 * PLANT.natural_frequency)
    expected = 3.0 * (1.0 - reference_shape(np.cumsum(xi), slope))
    np.testing.assert_allclose(theta[10:40:10], expected, atol=1e-12)


def test_what_is_beyond_reach_is_a_violation_not_a_crash():
    weak = VirtualArcProgram(task(np.pi, 0.0, 0.0, 0.0, torque=1e-3), ARCS / 90, 0, 10, 1.0)
    point = weak.evaluate(np.full(3, 0.25))
    assert np.isfinite(point.cost)
    assert point.violations[1] > 0.1
