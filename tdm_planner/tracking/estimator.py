# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The state at any instant, from late and noisy samples and the commands sent meanwhile.

With it come what a robot's actuators deliver, what the pendulum's constants are against those of
the model, and whether a sensor repeats itself.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.base import integrate, Plant, StatedPlant
from tdm_planner.plants.floating_robot import FloatingRobot, RobotInertia
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.tracking.tracker_parameters import (
    PendulumEstimatorParameters,
    RobotTrackerParameters,
)

Array = NDArray[np.float64]

LARGEST_STEP = 5e-3  # s, of a prediction, unless a plant needs shorter ones
_HISTORY = 2.0  # s of commands that are remembered
GAIN_UNKNOWN = 1e3  # standard deviation of gains that nothing measures directly
_LARGEST_SURPRISE = 20.0  # standard deviations; a push or a reset, not noise
_ILL_CONDITIONED = 1e6  # times the prior standard deviation: rounding outweighs what is known
_YAW, _OMEGA, _ALPHA, _THRUST_GAIN, _WHEEL_GAIN = 4, 5, 6, 7, 8
_GAIN_RANGE = (0.5, 2.0)  # of the estimated actuator gains
_ACTUATORS_SPREAD = 0.1  # standard deviation of an actuator's gain before anything is known of it
GAINS = 'gravity_gain', 'arm_gain', 'disk_gain', 'coupling_gain', 'torque_gain'
_FINE = 0.1  # of the time scale of the quickest swings: steps of gains and predictions, at most
_RATE_NOISE = 0.0094  # of w0; .1 rad/s of the default rig
# Rates below this share of w0^2 count as that: the estimator must not trust the model blindly.
_RATE_FLOOR = 0.1
_LASTING = 0.05  # 1 / w0 for which an error of the model's accelerations stays the same
_UNMISTAKABLE = 20.0  # standard deviations of the measurement
_ON_ITS_WAY = 0.25  # of a window that a command and the state after it may take
_LONGEST = 4  # windows without a change that are looked at together
_GAIN_SPREAD = 0.05  # standard deviation of the gains before anything is known of them


class DifferentiablePlant(Plant, Protocol):
    """A plant with the derivatives of its equations of motion."""

    def jacobians(self, state: Array, control: Array) -> tuple[Array, Array]:
        """Return df/dx (..., nx, nx) and df/du (..., nx, nu)."""


class PlantWithGains(StatedPlant):
    """A plant with more states: constant gains of its model, that are estimated with the rest."""

    def __init__(self, plant: StatedPlant) -> None:
        self._plant = plant

    @property
    def coefficients(self) -> Any:
        """Constants of the equations of motion."""
        return self._plant.coefficients


class CommandHistory:
    """The controls sent, each acting from its instant to the next; zero before the first."""

    def __init__(self, size: int) -> None:
        self._zero = np.zeros(size)
        self._times: list[float] = []
        self._controls: list[Array] = []

    def add(self, time: float, control: Array) -> None:
        """Note that `control` (nu,) acts from `time` [s] on, in place of later ones."""
        while self._times and self._times[-1] >= time:
            self._times.pop()
            self._controls.pop()
        self._times.append(time)
        self._controls.append(control)
        if self._times[0] < time - 2 * _HISTORY:
            kept = bisect_right(self._times, time - _HISTORY) - 1
            del self._times[:kept], self._controls[:kept]

    def adopt(self, other: CommandHistory) -> None:
        """Go on from another history of the same controls."""
        self._times, self._controls = list(other._times), list(other._controls)

    def clear(self) -> None:
        """Forget every command."""
        self._times.clear()
        self._controls.clear()

    def between(self, start: float, end: float) -> Iterator[tuple[float, Array]]:
        """Durations [s] and controls that make up [start, end]."""
        index = bisect_right(self._times, start)
        time = start
        while time < end:
            control = self._controls[index - 1] if index else self._zero
            until = min(self._times[index], end) if index < len(self._times) else end
            yield until - time, control
            time = until
            index += 1


