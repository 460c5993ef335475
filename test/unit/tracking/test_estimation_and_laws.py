# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What is known of the state, and feedback laws: estimator, stuck sensors, regulators."""

from dataclasses import replace
import math

from closed_loop import HANGING, moved
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from tdm_planner.plants.base import integrate
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.tracking import linear_quadratic
from tdm_planner.tracking.estimator import (
    CommandHistory,
    EstimatorNoise,
    RepetitionWatch,
    StateEstimator,
)
from tdm_planner.tracking.linear_quadratic import discrete_regulator, discretise

PLANT = RotaryPendulum()
SENSORS, RATE_FLOOR = np.array([0.0015, 0.0015, 0.1, 0.1]), np.array([0.0, 0.0, 10.0, 10.0])
NOISE = EstimatorNoise(measurement=SENSORS, model=0.1, rate_floor=RATE_FLOOR)
FILTERED = [(9.81, 1.0, 0.2), (9.81, 0.03, 0.1), (10.5, 0.03, 0.5)]
TICK = 0.005
SETTINGS = settings(max_examples=12)
SEEDS = st.integers(0, 1000)
Q, R = np.diag([1.0, 0.5, 0.2, 0.1]), np.array([[3.0]])
DRIVEN = [(HANGING, 0.01, 0.11), ([0.3, 0.1, -8.0, 4.0], 1e-9, 0.11)]
DRIVEN += [([0.01, 0.0, 0.0, 0.0], 0.001, 0.42)]


@pytest.fixture
def estimator() -> StateEstimator:
    return StateEstimator(PLANT, NOISE, angles=[0], longest_gap=0.1)


@pytest.mark.parametrize('size', [1e3, 1e5, 1e7, 1e9, 1e12])
@pytest.mark.parametrize('index', range(4))
def test_an_absurd_sample_is_forgotten(estimator: StateEstimator, index: int, size: float) -> None:
    for k in range(1, 60):
        sample = HANGING + np.eye(4)[index] * (size if k in (20, 21) else 0.0)
        with np.errstate(all='ignore'):
            estimator.observe(sample, k * TICK)
    error = estimator.predict(60 * TICK) - HANGING
    assert abs(math.remainder(error[0], math.tau)) < 1e-3
    np.testing.assert_allclose(error[1:], 0.0, atol=0.01)


def test_history_splits_an_interval_at_the_commands() -> None:
    history = CommandHistory(1, 2.0)

    def pieces(*interval: float) -> list[tuple[float, float]]:
        return [(round(d, 9), float(u[0])) for d, u in history.between(*interval)]

    assert pieces(0.0, 0.5) == [(0.5, 0.0)]
    for time, torque in ((1.0, 1.0), (2.0, 2.0), (3.0, 3.0)):
        history.add(time, np.array([torque]))
    assert pieces(0.5, 2.25) == [(0.5, 0.0), (1.0, 1.0), (0.25, 2.0)]
    assert pieces(2.0, 2.1) == [(0.1, 2.0)]
    # a command for an earlier instant replaces those after it
    history.add(1.5, np.array([9.0]))
    assert pieces(1.0, 4.0) == [(0.5, 1.0), (2.5, 9.0)]
    for k in range(4000):
        history.add(5.0 + 0.005 * k, np.array([float(k)]))
    assert pieces(24.901, 24.904) == [(0.003, 3980.0)]
    assert len(history._times) < 1000
    history.clear()
    assert pieces(24.9, 25.0) == [(0.1, 0.0)]


@pytest.mark.parametrize(('gravity', 'least', 'most'), FILTERED)
def test_noise_is_filtered_as_well_as_the_model_is_right(gravity, least, most):
    estimator = StateEstimator(PLANT, replace(NOISE, least=least), [0], longest_gap=0.1)
    true, rng = RotaryPendulum(gravity=gravity), np.random.default_rng(1)
    state = moved(HANGING, -0.3, 0.0, 0.0, 0.0)
    raw, filtered = [], []
    for k in range(300):
        seen: np.ndarray = state + NOISE.measurement * rng.standard_normal(4)
        estimator.observe(seen, TICK * k)
        estimator.observe(seen + 1.0, TICK * k - 0.001)  # of the past: ignored
        raw.append(seen - state)
        filtered.append(estimator.predict(TICK * k) - state)
        state = integrate(true, state, np.zeros(1), TICK)
    for begin, share in ((20, 0.6), (100, most)):
        assert np.std(np.array(filtered)[begin:, 2]) < share * np.std(np.array(raw)[begin:, 2])
    assert np.abs(np.array(filtered)[20:, 0]).max() < 0.006


