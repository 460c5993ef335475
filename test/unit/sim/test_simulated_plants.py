# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated plants: integrator, commands, wheel; pushes, noise, mismatched constants."""

from dataclasses import dataclass, replace
import math
from unittest.mock import Mock

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stated import Car
from tdm_planner.parameters import parameter, Range, to_mapping, Validated
from tdm_planner.plants.base import integrate
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_sim import simulation as simulated
from tdm_sim.simulation import mismatched, pendulum_push, PlantSetup, SimulatedPlant

SETTINGS = settings(max_examples=25)
ANGLES = st.floats(-10.0, 10.0)
PLANT, WHEELED = RotaryPendulum(), simulated.WheeledRobot(FloatingRobot())
HANGING = np.array([math.pi, 0.0, 0.0, 0.0])
MOVING, TORQUE = np.array([2.0, 0.3, -4.0, 3.0]), np.array([0.01])
LIMIT = np.array([0.02])
LIMITLESS = np.full((2, 2), [[-1e9], [1e9]])
SETUP = PlantSetup(PLANT, initial=HANGING, limits=np.array([-LIMIT, LIMIT]), noise=np.zeros(4))
SWINGING = replace(SETUP, initial=np.array([0.5, 0.2, 1.0, -2.0]))


@dataclass(frozen=True)
class Filled(Validated):
    """A plant with a constant that is a share."""

    level: float = parameter(0.5, 'share that is filled', allowed=Range(0.0, 1.0))
    inflows: list[float] = parameter([2.0, 1.0], 'of its pipes', allowed=Range(0.0, 2.0))


def simulation(setup: PlantSetup = SETUP, **changes) -> SimulatedPlant:
    return SimulatedPlant(replace(setup, **changes))


def test_the_integrator_agrees_with_an_independent_one_and_is_of_fourth_order() -> None:
    options = {'method': 'DOP853', 'rtol': 1e-13, 'atol': 1e-13}
    found = solve_ivp(lambda _, x: PLANT.derivative(x, TORQUE), (0.0, 0.4), MOVING, **options)
    exact = found.y[:, -1]
    np.testing.assert_allclose(integrate(PLANT, MOVING, TORQUE, 0.4), exact, atol=1e-8)
    ends = [integrate(PLANT, MOVING, TORQUE, 0.4, step) for step in (0.02, 0.01, 0.005)]
    errors = np.abs(np.array(ends) - exact).max(axis=1)
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([4.0, 4.0], abs=0.5)
    # Steps are equal and no longer than allowed.
    for duration, count in ((0.005, 5), (0.0051, 6)):
        watched = Mock(wraps=PLANT)
        integrate(watched, MOVING, TORQUE, duration, 1e-3)
        assert watched.derivative.call_count == 4 * count
    np.testing.assert_array_equal(integrate(PLANT, MOVING, TORQUE, 0.0), MOVING)
    with pytest.raises(ValueError, match='negative'):
        integrate(PLANT, MOVING, TORQUE, -0.1)


@SETTINGS
@given(command=st.floats(-1.0, 1.0), gain=st.none() | st.floats(0.5, 1.5))
def test_commands_are_clipped_to_the_limits_and_gains_act_on_what_saturates(command, gain):
    plant = simulation(gains=1.0 if gain is None else np.array([gain]))
    plant.command(np.array([command]))
    acting = min(max(command, -0.02), 0.02) * (1.0 if gain is None else gain)
    assert plant.control[0] == pytest.approx(acting, rel=1e-12)
    plant.step(0.02)
    expected = integrate(PLANT, HANGING, np.array([acting]), 0.02)
    np.testing.assert_allclose(plant.state, expected, atol=1e-12)


@pytest.mark.parametrize('step', [0.002, 0.03, 0.5])
def test_time_out_ends_the_command_at_its_instant_whatever_the_step(step: float) -> None:
    plant = simulation(command_timeout=0.1)
    plant.command(TORQUE)
    for _ in range(round(0.6 / step)):
        plant.step(step)
    driven = integrate(PLANT, HANGING, TORQUE, 0.1)
    free = integrate(PLANT, driven, np.array([0.0]), plant.time - 0.1)
    np.testing.assert_allclose(plant.state, free, atol=1e-8)
    assert (plant.timeouts, plant.commanded, plant.control[0]) == (1, False, 0.0)
    for _ in range(5):
        plant.command(TORQUE)
        plant.step(0.05)
    assert (plant.timeouts, plant.commanded) == (1, True)


