# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Pushes, noise and lost commands; plants and actuators that are not what is believed."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from tdm_planner.parameters import to_mapping
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_sim.disturbances import Disturbances, pendulum_push, robot_push
from tdm_sim.mismatch import mismatched, mismatched_gains

SETTINGS = settings(deadline=None, max_examples=30, derandomize=True)
ANGLES = st.floats(-10.0, 10.0)
PENDULUM = RotaryPendulum()


def momenta(state: np.ndarray) -> np.ndarray:
    """Generalized momenta: the energy's derivatives with respect to the rates."""
    h = 1e-3
    rates = [np.array([0, 0, h, 0]), np.array([0, 0, 0, h])]
    # The energy is quadratic in the rates: central differences are exact.
    ends = [(PENDULUM.energy(state + d), PENDULUM.energy(state - d)) for d in rates]
    return np.array([(after - before) / (2 * h) for after, before in ends])


@SETTINGS
@given(state=st.tuples(ANGLES, ANGLES, ANGLES, ANGLES), impulse=st.floats(-1e-3, 1e-3))
def test_a_push_changes_the_pendulums_momentum_alone(
    state: tuple[float, ...], impulse: float
) -> None:
    before = np.array(state)
    after = pendulum_push(PENDULUM, before, impulse)
    np.testing.assert_array_equal(after[:2], before[:2])
    change = momenta(after) - momenta(before)
    np.testing.assert_allclose(change, [impulse, 0.0], atol=1e-11)


@SETTINGS
@given(impulse=st.floats(-5.0, 5.0), direction=ANGLES)
def test_a_push_changes_the_robots_momentum(impulse: float, direction: float) -> None:
    before = np.arange(9.0)
    change = 4.0 * (robot_push(FloatingRobot(mass=4.0), before, impulse, direction) - before)
    expected = np.zeros(9)
    expected[2:4] = impulse * np.array([np.cos(direction), np.sin(direction)])
    np.testing.assert_allclose(change, expected, atol=1e-12)


def test_noise_has_the_deviation_asked_for() -> None:
    disturbances = Disturbances(seed=1)
    state, deviation = np.array([1.0, -2.0, 3.0]), np.array([0.0, 0.5, 2.0])
    draws = np.array([disturbances.measured(state, deviation) for _ in range(10_000)])
    np.testing.assert_allclose(draws.mean(axis=0), state, atol=0.05)
    np.testing.assert_allclose(draws.std(axis=0), deviation, rtol=0.03)
    assert (draws[:, 0] == 1.0).all()
    in_time = np.corrcoef(draws[1:, 1], draws[:-1, 1])[0, 1]
    between = np.corrcoef(draws[:, 1:].T)[0, 1]
    assert max(abs(in_time), abs(between)) < 0.03


def test_commands_are_lost_as_asked_and_directions_cover_the_circle() -> None:
    disturbances = Disturbances(seed=2)
    for probability, slack in ((0.0, 0.0), (0.2, 0.02), (1.0, 0.0)):
        lost = [disturbances.loses_command(probability) for _ in range(4000)]
        assert abs(np.mean(lost) - probability) <= slack
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


def relative_errors(plant: object, mismatch: float, seed: int) -> np.ndarray:
    nominal, disturbed = to_mapping(plant), to_mapping(mismatched(plant, mismatch, seed))
    assert list(nominal) == list(disturbed)
    return np.array([disturbed[name] / nominal[name] - 1.0 for name in nominal])


@SETTINGS
@given(mismatch=st.floats(0.0, 0.3), seed=st.integers(0, 2**40))
def test_errors_of_plants_are_bounded_and_follow_from_the_seed(mismatch: float, seed: int) -> None:
    for plant in (PENDULUM, FloatingRobot()):
        errors = relative_errors(plant, mismatch, seed)
        assert (np.abs(errors) <= mismatch * (1 + 1e-12) + 1e-12).all()
        assert mismatched(plant, mismatch, seed) == mismatched(plant, mismatch, seed)
        assert mismatched(plant, 0.0, seed) == plant
    gains = mismatched_gains(3, mismatch, seed)
    assert (np.abs(gains - 1.0) <= mismatch * (1 + 1e-12)).all()
    np.testing.assert_array_equal(gains, mismatched_gains(3, mismatch, seed))


def test_every_constant_and_gain_has_a_uniform_error_of_its_own() -> None:
    found = np.array([relative_errors(PENDULUM, 0.05, seed) for seed in range(200)])
    assert np.unique(found).size == found.size == 8 * 200
    assert abs(found.mean()) < 0.003
    assert abs(found.std() - 0.05 / np.sqrt(3)) < 0.002
    gains = mismatched_gains(3, 0.05, 7) - 1.0
    assert np.unique(gains).size == 3
    assert not np.allclose(gains, relative_errors(FloatingRobot(), 0.05, 7))
