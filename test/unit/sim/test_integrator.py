# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_sim.integrator import integrate, runge_kutta_step

PLANT = RotaryPendulum()
STATE = np.array([2.0, 0.3, -4.0, 3.0])
TORQUE = np.array([0.01])


def exact(duration: float) -> np.ndarray:
    solution = solve_ivp(
        lambda _, x: PLANT.derivative(x, TORQUE),
        (0.0, duration),
        STATE,
        method='DOP853',
        rtol=1e-13,
        atol=1e-13,
    )
    return solution.y[:, -1]


def test_agrees_with_an_independent_integrator() -> None:
    np.testing.assert_allclose(integrate(PLANT, STATE, TORQUE, 0.5), exact(0.5), atol=1e-8)


def test_error_is_of_fourth_order() -> None:
    reference = exact(0.4)
    errors = [
        np.abs(integrate(PLANT, STATE, TORQUE, 0.4, step) - reference).max()
        for step in (0.02, 0.01, 0.005)
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (np.abs(orders - 4.0) < 0.5).all(), orders


def test_takes_equal_steps_no_longer_than_allowed() -> None:
    calls = 0

    def count(state: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        return state

    integrate(PLANT, STATE, TORQUE, 0.005, 1e-3, count)
    assert calls == 5
    integrate(PLANT, STATE, TORQUE, 0.0051, 1e-3, count)
    assert calls == 11


def test_many_states_at_once() -> None:
    states = np.array([STATE, -STATE, 0.5 * STATE])
    together = runge_kutta_step(PLANT, states, TORQUE, 1e-3)
    alone = [runge_kutta_step(PLANT, state, TORQUE, 1e-3) for state in states]
    np.testing.assert_allclose(together, alone, rtol=1e-13)


def test_no_time_no_change_and_no_way_back() -> None:
    np.testing.assert_array_equal(integrate(PLANT, STATE, TORQUE, 0.0), STATE)
    with pytest.raises(ValueError, match='negative'):
        integrate(PLANT, STATE, TORQUE, -0.1)


def test_a_contact_replaces_the_state() -> None:
    held = integrate(PLANT, STATE, TORQUE, 0.01, after_step=lambda state: state * [1, 0, 1, 0])
    assert held[1] == held[3] == 0.0
