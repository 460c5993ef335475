# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The nonlinear program with the disk's angle as reference function: ends, derivatives, torque."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from tdm_planner.plants import RotaryPendulum
from tdm_planner.problems.smooth_program import SmoothProgram, VARIED
from tdm_planner.problems.swing_up_task import SwingUpTask

PLANT = RotaryPendulum()
TASK = SwingUpTask(PLANT, np.array([3.0, 0.4, 1.0, -3.0]), 0.09, 0.09, 2.0, None)
FREE = 2 * len(VARIED)
XI = st.tuples(
    st.floats(2.0, 6.0), st.lists(st.floats(-0.5, 0.5), min_size=FREE, max_size=FREE)
).map(lambda parts: np.array([parts[0], *parts[1]]))


@given(XI)
@settings(deadline=None, derandomize=True, max_examples=20)
def test_start_and_end_of_the_disk_hold_whatever_is_varied(xi):
    motion = SmoothProgram(TASK, 0, 30).motion(xi)
    np.testing.assert_allclose(motion.states[0], TASK.start, atol=1e-9)
    np.testing.assert_allclose(motion.states[-1, [1, 3]], 0.0, atol=1e-8)


@given(XI)
@settings(deadline=None, derandomize=True, max_examples=20)
def test_derivatives_match_finite_differences(xi):
    made = SmoothProgram(TASK, 0, 30)
    motion = made.motion(xi)
    step = 1e-6
    for i in range(xi.size):
        change = step * (np.arange(xi.size) == i)
        ahead, behind = made.motion(xi + change), made.motion(xi - change)
        for found, difference in (
            (motion.states_jacobian[:, :, i], (ahead.states - behind.states) / (2 * step)),
            (motion.torque_jacobian[:, i], (ahead.torque - behind.torque) / (2 * step)),
        ):
            scale = 1e-3 + np.abs(difference).max()
            np.testing.assert_allclose(found, difference, atol=1e-5 * scale)


def test_torque_found_by_inverse_dynamics_produces_the_motion():
    xi = np.concatenate([[4.0], 0.2 * np.cos(np.arange(FREE))])
    motion = SmoothProgram(TASK, 0, 400).motion(xi)
    times = np.linspace(0.0, xi[0] / PLANT.natural_frequency, 401)
    torque = CubicSpline(times, motion.torque)
    replayed = solve_ivp(
        lambda t, x: PLANT.derivative(x, np.array([torque(t)])),
        (0.0, times[-1]),
        TASK.start,
        method='DOP853',
        rtol=1e-10,
        atol=1e-10,
        t_eval=times,
    )
    np.testing.assert_allclose(replayed.y.T, motion.states, atol=2e-5)