@pytest.mark.parametrize('command', [[math.nan], [math.inf], [0.0, 0.0], []])
def test_malformed_commands_do_not_act(command: list[float]) -> None:
    plant = simulation()
    with pytest.raises(ValueError, match='1 finite number'):
        plant.command(np.array(command))
    assert not plant.commanded


def test_reset_goes_back_and_forgets_the_command() -> None:
    plant = simulation(SWINGING)
    plant.command(LIMIT)
    plant.step(0.05)
    assert not np.allclose(plant.state, SWINGING.initial)
    before = plant.state
    plant.setup = replace(SWINGING, plant=RotaryPendulum(mass=0.05))
    np.testing.assert_array_equal(plant.state, before)
    plant.reset()
    np.testing.assert_array_equal(plant.state, SWINGING.initial)
    assert (plant.timeouts, plant.commanded) == (0, False)
    plant.step(0.2)
    assert plant.timeouts == 0
    # a push too violent to integrate resets it too
    plant = simulation(SWINGING)
    plant.push(lambda state: pendulum_push(PLANT, state, 1e-4))
    np.testing.assert_array_equal(plant.state, pendulum_push(PLANT, SWINGING.initial, 1e-4))
    plant.push(lambda state: state + np.array([0.0, 0.0, 1e200, 0.0]))
    plant.step(0.01)
    assert plant.breakdowns == 1
    assert np.isfinite(plant.state).all()
    # a stated plant says so itself: its rates are too quick for the steps
    stiff = DirectPlant(Car(drag=1e9))
    setup = PlantSetup(stiff, np.array([0.0, 0.0, 9.0, 9.0]), LIMITLESS, noise=np.zeros(4))
    plant = simulation(setup)
    plant.step(0.1)
    assert plant.breakdowns == 1
    np.testing.assert_array_equal(plant.state, setup.initial)


@SETTINGS
@given(torque=st.floats(-0.02, 0.02), omega=st.floats(-2.0, 2.0), wheel=st.floats(-50.0, 50.0))
def test_the_wheel_takes_up_the_angular_momentum(torque, omega, wheel):
    start = np.array([1.0, 2.0, 0.1, -0.2, 0.3, omega, 0.5, 0.0, wheel])
    control = np.array([0.5, 1.0, torque])
    end = integrate(WHEELED, start, control, 1.0, 0.01)
    robot = WHEELED.robot
    before, after = (
        robot.inertia * x[5] + robot.wheel_inertia * (x[5] + x[8]) for x in (start, end)
    )
    assert after == pytest.approx(before, abs=1e-9)
    # constant torque: the wheel's angle grows with the mean of its speeds
    assert end[7] == pytest.approx(0.5 * (start[8] + end[8]), abs=1e-9)
    alone = integrate(WHEELED.robot, start[:7], control, 1.0, 0.01)
    np.testing.assert_allclose(end[:7], alone, atol=1e-12)


@SETTINGS
@given(state=st.tuples(ANGLES, ANGLES, ANGLES, ANGLES), push=st.floats(-5.0, 5.0), way=ANGLES)
def test_a_push_changes_momentum_alone(state: tuple[float, ...], push: float, way: float) -> None:
    before, impulse = np.array(state), 1e-3 * push
    after = pendulum_push(PLANT, before, impulse)
    np.testing.assert_array_equal(after[:2], before[:2])
    # Generalized momenta are the energy's derivatives by the rates, in which it is quadratic.
    for column, expected in ((2, impulse), (3, 0.0)):
        h = 1e-3 * np.eye(4)[column]
        momenta = [(PLANT.energy(x + h) - PLANT.energy(x - h)) / 2e-3 for x in (before, after)]
        assert momenta[1] - momenta[0] == pytest.approx(expected, abs=1e-11)
    robot = np.arange(9.0)
    change = 4.0 * (simulated.robot_push(FloatingRobot(mass=4.0), robot, push, way) - robot)
    along = push * np.cos(way), push * np.sin(way)
    np.testing.assert_allclose(change, [0, 0, *along, 0, 0, 0, 0, 0], atol=1e-12)