def delay_found(late: float, guess: float, seed: int, finds: bool = True) -> float:
    """Return the estimate after commands that acted `late` s late; few of them were changed."""
    estimator = StateEstimator(PLANT, NOISE, angles=[0], longest_gap=0.1, delay=guess)
    estimator.find_delay(finds)
    state, sent, noise = HANGING, CommandHistory(1, 2.0), np.random.default_rng(seed)
    command = np.array([0.03])
    for k in range(300):
        now = k * TICK
        estimator.observe(state + NOISE.measurement * noise.standard_normal(4), now)
        command = -command if noise.random() < 0.1 else command
        for history in (sent, estimator.history):
            history.add(now, command)
        for duration, control in sent.between(now - late, now + TICK - late):
            state = integrate(PLANT, state, control, duration)
    return estimator.delay


@SETTINGS
@given(st.floats(0.0, 0.008), st.floats(0.0, 0.006), SEEDS)
def test_the_delay_of_commands_is_found(late: float, guess: float, seed: int) -> None:
    assert delay_found(late, guess, seed) == pytest.approx(late, abs=1e-3)
    assert delay_found(late, guess, seed, finds=False) == guess


def test_the_delay_found_stays_near_the_guess() -> None:
    assert delay_found(0.018, 0.0, 1) == pytest.approx(0.01)
    assert delay_found(0.018, 0.014, 1) == pytest.approx(0.018, abs=1e-3)


def test_a_push_is_believed_at_once_and_after_a_gap_the_filter_starts_anew(estimator):
    for k in range(50):
        estimator.observe(HANGING, TICK * k)
    pushed = moved(HANGING, 0.0, 0.0, 8.0, 0.0)
    estimator.observe(pushed, 0.25)
    assert estimator.predict(0.25) == pytest.approx(pushed)
    elsewhere = np.array([1.0, 0.5, 0.0, 0.0])
    estimator.observe(elsewhere, 5.0)
    assert estimator.predict(5.0).tolist() == elsewhere.tolist()
    estimator.reset()
    assert estimator.stamp is None


class Sensor:
    """A watch on a pendulum, fed with samples 5 ms apart under a torque."""

    def __init__(self, estimator: StateEstimator) -> None:
        self.estimator, self.history, self.move = estimator, estimator.history, estimator.move
        self.watch = RepetitionWatch(estimator)
        self.time = 0.0

    def show(self, state: np.ndarray, torque: float) -> bool:
        self.history.add(self.time, np.array([torque]))
        self.time += TICK
        self.watch.observe(state, self.time)
        return self.watch.stuck

    def moves(self, state: np.ndarray, torque: float, count: int) -> bool:
        stuck = []
        for _ in range(count):
            state = self.move(state, np.array([torque]), TICK)
            stuck.append(self.show(state, torque))
        return not any(stuck)

    def until_stuck(self, state: np.ndarray, torque: float, longest: float = 1.0) -> float:
        begin = self.time
        while self.time - begin < longest:
            if self.show(state, torque):
                return self.time - begin
        return math.inf


@pytest.fixture
def sensor(estimator: StateEstimator) -> Sensor:
    return Sensor(estimator)


@pytest.mark.parametrize(('state', 'torque', 'within'), DRIVEN)
def test_a_sensor_that_repeats_itself_is_stuck(sensor, state, torque, within):
    for k in range(30):
        assert not sensor.show(np.add(state, 1e-6 * k), torque)
    assert sensor.until_stuck(np.array(state), torque) < within


def test_a_plant_that_moves_or_rests_is_not(sensor: Sensor) -> None:
    assert sensor.until_stuck(HANGING, 0.0, 2.0) == math.inf
    # nobody drives it: whether it rests or the sensor repeats itself is no matter
    assert sensor.until_stuck(np.array([0.5, 0.0, 0.0, 0.0]), 0.0, 2.0) == math.inf
    assert sensor.moves(HANGING, 0.01, 200)


@pytest.mark.parametrize('wait', range(20, 100))
def test_a_plant_that_a_command_has_not_reached_yet_is_not_stuck(sensor, wait) -> None:
    """Messages take their time, of commands and of states."""
    assert not any(sensor.show(HANGING, 0.0) for _ in range(wait))
    assert not any(sensor.show(HANGING, 1.0) for _ in range(3))
    assert sensor.moves(HANGING, 1.0, 20)


