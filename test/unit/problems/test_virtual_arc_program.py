# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The scheme along a virtual arc: derivatives, order of convergence against the plant itself."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.plants import RotaryPendulum
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.virtual_arc_program import reference_shape, VirtualArcProgram

PLANT = RotaryPendulum()
TORQUE = 0.09
ARCS = TORQUE * np.array([-1.0, 1.0, -1.0, 1.0])


def task(*start: float) -> SwingUpTask:
    return SwingUpTask(PLANT, np.array(start), TORQUE, TORQUE, 2.0, None)


@given(slope=st.floats(0.0, 2.0))
@settings(deadline=None, derandomize=True, max_examples=30)
def test_the_reference_function_is_monotone_and_ends_at_rest(slope):
    tau = np.linspace(0.0, 1.0, 401)
    values = reference_shape(tau, slope)
    assert (values[0], values[-1]) == (0.0, pytest.approx(1.0))
    assert (np.diff(values) > 0).all()
    assert values[1] / tau[1] == pytest.approx(slope, abs=0.01)
    assert (values[-1] - values[-2]) < 4 * tau[1] ** 2


@pytest.mark.parametrize('start', [(3.0, 0.1, 0.0, 0.2), (3.0, -0.2, -9.0, 1.0)])
def test_derivatives_are_those_of_the_values(start):
    program = VirtualArcProgram(task(*start), ARCS, 0, 12, 0.3)
    xi = np.array([0.35, 0.25, 0.2])
    point = program.evaluate(xi)
    at = program.linearise(point, None)
    step = 1e-7
    for column, direction in enumerate(np.eye(3)):
        moved = [program.evaluate(xi + sign * step * direction) for sign in (1, -1)]
        slope = (moved[0].cost - moved[1].cost) / (2 * step)
        assert at.gradient[column] == pytest.approx(slope, rel=1e-5, abs=1e-6)
        rows = [other.cache.equalities for other in moved]
        np.testing.assert_allclose(
            at.equality_jacobian[:, column],
            (rows[0] - rows[1]) / (2 * step),
            rtol=1e-4,
            atol=1e-5,
        )


def passage(start: tuple[float, ...], angles: np.ndarray, torques: np.ndarray) -> list[np.ndarray]:
    """Integrate the plant to where theta reaches each angle in turn: times and states there."""
    state, time, found = np.array(start), 0.0, []
    for angle, torque in zip(angles, torques, strict=True):
        held = np.array([torque])

        def reached(t, x, angle=angle):
            return x[0] - angle

        reached.terminal = True  # type: ignore[attr-defined]
        piece = solve_ivp(
            lambda t, x, u=held: PLANT.derivative(x, u),
            (time, time + 3.0),
            state,
            'DOP853',
            events=reached,
            rtol=1e-11,
            atol=1e-12,
        )
        state, time = piece.y[:, -1], float(piece.t[-1])
        found.append(np.array([state[2] ** 2, state[1], state[3], time]))
    return found


@pytest.mark.parametrize('start', [(3.0, 0.1, 0.0, 0.2), (3.0, 0.1, -6.0, 0.2)])
def test_second_order_to_the_motion_of_the_plant(start):
    torques = np.array([-TORQUE, TORQUE])
    xi = np.array([[0.35]])
    errors = []
    for steps in (20, 40, 80, 160):
        program = VirtualArcProgram(task(*start), torques, 0, steps)
        angle = program.angles(xi)[0, steps]
        errors.append(np.abs(program.along(xi)[0, steps] - passage(start, [angle], [-TORQUE])[0]))
    worst = np.array(errors) / np.array([100.0, 1.0, 10.0, 0.3])
    assert worst[-1].max() < 2e-4
    # Second order: four times the accuracy with twice the nodes.
    assert (worst[-2].max() / worst[-1].max()) > 3.0


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
    weak = SwingUpTask(PLANT, np.array([np.pi, 0.0, 0.0, 0.0]), 1e-3, 1e-3, 2.0, None)
    program = VirtualArcProgram(weak, 1e-3 * np.array([-1.0, 1.0, -1.0, 1.0]), 0, 10, 1.0)
    point = program.evaluate(np.full(3, 0.25))
    assert np.isfinite(point.cost)
    assert point.violations[1] > 0.1
