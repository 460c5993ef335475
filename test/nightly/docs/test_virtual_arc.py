# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The virtual arc of docs/paper: its derivatives, its order, its ends."""

from importlib import import_module
from pathlib import Path
import sys

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.plants import RotaryPendulum
from tdm_planner.problems.swing_up_task import SwingUpTask

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / 'docs/paper'))
paper = import_module('virtual_arc_program')
reference_shape, VirtualArcProgram = paper.reference_shape, paper.VirtualArcProgram

PLANT, TORQUE = RotaryPendulum(), 0.09


def task(*start: float, torque: float = TORQUE) -> SwingUpTask:
    return SwingUpTask(PLANT, np.array(start), torque, torque, 2.0, None)


def differences(xi: np.ndarray, read, step: float = 1e-6) -> np.ndarray:
    changes = step * np.eye(xi.size)
    return np.stack([(read(xi + c) - read(xi - c)) / (2 * step) for c in changes], axis=-1)


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