def test_disturbances_are_as_asked() -> None:
    deviation = np.array([0.0, 0.5, 2.0, 0.0])
    plant = SimulatedPlant(replace(SWINGING, noise=deviation), seed=1)
    draws = np.array([plant.measure() for _ in range(10_000)])
    np.testing.assert_allclose(draws.mean(axis=0), plant.state, atol=0.05)
    np.testing.assert_allclose(draws.std(axis=0), deviation, rtol=0.03)
    in_time = np.corrcoef(draws[1:, 1], draws[:-1, 1])[0, 1]
    between = np.corrcoef(draws[:, 1:3].T)[0, 1]
    assert max(abs(in_time), abs(between)) < 0.03
    angles = np.array([plant.direction() for _ in range(4000)])
    assert np.abs(np.exp(1j * angles).mean()) < 0.05
    assert np.histogram(angles, bins=8, range=(-np.pi, np.pi))[0].min() > 400


@SETTINGS
@given(mismatch=st.floats(0.0, 0.3), seed=st.integers(0, 2**40))
def test_errors_of_plants_are_bounded_and_follow_from_the_seed(mismatch: float, seed: int) -> None:
    most = mismatch * (1 + 1e-12) + 1e-12
    for plant in (PLANT, FloatingRobot()):
        made = mismatched(plant, mismatch, seed)
        nominal, disturbed = to_mapping(plant), to_mapping(made)
        assert list(nominal) == list(disturbed)
        assert all(abs(disturbed[n] - value) <= most * value for n, value in nominal.items())
        assert mismatched(plant, mismatch, seed) == made
        assert mismatched(plant, 0.0, seed) == plant
    full = mismatched(Filled(1.0), mismatch, seed)
    assert 1.0 - most <= full.level <= 1.0
    first, second = full.inflows
    assert 0.0 <= 2.0 - first <= 2.0 * most
    assert abs(second - 1.0) <= most
    assert mismatch < 1e-3 or first != 2.0 * second
    gains, again = (
        simulated.robot_actuators(RobotLimits(), mismatch, seed)['gains'] for _ in range(2)
    )
    assert (np.abs(gains - 1.0) <= mismatch * (1 + 1e-12)).all()
    assert gains[1] == 1.0
    np.testing.assert_array_equal(gains, again)


def test_noise_is_in_the_measurement_alone_and_streams_do_not_disturb_each_other() -> None:
    plant, quiet = simulation(SWINGING, noise=np.full(4, 0.1)), simulation(SWINGING)
    for _ in range(3):
        plant.step(0.01)
        quiet.step(0.01)
        assert (plant.measure() != plant.state).all()
    np.testing.assert_array_equal(plant.state, quiet.state)
    np.testing.assert_array_equal(quiet.measure(), quiet.state)
    # one seed, one sequence
    noisy = replace(SWINGING, noise=np.ones(4))
    one, two, other = (SimulatedPlant(noisy, seed) for seed in (5, 5, 6))
    two.direction()
    first = one.measure()
    np.testing.assert_array_equal(first, two.measure())
    assert not np.array_equal(first, other.measure())


@pytest.mark.parametrize('after', ['zero', 'silence', 'long'])
def test_a_held_plant_that_is_reset_is_held_against_commands_that_go_on(after: str) -> None:
    plant = simulation(SWINGING, held=True)
    plant.command(0.0 * LIMIT)
    plant.step(0.05)
    assert plant.held
    plant.command(LIMIT)
    plant.step(0.05)
    assert not plant.held
    plant.reset()
    for _ in range(round(simulated.LONGEST_GOING_ON / 0.05) if after == 'long' else 9):
        plant.command(LIMIT)
        plant.step(0.05)
        assert plant.held
        np.testing.assert_array_equal(plant.state, SWINGING.initial)
    if after == 'zero':
        plant.command(0.0 * LIMIT)
        assert plant.held
    if after == 'silence':
        plant.step(0.06)
    plant.command(LIMIT)
    assert not plant.held
    plant.reset()
    plant.released = True  # by a plan that is executed
    plant.command(LIMIT)
    assert not plant.held