@dataclass(frozen=True, eq=False)
class EstimatorNoise:
    """
    What the samples and the model are worth.

    `measurement` (nx,) are the standard deviations of the measured states; `model` is the relative
    error of the plant's rates, which stays about the same for `lasting` s. `rate_floor` (nx,) is
    the least magnitude of a rate that is assumed; 0 where rates are exact (of positions).
    `prior` (nx,), by default `measurement`, are the standard deviations after the first sample.
    """

    measurement: Array
    model: float
    rate_floor: Array
    prior: Array | None = None
    lasting: float = 0.0


class StateEstimator:
    """
    An extended Kalman filter in continuous-discrete form (Gelb, "Applied Optimal Estimation").

    Samples carry the instant they were taken; between samples the estimate follows the plant's
    equations of motion under the commands noted in its `history`. `angles` (nx,) marks states that
    sensors may report modulo 2 pi: the estimate runs on continuously. A sample that noise and
    model cannot explain (a push, a reset) is believed. After one that is absurd, so that nothing
    can be predicted from it, the estimate begins anew. No step of the prediction is longer than
    `longest_step` s.
    """

    def __init__(
        self,
        plant: DifferentiablePlant,
        noise: EstimatorNoise,
        angles: NDArray[np.bool_],
        longest_gap: float,
        longest_step: float = LARGEST_STEP,
    ) -> None:
        self._plant = plant
        self.noise = noise
        self._angles, self.size = angles, angles.size
        self.history = CommandHistory(len(plant.control_names))
        self._longest_gap, self._longest_step = longest_gap, longest_step
        self._driven = noise.rate_floor > 0.0
        self._measurement_covariance = np.diag(noise.measurement**2)
        prior = noise.measurement if noise.prior is None else noise.prior
        self._prior_covariance = np.diag(prior**2)
        self.stamp: float | None = None
        self._state = np.zeros(angles.size)
        self._covariance = self._prior_covariance

    def reset(self) -> None:
        """Forget every sample."""
        self.stamp = None

    def observe(self, state: Array, stamp: float) -> None:
        """Take a measured state (nx,) of the instant `stamp` [s]; older ones are ignored."""
        if self.stamp is not None and stamp <= self.stamp:
            return
        known = self.stamp is not None and stamp - self.stamp <= self._longest_gap
        if known:
            self._propagate(stamp)
            most = _ILL_CONDITIONED**2 * np.diag(self._prior_covariance)
            known = bool((np.diag(self._covariance) <= most).all())
        if known:
            self._correct(state)
        else:
            self._state, self._covariance = state.copy(), self._prior_covariance
        self.stamp = stamp

    def predict(self, time: float) -> Array:
        """State (nx,) at `time` [s], not before the newest sample's stamp."""
        assert self.stamp is not None
        state = self._state
        for duration, control in self.history.between(self.stamp, time):
            state = self.move(state, control, duration)
        return state

    def move(self, state: Array, control: Array, duration: float) -> Array:
        """State (nx,) after `duration` s under a held control (nu,), as the model has it."""
        return integrate(self._plant, state, control, duration, self._longest_step)

    def _propagate(self, until: float) -> None:
        assert self.stamp is not None
        noise = self.noise
        for duration, control in self.history.between(self.stamp, until):
            slope, _ = self._plant.jacobians(self._state, control)
            rates = self._plant.derivative(self._state, control)
            spread = noise.model * np.maximum(np.abs(rates), noise.rate_floor) * self._driven
            step = slope * duration
            transition = np.eye(step.shape[0]) + step + 0.5 * step @ step
            self._covariance = transition @ self._covariance @ transition.T
            # The model's error is about constant for a while: until then it adds up with the time.
            lasting = max(duration, noise.lasting)
            self._covariance += np.diag(spread**2 * duration * lasting)
            self._state = self.move(self._state, control, duration)

    def _correct(self, measured: Array) -> None:
        innovation = measured - self._state
        turns = np.round(innovation / math.tau) * self._angles
        innovation = innovation - math.tau * turns
        total = self._covariance + self._measurement_covariance
        if innovation @ np.linalg.solve(total, innovation) > _LARGEST_SURPRISE**2:
            self._state = self._state + innovation
            self._covariance = self._prior_covariance
            return
        gain = np.linalg.solve(total, self._covariance).T
        self._state = self._state + gain @ innovation
        covariance = self._covariance - gain @ self._covariance
        self._covariance = 0.5 * (covariance + covariance.T)


