# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_sim.disturbances import pendulum_push
from tdm_sim.integrator import integrate
from tdm_sim.simulation import PlantSetup, SimulatedPlant

PLANT = RotaryPendulum()
HANGING = np.array([math.pi, 0.0, 0.0, 0.0])
SETUP = PlantSetup(
    plant=PLANT,
    initial=HANGING,
    lower=np.array([-0.02]),
    upper=np.array([0.02]),
    noise=np.zeros(4),
)
SWINGING = replace(SETUP, initial=np.array([0.5, 0.2, 1.0, -2.0]))
SETTINGS = settings(deadline=None, max_examples=25, derandomize=True)


def simulation(setup: PlantSetup = SETUP, **changes: Any) -> SimulatedPlant:
    return SimulatedPlant(replace(setup, **changes))


def test_energy_is_kept_without_torque() -> None:
    plant = simulation(SWINGING)
    energies = [PLANT.energy(plant.state)]
    for _ in range(400):
        plant.step(0.005)
        energies.append(PLANT.energy(plant.state))
    # what the Runge-Kutta steps of 1 ms leave
    assert np.ptp(energies) < 1e-7 * PLANT.coefficients.gravity
    assert plant.time == pytest.approx(2.0)


def test_rest_stays_rest() -> None:
    plant = simulation()
    plant.step(1.0)
    np.testing.assert_allclose(plant.state, HANGING, atol=1e-12)


@SETTINGS
@given(command=st.floats(-1.0, 1.0))
def test_commands_are_clipped_to_the_limits(command: float) -> None:
    plant = simulation()
    plant.command(np.array([command]))
    clipped = min(max(command, -0.02), 0.02)
    assert plant.control[0] == clipped
    plant.step(0.02)
    np.testing.assert_allclose(
        plant.state, integrate(PLANT, HANGING, np.array([clipped]), 0.02), atol=1e-12
    )


def test_gains_act_on_what_saturates() -> None:
    plant = simulation(gains=np.array([0.9]))
    plant.command(np.array([5.0]))
    assert plant.control[0] == pytest.approx(0.018)


@pytest.mark.parametrize('step', [0.002, 0.03, 0.5])
def test_time_out_ends_the_command_at_its_instant_whatever_the_step(step: float) -> None:
    plant = simulation(command_timeout=0.1)
    plant.command(np.array([0.01]))
    for _ in range(round(0.6 / step)):
        plant.step(step)
    driven = integrate(PLANT, HANGING, np.array([0.01]), 0.1)
    free = integrate(PLANT, driven, np.array([0.0]), plant.time - 0.1)
    np.testing.assert_allclose(plant.state, free, atol=1e-8)
    assert plant.timeouts == 1
    assert not plant.commanded
    assert plant.control[0] == 0.0


def test_repeated_commands_never_time_out() -> None:
    plant = simulation(command_timeout=0.1)
    for _ in range(50):
        plant.command(np.array([0.01]))
        plant.step(0.05)
    assert plant.timeouts == 0
    assert plant.commanded


def test_lost_commands_do_not_act() -> None:
    plant = simulation(command_loss=1.0)
    plant.command(np.array([0.01]))
    assert not plant.commanded


@pytest.mark.parametrize('command', [[math.nan], [math.inf], [0.0, 0.0], []])
def test_malformed_commands_are_refused_and_do_not_act(command: list[float]) -> None:
    plant = simulation()
    with pytest.raises(ValueError, match='1 finite number'):
        plant.command(np.array(command))
    assert not plant.commanded


def test_reset_goes_back_and_forgets_the_command() -> None:
    plant = simulation(SWINGING)
    plant.command(np.array([0.02]))
    plant.step(0.05)
    assert not np.allclose(plant.state, SWINGING.initial)
    plant.reset()
    np.testing.assert_array_equal(plant.state, SWINGING.initial)
    assert not plant.commanded
    assert plant.timeouts == 0


def test_push_acts_at_once() -> None:
    plant = simulation()
    plant.push(lambda state: pendulum_push(PLANT, state, 1e-4))
    np.testing.assert_array_equal(plant.state, pendulum_push(PLANT, HANGING, 1e-4))
    # At rest, the work of an impulse is impulse times the mean of the rates before and after.
    work = PLANT.energy(plant.state) - PLANT.energy(HANGING)
    assert work == pytest.approx(0.5 * 1e-4 * plant.state[2], rel=1e-9)


def test_noise_is_in_the_measurement_and_not_in_the_motion() -> None:
    deviation = np.array([0.0015, 0.0015, 0.1, 0.1])
    plant, quiet = simulation(SWINGING, noise=deviation), simulation(SWINGING)
    errors = []
    for _ in range(2000):
        plant.step(0.001)
        errors.append(plant.measure() - plant.state)
    for _ in range(2000):
        quiet.step(0.001)
    np.testing.assert_array_equal(plant.state, quiet.state)
    np.testing.assert_array_equal(quiet.measure(), quiet.state)
    np.testing.assert_allclose(np.std(errors, axis=0), deviation, rtol=0.1)


def test_a_motion_too_violent_to_integrate_resets_the_plant() -> None:
    plant = simulation(SWINGING)
    plant.push(lambda state: state + np.array([0.0, 0.0, 1e200, 0.0]))
    with np.errstate(all='ignore'):
        plant.step(0.01)
    assert plant.breakdowns == 1
    assert np.isfinite(plant.state).all()


def test_a_new_setup_acts_without_a_jump() -> None:
    plant = simulation(SWINGING)
    plant.step(0.1)
    before = plant.state
    plant.setup = replace(SWINGING, plant=RotaryPendulum(mass=0.05))
    np.testing.assert_array_equal(plant.state, before)


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'initial': np.zeros(3)}, "'initial' must be 4 finite numbers"),
        ({'initial': np.array([math.nan, 0, 0, 0])}, "'initial' must be 4 finite numbers"),
        ({'noise': np.array([-1.0, 0, 0, 0])}, "'noise' must be standard deviations"),
        ({'lower': np.array([0.1])}, "'lower' must not exceed 'upper'"),
        ({'gains': np.ones(2)}, "'gains' must be 1 finite number"),
    ],
)
def test_wrong_setups_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidProblem, match=words):
        replace(SETUP, **changes)
