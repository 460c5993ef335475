# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Motions under arcs of constant torque: accuracy, exact derivatives, side by side."""

from __future__ import annotations

import threading

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.plants import pendulum_rollout, RotaryPendulum
from tdm_planner.plants.pendulum_kernels import roll_arcs
from tdm_planner.plants.pendulum_lanes import LANES, roll_lanes, sine_and_cosine
from tdm_planner.plants.pendulum_rollout import ArcBatch, ARRIVED, roll_states, steer

PLANT = RotaryPendulum()


START = np.array([np.pi, 0.0, 0.0, 0.0])


NEVER = lambda: False  # noqa: E731


ARCS = st.lists(st.floats(0.0, 0.1), min_size=1, max_size=7).map(np.array)


STATES = st.tuples(
    st.floats(-4.0, 4.0), st.floats(-2.0, 2.0), st.floats(-8.0, 8.0), st.floats(-8.0, 8.0)
).map(np.array)


def alternating(count: int, torque: float = 0.05) -> np.ndarray:
    return torque * (-1.0) ** np.arange(count)


def roll(
    start: np.ndarray, durations: np.ndarray, torques: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    nodes = durations.size * steps + 1
    states, derivatives = np.empty((nodes, 4)), np.empty((nodes, 4, durations.size))
    k = np.array(PLANT.coefficients)
    roll_arcs(k, start, durations, torques, steps, states, derivatives, True)
    return states, derivatives


def random_batch(count: int) -> ArcBatch:
    rng = np.random.default_rng(3)
    durations = rng.dirichlet(np.full(5, 2.0), size=count) * rng.uniform(0.2, 1.0, (count, 1))
    torques = np.tile(alternating(5, 0.09), (count, 1))
    unknown = np.full(count, np.nan), np.full(count, np.inf)
    return ArcBatch(durations, np.full(count, 5), torques, *unknown)


@given(STATES, ARCS)
@settings(deadline=None, derandomize=True, max_examples=30)
def test_derivatives_are_those_of_the_discrete_motion(start, durations):
    torques = alternating(durations.size)
    states, derivatives = roll(start, durations, torques, 6)
    assert states.shape == (6 * durations.size + 1, 4)
    step = 1e-6
    for arc in range(durations.size):
        change = step * (np.arange(durations.size) == arc)
        ahead, _ = roll(start, durations + change, torques, 6)
        behind, _ = roll(start, durations - change, torques, 6)
        difference = (ahead - behind) / (2 * step)
        scale = 1.0 + np.abs(difference).max()
        np.testing.assert_allclose(derivatives[:, :, arc], difference, atol=1e-6 * scale)


def test_states_are_accurate():
    intervals, torques = np.full(30, 5e-3), alternating(30, 0.09)
    states = roll_states(PLANT, START, intervals, torques, 20)
    expected = START
    for index, torque in enumerate(torques):
        control = np.array([torque])
        expected = solve_ivp(
            lambda t, x, u=control: PLANT.derivative(x, u),
            (0.0, intervals[index]),
            expected,
            method='DOP853',
            rtol=1e-12,
            atol=1e-13,
        ).y[:, -1]
        np.testing.assert_allclose(states[index + 1], expected, rtol=0, atol=1e-9)


def test_steering_arrives_upright_within_the_limit():
    batch = random_batch(60)
    steer(PLANT, START, batch, 2.0, 12, NEVER)
    arrived = np.flatnonzero(batch.costs < ARRIVED)
    assert arrived.size >= 3
    for index in arrived:
        states, _ = roll(START, batch.durations[index], batch.torques[index], 12)
        turns = np.round(states[-1, 0] / (2 * np.pi))
        goal = np.array([2 * np.pi * turns, 0.0, 0.0, 0.0])
        assert np.abs(states[-1] - goal).max() < 1e-4
        assert np.abs(states[:, 1]).max() <= 2.0 + 1e-6
        assert (batch.durations[index] >= 0).all()


@given(STATES, st.integers(4, 7), st.integers(0, 100))
@settings(deadline=None, derandomize=True, max_examples=20)
def test_motions_side_by_side_are_those_one_by_one(start, arcs, seed):
    steps, k = 24, np.array(PLANT.coefficients)
    durations = np.random.default_rng(seed).uniform(0.0, 0.1, size=(arcs, LANES))
    torques = np.tile(alternating(arcs)[:, None], LANES)
    state, derivatives = np.empty(4 * LANES), np.empty((arcs, 4 * LANES))
    disk_slopes = np.zeros((arcs * steps + 1, arcs, LANES))
    peaks, nodes = np.empty((arcs, LANES)), np.empty((arcs, LANES))
    roll_lanes(
        k, start, durations, torques, arcs, steps, state, derivatives, disk_slopes, peaks, nodes
    )
    for lane in range(LANES):
        one = durations[:, lane].copy(), torques[:, lane].copy()
        states, exact = roll(start, *one, steps)
        np.testing.assert_allclose(state.reshape(4, LANES)[:, lane], states[-1], atol=1e-9)
        scale = 1.0 + np.abs(exact).max()
        found = derivatives.reshape(arcs, 4, LANES)[:, :, lane]
        np.testing.assert_allclose(found.T, exact[-1], atol=1e-3 * scale)
        np.testing.assert_allclose(disk_slopes[1:, :, lane], exact[1:, 1], atol=1e-3 * scale)
        sizes = np.abs(states[1:, 1]).reshape(arcs, steps)
        np.testing.assert_allclose(np.abs(peaks[:, lane]), sizes.max(axis=1), atol=1e-9)
        at_peaks = states[nodes[:, lane].astype(int), 1]
        np.testing.assert_allclose(at_peaks, peaks[:, lane], atol=1e-9)


@given(st.floats(-1e6, 1e6))
@settings(deadline=None, derandomize=True, max_examples=200)
def test_sine_and_cosine(angle):
    sine, cosine = sine_and_cosine(angle)
    assert abs(sine - np.sin(angle)) < 3e-16
    assert abs(cosine - np.cos(angle)) < 3e-16


@pytest.mark.parametrize(('cores', 'threads'), [(1, 1), (2, 1), (3, 2), (16, 4)])
def test_one_core_is_left_and_the_number_of_cores_does_not_matter(monkeypatch, cores, threads):
    one, many = random_batch(170), random_batch(170)  # four chunks
    monkeypatch.setattr(pendulum_rollout, '_cores', lambda: 1)
    count = steer(PLANT, START, one, 2.0, 12, NEVER)
    monkeypatch.setattr(pendulum_rollout, '_cores', lambda: cores)
    steer_arcs, used, all_started = pendulum_rollout.steer_arcs, set(), threading.Barrier(threads)

    def noted(*arguments):
        if threading.get_ident() not in used:
            used.add(threading.get_ident())
            all_started.wait(60.0)
        return steer_arcs(*arguments)

    monkeypatch.setattr(pendulum_rollout, 'steer_arcs', noted)
    assert steer(PLANT, START, many, 2.0, 12, NEVER) == count
    assert len(used) == threads
    np.testing.assert_array_equal(one.durations, many.durations)
    np.testing.assert_array_equal(one.costs, many.costs)


def test_steering_stops_when_told():
    batch = random_batch(170)
    before = batch.durations.copy()
    assert steer(PLANT, START, batch, 2.0, 12, lambda: True) == 0
    np.testing.assert_array_equal(batch.durations, before)
