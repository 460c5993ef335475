# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.tracking.estimator import CommandHistory, EstimatorNoise, StateEstimator

PLANT = RotaryPendulum()
NOISE = EstimatorNoise(
    measurement=np.array([0.0015, 0.0015, 0.1, 0.1]),
    model=0.1,
    rate_floor=np.full(4, 10.0),
    driven=np.array([False, False, True, True]),
)


def estimator(history: CommandHistory) -> StateEstimator:
    angles = np.array([True, False, False, False])
    return StateEstimator(PLANT, NOISE, angles, history, longest_gap=0.1)


def true_motion(state: np.ndarray, pieces: list[tuple[float, float]]) -> np.ndarray:
    for duration, torque in pieces:
        state = solve_ivp(
            lambda _, x, u: PLANT.derivative(x, np.array([u])),
            (0.0, duration),
            state,
            args=(torque,),
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
    return state


def test_history_splits_an_interval_at_the_commands() -> None:
    history = CommandHistory(1)
    ((duration, control),) = history.between(0.0, 0.5)
    assert (duration, control.tolist()) == (0.5, [0.0])
    for time, torque in ((1.0, 1.0), (2.0, 2.0), (3.0, 3.0)):
        history.add(time, np.array([torque]))
    pieces = [(round(d, 9), float(u[0])) for d, u in history.between(0.5, 2.25)]
    assert pieces == [(0.5, 0.0), (1.0, 1.0), (0.25, 2.0)]
    assert [float(u[0]) for _, u in history.between(2.0, 2.1)] == [2.0]
    # a command for an earlier instant replaces those after it
    history.add(1.5, np.array([9.0]))
    assert [float(u[0]) for _, u in history.between(1.0, 4.0)] == [1.0, 9.0]
    for k in range(4000):
        history.add(5.0 + 0.005 * k, np.array([float(k)]))
    assert [float(u[0]) for _, u in history.between(24.901, 24.904)] == [3980.0]
    assert len(history._times) < 1000


def test_the_state_is_predicted_over_a_known_delay() -> None:
    history = CommandHistory(1)
    history.add(0.0, np.array([0.01]))
    history.add(0.012, np.array([-0.02]))
    filter_ = estimator(history)
    start = np.array([2.0, 0.1, -3.0, 1.0])
    filter_.observe(start, 0.005)
    expected = true_motion(start, [(0.007, 0.01), (0.018, -0.02)])
    assert np.allclose(filter_.predict(0.030), expected, atol=1e-6)


def test_theta_runs_on_when_the_sensor_wraps() -> None:
    filter_ = estimator(CommandHistory(1))
    state = np.array([3.0, 0.0, 10.0, 0.0])
    filter_.observe(state, 0.0)
    for k in range(1, 20):
        state = true_motion(state, [(0.005, 0.0)])
        seen = state.copy()
        seen[0] = math.remainder(seen[0], math.tau)
        filter_.observe(seen, 0.005 * k)
    assert state[0] > 3.8
    assert np.allclose(filter_.predict(0.005 * 19), state, atol=1e-4)


def test_noise_is_filtered_and_old_samples_are_left_out() -> None:
    rng = np.random.default_rng(1)
    filter_ = estimator(CommandHistory(1))
    state: NDArray[np.float64] = np.array([math.pi - 0.3, 0.0, 0.0, 0.0])
    raw, filtered = [], []
    for k in range(400):
        seen = state + NOISE.measurement * rng.standard_normal(4)
        filter_.observe(seen, 0.005 * k)
        filter_.observe(seen + 1.0, 0.005 * k - 0.001)
        raw.append(seen - state)
        filtered.append(filter_.predict(0.005 * k) - state)
        state = true_motion(state, [(0.005, 0.0)])
    assert np.std(np.array(filtered)[20:, 2]) < 0.6 * np.std(np.array(raw)[20:, 2])
    assert np.abs(np.array(filtered)[20:, 0]).max() < 0.006


def test_after_a_gap_the_filter_starts_anew() -> None:
    filter_ = estimator(CommandHistory(1))
    filter_.observe(np.zeros(4), 0.0)
    filter_.observe(np.array([1.0, 0.5, 0.0, 0.0]), 5.0)
    assert filter_.predict(5.0) == pytest.approx([1.0, 0.5, 0.0, 0.0])
    filter_.reset()
    assert filter_.stamp is None


def test_a_push_is_believed_at_once() -> None:
    filter_ = estimator(CommandHistory(1))
    for k in range(50):
        filter_.observe(np.array([math.pi, 0.0, 0.0, 0.0]), 0.005 * k)
    pushed = np.array([math.pi, 0.0, 8.0, 0.0])
    filter_.observe(pushed, 0.25)
    assert filter_.predict(0.25) == pytest.approx(pushed)
