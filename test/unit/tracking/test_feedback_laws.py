# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Linear-quadratic regulators, and the mean of what is planned over a command's interval."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm, solve_discrete_are
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.tracking.estimator import flow
from tdm_planner.tracking.feedforward import Feedforward
from tdm_planner.tracking.linear_quadratic import (
    discrete_regulator,
    discretise,
    regulator,
    time_varying_regulator,
)
from tdm_planner.trajectory import Interpolation, Trajectory

SETTINGS = settings(deadline=None, max_examples=12, derandomize=True)
SEEDS = st.integers(0, 1000)
Q, R = np.diag([1.0, 0.5, 0.2, 0.1]), np.array([[3.0]])


def system(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return 3.0 * rng.normal(size=(4, 4)), rng.normal(size=(4, 1))


@SETTINGS
@given(seed=SEEDS, step=st.floats(1e-4, 1.0))
def test_discretisation_is_the_matrix_exponential(seed: int, step: float) -> None:
    a, b = system(seed)
    transition, held = discretise(np.stack([a, -a]), np.stack([b, b]), step)
    for sign, phi, gamma in zip((1, -1), transition, held, strict=True):
        block = np.zeros((5, 5))
        block[:4, :4], block[:4, 4:] = sign * a, b
        exact = expm(block * step)
        assert np.allclose(phi, exact[:4, :4], rtol=1e-10, atol=1e-10 * np.abs(exact).max())
        assert np.allclose(gamma, exact[:4, 4:], rtol=1e-10, atol=1e-10 * np.abs(exact).max())


@SETTINGS
@given(seed=SEEDS)
def test_a_constant_system_has_the_algebraic_solution_as_its_limit(seed: int) -> None:
    a, b = system(seed)
    step, n = 0.02, 1000
    along = time_varying_regulator(np.tile(a, (n, 1, 1)), np.tile(b, (n, 1, 1)), Q, R, Q, step)
    phi, gamma = discretise(a, b, step)
    exact = solve_discrete_are(phi, gamma, Q * step, R * step)
    steady = discrete_regulator(a, b, Q, R, step)
    assert np.allclose(steady.cost_to_go, exact)
    assert np.allclose(along.costs_to_go[0], exact, rtol=1e-5, atol=1e-6 * np.abs(exact).max())
    assert np.allclose(along.gains[0], steady.gain, rtol=1e-4, atol=1e-4)


@SETTINGS
@given(seed=SEEDS)
def test_regulators_stabilise_and_agree_for_short_steps(seed: int) -> None:
    a, b = system(seed)
    continuous = regulator(a, b, Q, R)
    assert np.linalg.eigvals(a - b @ continuous.gain).real.max() < 0
    short = discrete_regulator(a, b, Q, R, 1e-5)
    assert np.allclose(short.gain, continuous.gain, rtol=1e-2, atol=1e-2)
    discrete = discrete_regulator(a, b, Q, R, 0.02)
    phi, gamma = discretise(a, b, 0.02)
    assert np.abs(np.linalg.eigvals(phi - gamma @ discrete.gain)).max() < 1


def test_the_cost_to_go_is_the_cost_and_other_gains_cost_more() -> None:
    times = np.linspace(0.0, 1.0, 101)[:-1]
    states = np.stack([np.pi * (1 - times), 0 * times, 0 * times - np.pi, 0 * times], axis=1)
    a, b = RotaryPendulum().jacobians(states, np.zeros((100, 1)))
    q, r, step = np.diag([1.0, 0.1, 0.01, 0.001]), np.array([[100.0]]), 0.01
    along = time_varying_regulator(a, b, q, r, 10.0 * q, step)
    phi, gamma = discretise(a, b, step)

    def cost(gains: np.ndarray, x: np.ndarray) -> float:
        total = 0.0
        for k in range(100):
            u = -gains[k] @ x
            total += step * float(x @ q @ x + u @ r @ u)
            x = phi[k] @ x + gamma[k] @ u
        return total + float(x @ (10 * q) @ x)

    start = np.array([0.1, -0.05, 0.3, 0.2])
    best = cost(along.gains, start)
    assert best == pytest.approx(start @ along.costs_to_go[0] @ start, rel=1e-9)
    for factor in (0.0, 0.8, 0.95, 1.05):
        assert cost(factor * along.gains, start) > best
    noise = np.random.default_rng(0).normal(size=along.gains.shape)
    assert cost(along.gains + 1e-3 * noise, start) > best


def test_a_system_that_cannot_be_stabilised_is_an_error() -> None:
    with pytest.raises(ValueError, match='Riccati'):
        regulator(np.diag([1.0, -1.0]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1))


def test_the_nonlinear_pendulum_is_held_upright() -> None:
    plant = RotaryPendulum()
    a, b = plant.linearise()
    frequency = plant.natural_frequency
    q = np.diag([1.0, 0.1, 1 / frequency**2, 0.1 / frequency**2])
    gain = discrete_regulator(a, b, q, np.array([[2 / 0.02**2]]), 0.005).gain
    state = np.array([0.1, 0.2, 0.0, 0.0])
    for _ in range(1000):
        state = flow(plant, state, -gain @ state, 0.005)
    assert np.abs(state).max() < 1e-3


def plan(controls: list[float], interpolation: Interpolation) -> Trajectory:
    times = np.cumsum([0.0, 0.11, 0.07, 0.2, 0.05, 0.13])
    planned = np.array(controls)[:, None]
    return Trajectory(times, np.zeros((6, 1)), planned, ('x',), ('u',), interpolation)


@pytest.mark.parametrize(
    ('start', 'end', 'mean'),
    [
        (0.0, 0.1, 1.0),
        (0.10, 0.12, 0.0),
        (0.11, 0.19, (-0.07 + 0.01) / 0.08),
        # before the start and after the end nothing is planned
        (-0.02, 0.02, 0.5),
        (0.55, 0.57, 0.5),
        (0.6, 0.7, 0.0),
    ],
)
def test_the_mean_of_a_bang_bang_torque_is_exact(start: float, end: float, mean: float) -> None:
    feedforward = Feedforward(plan([1, -1, 1, -1, 1, 1], 'zero_order_hold'))
    assert feedforward.mean(start, end) == pytest.approx(mean, abs=1e-12)


@pytest.mark.parametrize('interpolation', ['zero_order_hold', 'linear', 'cubic'])
@SETTINGS
@given(
    controls=st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    start=st.floats(0.0, 0.5),
    span=st.floats(1e-3, 0.05),
)
def test_the_mean_agrees_with_quadrature(
    interpolation: Interpolation, controls: list[float], start: float, span: float
) -> None:
    asked = plan(controls, interpolation)
    inside = [t for t in asked.times if start < t < start + span]
    integral, _ = quad(
        lambda t: float(asked.sample(t).control[0]), start, start + span, points=inside or None
    )
    mean = Feedforward(asked).mean(start, start + span)
    assert mean.shape == (1,)
    assert mean[0] == pytest.approx(integral / span, abs=1e-6)
