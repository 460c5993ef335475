# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_sim.disturbances import Disturbances, pendulum_push, robot_push

SETTINGS = settings(deadline=None, max_examples=50, derandomize=True)
ANGLES = st.floats(-10.0, 10.0)


def momenta(plant: RotaryPendulum, state: np.ndarray) -> np.ndarray:
    """Generalized momenta: the energy's derivatives with respect to the rates."""
    h = 1e-3
    rates = [np.array([0, 0, h, 0]), np.array([0, 0, 0, h])]
    # The energy is quadratic in the rates: central differences are exact.
    return np.array([(plant.energy(state + d) - plant.energy(state - d)) / (2 * h) for d in rates])


@SETTINGS
@given(
    theta=ANGLES,
    psi=ANGLES,
    theta_dot=ANGLES,
    psi_dot=ANGLES,
    impulse=st.floats(-1e-3, 1e-3),
)
def test_a_push_changes_the_pendulums_momentum_alone(
    theta: float, psi: float, theta_dot: float, psi_dot: float, impulse: float
) -> None:
    plant = RotaryPendulum()
    before = np.array([theta, psi, theta_dot, psi_dot])
    after = pendulum_push(plant, before, impulse)
    np.testing.assert_array_equal(after[:2], before[:2])
    change = momenta(plant, after) - momenta(plant, before)
    np.testing.assert_allclose(change, [impulse, 0.0], atol=1e-11)


@SETTINGS
@given(impulse=st.floats(-5.0, 5.0), direction=ANGLES)
def test_a_push_changes_the_robots_momentum(impulse: float, direction: float) -> None:
    plant = FloatingRobot(mass=4.0)
    before = np.arange(9.0)
    after = robot_push(plant, before, impulse, direction)
    change = plant.mass * (after - before)[2:4]
    np.testing.assert_allclose(
        change, impulse * np.array([np.cos(direction), np.sin(direction)]), atol=1e-12
    )
    others = [0, 1, 4, 5, 6, 7, 8]
    np.testing.assert_array_equal(after[others], before[others])


def test_noise_has_the_deviation_asked_for() -> None:
    disturbances = Disturbances(seed=1)
    state, deviation = np.array([1.0, -2.0, 3.0]), np.array([0.0, 0.5, 2.0])
    draws = np.array([disturbances.measured(state, deviation) for _ in range(20_000)])
    np.testing.assert_allclose(draws.mean(axis=0), state, atol=0.05)
    np.testing.assert_allclose(draws.std(axis=0), deviation, rtol=0.03)
    assert (draws[:, 0] == 1.0).all()
    correlations = (
        np.corrcoef(draws[1:, 1], draws[:-1, 1])[0, 1],
        np.corrcoef(draws[:, 1:].T)[0, 1],
    )
    assert np.abs(correlations).max() < 0.03


def test_commands_are_lost_as_often_as_asked_for() -> None:
    disturbances = Disturbances(seed=2)
    assert not any(disturbances.loses_command(0.0) for _ in range(1000))
    assert all(disturbances.loses_command(1.0) for _ in range(1000))
    assert abs(np.mean([disturbances.loses_command(0.2) for _ in range(10_000)]) - 0.2) < 0.02


def test_directions_cover_the_circle() -> None:
    disturbances = Disturbances(seed=3)
    angles = np.array([disturbances.direction() for _ in range(4000)])
    assert np.abs(np.exp(1j * angles).mean()) < 0.05
    assert np.histogram(angles, bins=8, range=(-np.pi, np.pi))[0].min() > 400


def test_one_seed_one_sequence_and_streams_do_not_disturb_each_other() -> None:
    state, deviation = np.zeros(4), np.ones(4)
    one, two, other = Disturbances(5), Disturbances(5), Disturbances(6)
    for _ in range(3):
        two.loses_command(0.5)
        two.direction()
    first = one.measured(state, deviation)
    np.testing.assert_array_equal(first, two.measured(state, deviation))
    assert not np.array_equal(first, other.measured(state, deviation))