class Hover:
    """A point that a constant force holds up: z'' = u - g."""

    state_names, control_names = ('z', 'v'), ('u',)

    def derivative(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        return np.stack([state[..., 1], control[..., 0] - 9.81], axis=-1)


@pytest.mark.parametrize('window', [0.05, 0.2, 1.0, 2.0])
def test_a_plant_that_a_command_holds_at_rest_is_not_stuck(window: float) -> None:
    """Commands are remembered for as long as is looked back on."""
    noise = EstimatorNoise(np.array([1e-3, 1e-3]), 0.1, np.array([0.0, 1.0]))
    hover = Sensor(StateEstimator(Hover(), noise, [], longest_gap=window))
    resting = np.zeros(2)
    assert hover.until_stuck(resting, 9.81, 20.0 * window) == math.inf
    assert hover.until_stuck(resting, 30.0, 20.0 * window) < 10.0 * window


def test_what_rests_on_the_ground_until_a_command_holds_it_is_not_stuck() -> None:
    noise = EstimatorNoise(np.array([1e-3, 1e-3]), 0.1, np.array([0.0, 1.0]))
    hover, resting = Sensor(StateEstimator(Hover(), noise, [], longest_gap=0.1)), np.zeros(2)
    assert hover.until_stuck(resting, 0.0, 0.075) == math.inf
    assert hover.until_stuck(resting, 9.81, 1.0) == math.inf
    assert hover.until_stuck(resting, 30.0, 1.0) < 0.5


def test_it_stays_stuck_until_another_number_or_the_plant_should_rest(sensor: Sensor) -> None:
    state = np.array([0.005, 0.0, 0.0, 0.0])
    assert sensor.until_stuck(state, 0.02) < 0.3
    assert all(sensor.show(state, 0.0) for _ in range(300))
    assert not sensor.show(HANGING, 0.0)
    assert sensor.until_stuck(HANGING, 0.02) < 0.3
    shown = [sensor.show(HANGING, 0.0) for _ in range(100)]
    assert shown[0]
    assert not shown[-1]


def test_a_gap_of_any_length_is_no_matter(sensor: Sensor) -> None:
    """Not integrated over: an hour took minutes, a leap of simulated time for ever."""
    assert not sensor.show(HANGING, 0.02)
    sensor.time += 1.7e9
    assert not sensor.show(HANGING, 0.02)
    assert sensor.until_stuck(HANGING, 0.02) < 0.3


def system(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return 3.0 * rng.normal(size=(4, 4)), rng.normal(size=(4, 1))


def test_strong_controls_and_stiff_plants_have_a_transition_but_not_all_have_a_regulator() -> None:
    a, b = system(0)
    transition, held = discretise(a, b, 0.01)
    strongly = discretise(a, 1e9 * b, 0.01)
    np.testing.assert_array_equal(strongly[0], transition)
    np.testing.assert_allclose(strongly[1], 1e9 * held, rtol=1e-12)
    swinging = np.array([[0.0, 1.0], [-3e5, 0.0]])  # at 550 rad/s, light disks do
    transition, _ = discretise(swinging, np.zeros((2, 1)), 0.004)
    np.testing.assert_allclose(transition, expm(0.004 * swinging), rtol=1e-9)
    with pytest.raises(np.linalg.LinAlgError, match='too large'):
        discretise(1e9 * a, b, 0.01)
    a, b = np.diag([1.0, -1.0]), np.array([[0.0], [1.0]])  # cannot be stabilised
    with pytest.raises(ValueError, match='Riccati'):
        discrete_regulator(a, b, np.eye(2), np.eye(1), 0.01)


@SETTINGS
@given(seed=SEEDS)
def test_regulators_stabilise_and_are_the_limit_of_long_horizons(seed: int) -> None:
    a, b = system(seed)
    step = 0.02
    phi, gamma = discretise(a, b, step)
    exact = solve_discrete_are(phi, gamma, Q * step, R * step)
    steady = discrete_regulator(a, b, Q, R, step)
    assert np.allclose(steady.cost_to_go, exact)
    slowest = np.abs(np.linalg.eigvals(phi - gamma @ steady.gain)).max()
    assert slowest < 1
    n = 500 + int(np.log(1e-9) / (2.0 * np.log(slowest)))  # the end is forgotten to 1e-9
    many = np.tile(a, (n, 1, 1)), np.tile(b, (n, 1, 1))
    along = linear_quadratic.time_varying_regulator(*many, Q, R, Q, step)
    assert np.allclose(along.cost_to_go[0], exact, rtol=1e-5, atol=1e-6 * np.abs(exact).max())
    assert np.allclose(along.gain[0], steady.gain, rtol=1e-4, atol=1e-4)


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