class RepetitionWatch:
    """
    Notices a driver that goes on publishing, with fresh stamps, what it measured long ago.

    Samples that stay the same to the last bit for `window` s, twice or four times as long are
    compared with the motion that the commands sent since must have caused. If that is far beyond
    the noise, the sensor is `stuck`, until it shows another number or the plant should rest. The
    last commands may be on their way still: they are ignored. What happens in gaps of more than
    `window` s between samples is not judged.
    """

    def __init__(self, estimator: StateEstimator, window: float) -> None:
        self._estimator = estimator
        self._window = window
        self._sample: Array | None = None
        self._since = self._last = 0.0
        self._next = 1
        self.stuck = False

    def observe(self, state: Array, stamp: float) -> None:
        """Take a sample (nx,) of the instant `stamp` [s], later than that of the one before."""
        sample, before, self._last = self._sample, self._last, stamp
        if sample is None or not np.array_equal(state, sample) or stamp <= self._since:
            self._sample, self.stuck = state.copy(), False
            self._begin(stamp)
        elif stamp - before > self._window:
            self._begin(stamp)
        elif stamp - self._since >= self._next * self._window:
            self._judge(sample, stamp)

    def adopt(self, other: RepetitionWatch) -> None:
        """Go on with what another watch of the same sensor has seen."""
        self._sample, self.stuck = other._sample, other.stuck
        self._since, self._last, self._next = other._since, other._last, other._next

    def _begin(self, stamp: float) -> None:
        self._since, self._next = stamp, 1

    def _judge(self, sample: Array, stamp: float) -> None:
        """Compare with what the model makes of the commands sent while nothing changed."""
        estimator = self._estimator
        state, driven = sample, False
        seen = stamp - _ON_ITS_WAY * self._window
        for duration, control in estimator.history.between(self._since, seen):
            state = estimator.move(state, control, duration)
            driven = driven or bool(control.any())
        far = _UNMISTAKABLE * estimator.noise.measurement
        moves = not bool((np.abs(state - sample) <= far).all())
        # A plant without commands may rest where the model does not.
        self.stuck = moves and (driven or self.stuck)
        if self.stuck:
            self._begin(stamp)
            self._next = _LONGEST  # about upright it takes that long to tell falling from resting
        elif self._next >= _LONGEST:
            self._begin(stamp)
        else:
            self._next *= 2


class EstimatedRobot(PlantWithGains):
    """The floating robot with two more states: what thruster and wheel deliver per command."""

    state_names = (*FloatingRobot.state_names, 'thrust_gain', 'torque_gain')
    state_units = (*FloatingRobot.state_units, '', '')
    control_names = FloatingRobot.control_names
    control_units = FloatingRobot.control_units

    @staticmethod
    def equations(
        k: RobotInertia, state: Sequence[Any], control: Sequence[Any]
    ) -> tuple[Any, ...]:
        """Return the rates of the states; the arguments may hold numbers, arrays or symbols."""
        *motion, thrust_gain, torque_gain = state
        thrust, rate, torque = control
        given = thrust_gain * thrust, rate, torque_gain * torque
        return (*FloatingRobot.equations(k, motion, given), 0.0, 0.0)


def actuator_gains(state: Array) -> tuple[float, float]:
    """Return the estimated gains of thruster and wheel, kept within reason."""
    lower, upper = _GAIN_RANGE
    thruster, wheel = state[[_THRUST_GAIN, _WHEEL_GAIN]].tolist()
    return min(max(thruster, lower), upper), min(max(wheel, lower), upper)


def robot_estimator(parameters: RobotTrackerParameters) -> StateEstimator:
    """Return the estimator of a robot's states and of its actuators' gains (9,)."""
    assumed, limits, plant = parameters.estimator, parameters.limits, parameters.plant
    push, spin = limits.thrust / plant.mass, limits.torque / plant.inertia
    measured = [assumed.position_noise] * 2 + [assumed.velocity_noise] * 2
    measured += [assumed.angle_noise] * 2 + [assumed.thruster_noise]
    noise = EstimatorNoise(
        measurement=np.array(measured + [GAIN_UNKNOWN] * 2),
        model=assumed.model_error,
        rate_floor=np.array([0.0, 0.0, push, push, 0.0, spin, 0.0, 0.0, 0.0]),
        prior=np.array(measured + [_ACTUATORS_SPREAD] * 2),
    )
    angles = np.zeros(9, dtype=bool)
    angles[[_YAW, _ALPHA]] = True
    return StateEstimator(EstimatedRobot(plant), noise, angles, parameters.state_timeout)


class EstimatedPendulum(PlantWithGains):
    """
    The pendulum with five more states: its constants over those of the model.

    The pendulum's own inertia is the model's: only ratios of inertias and torques matter. Those of
    the coupling and of what the disk feels of a tilted pendulum hardly differ.
    """

    state_names = (*RotaryPendulum.state_names, *GAINS)
    state_units = (*RotaryPendulum.state_units, *[''] * len(GAINS))
    control_names = RotaryPendulum.control_names
    control_units = RotaryPendulum.control_units

    @staticmethod
    def equations(
        k: Coefficients, state: Sequence[Any], control: Sequence[Any]
    ) -> tuple[Any, ...]:
        """Return the rates of the states; the arguments may hold numbers, arrays or symbols."""
        *motion, gravity, arm, disk, coupling, motor = state
        true = k._replace(
            gravity=gravity * k.gravity,
            arm=arm * k.arm,
            disk=disk * k.disk,
            coupling=coupling * k.coupling,
            disk_sine=coupling * k.disk_sine,
        )
        torque = [motor * part for part in control]
        return (*RotaryPendulum.equations(true, motion, torque), *[0.0] * len(GAINS))


def longest_step(plant: RotaryPendulum) -> float:
    """Return the longest step [s] in which a prediction is accurate."""
    return min(LARGEST_STEP, _FINE / plant.natural_frequency / plant.quickness)


def pendulum_estimator(
    plant: RotaryPendulum, assumed: PendulumEstimatorParameters, longest_gap: float
) -> StateEstimator:
    """Return the estimator of the pendulum's states and of the gains (9,)."""
    frequency, rate_noise = plant.natural_frequency, assumed.rate_noise
    if rate_noise is None:
        rate_noise = _RATE_NOISE * frequency
    measured, gains = [assumed.angle_noise] * 2 + [rate_noise] * 2, len(GAINS)
    noise = EstimatorNoise(
        measurement=np.array(measured + [GAIN_UNKNOWN] * gains),
        model=assumed.model_error,
        rate_floor=_RATE_FLOOR * frequency**2 * np.array([0.0, 0.0, 1.0, 1.0] + [0.0] * gains),
        lasting=_LASTING / frequency,
        prior=np.array(measured + [_GAIN_SPREAD] * gains),
    )
    angles = np.array([True] + [False] * (3 + gains))
    estimated, step = EstimatedPendulum(plant), longest_step(plant)
    return StateEstimator(estimated, noise, angles, longest_gap, step)
