# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Tracking of a swing-up: time-varying LQR along the plan, then LQR about upright.

The torque over the coming command interval is

    T = mean of the planned torque - K(t) (x - x_plan(t)),

saturated at the actuator's limit, of which the plan leaves a share to the feedback. Before the
plan's end the regulator about upright takes over as soon as the state is inside the largest level
set of its cost to go, x'P x <= T_max^2 / (K P^-1 K'), in which its torque does not saturate.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.plants.rotary_pendulum import PendulumMotor, RotaryPendulum
from tdm_planner.tracking.estimator import CommandHistory, EstimatorNoise, StateEstimator
from tdm_planner.tracking.feedforward import Feedforward
from tdm_planner.tracking.linear_quadratic import (
    discrete_regulator,
    Regulator,
    time_varying_regulator,
    TimeVaryingRegulator,
)
from tdm_planner.tracking.tracker import (
    Action,
    Motion,
    TrajectoryRefused,
    TrajectoryTracker,
    wrapped,
)
from tdm_planner.tracking.tracker_parameters import NOISE, TrackerParameters
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_GAIN_STEP = 5e-3  # s between the gains along a plan
_MOST_GAINS = 12_000  # along a minute; a longer plan has them further apart
_CAPTURE_SHARE = 0.5  # of the plan's duration before which capture is not looked for
# Rates below this share of w0^2 count as that: the estimator must not trust the model blindly.
_RATE_FLOOR = 0.1
# Recovery: stiffness and damping of the disk relative to the pendulum's natural frequency; chosen
# for the quickest decay over strong and weak motors. Calm: angles in rad, rates in units of w0.
_RECOVERY_STIFFNESS, _RECOVERY_DAMPING = 0.3, 0.4
_CALM = np.array([0.3, 0.5, 0.3, 0.1])


@dataclass(frozen=True)
class FeedbackWeights(Validated):
    """
    Weights of the quadratic cost on dimensionless deviations.

    Angles count in rad, rates in units of the pendulum's natural frequency, torque in units of
    limits.torque.
    """

    theta: float = parameter(1.0, "weight of the pendulum's angle", allowed=POSITIVE)
    psi: float = parameter(0.1, "weight of the disk's angle", allowed=POSITIVE)
    theta_dot: float = parameter(1.0, "weight of the pendulum's rate", allowed=POSITIVE)
    psi_dot: float = parameter(0.1, "weight of the disk's rate", allowed=POSITIVE)
    torque: float = parameter(2.0, 'weight of the feedback torque', allowed=POSITIVE)


@dataclass(frozen=True)
class EstimatorParameters(Validated):
    """What the state estimator assumes."""

    angle_noise: float = parameter(
        0.0015, 'standard deviation of measured angles', unit='rad', allowed=NOISE
    )
    rate_noise: float = parameter(
        0.1, 'standard deviation of measured rates', unit='rad/s', allowed=NOISE
    )
    model_error: float = parameter(
        0.1, "relative error of the model's accelerations", allowed=NOISE
    )


@dataclass(frozen=True)
class PendulumTrackerParameters(TrackerParameters):
    """Parameters of the pendulum's tracker."""

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumMotor = group(PendulumMotor)
    weights: FeedbackWeights = group(FeedbackWeights)
    estimator: EstimatorParameters = group(EstimatorParameters)


@dataclass(frozen=True, eq=False)
class SwingUpLaw:
    """What is prepared before the start: feedforward and gains every `step` s of the plan."""

    feedforward: Feedforward
    regulator: TimeVaryingRegulator
    step: float
    trajectory: Trajectory = field(repr=False)

    def gain(self, elapsed: float) -> Array:
        """Gain (1, 4) at `elapsed` s after the start."""
        last = len(self.regulator.gains) - 1
        return np.asarray(self.regulator.gains[min(max(round(elapsed / self.step), 0), last)])


class PendulumTracker(TrajectoryTracker):
    """Tracker of the rotary pendulum; states theta, psi, theta_dot, psi_dot, control torque."""

    parameters: PendulumTrackerParameters

    def __init__(self, parameters: PendulumTrackerParameters) -> None:
        plant = parameters.plant
        history = CommandHistory(1)
        super().__init__(parameters, _estimator(parameters, history), history)
        frequency = plant.natural_frequency
        weights, limit = parameters.weights, parameters.limits.torque
        scale = np.array([1.0, 1.0, frequency, frequency])
        diagonal = np.array([weights.theta, weights.psi, weights.theta_dot, weights.psi_dot])
        self._q = np.diag(diagonal / scale**2)
        self._r = np.array([[weights.torque / limit / limit]])

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the plant's states."""
        return RotaryPendulum.state_names

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the plant's controls."""
        return RotaryPendulum.control_names

    @cached_property
    def upright(self) -> Regulator:
        """Regulator about upright for torques held over a command interval."""
        a, b = self.parameters.plant.linearise('upright')
        try:
            return discrete_regulator(a, b, self._q, self._r, self.parameters.interval)
        except ValueError as error:
            raise InvalidProblem(
                "parameters 'plant.*', 'weights.*' and 'limits.torque' allow no feedback about "
                f'upright: {error}'
            ) from None

    @cached_property
    def capture_level(self) -> float:
        """Cost to go about upright below which its regulator does not saturate."""
        gain, cost = self.upright.gain, self.upright.cost_to_go
        spread = float((gain @ np.linalg.solve(cost, gain.T))[0, 0])
        return float(self.parameters.limits.torque**2 / spread)

    def prepare_hold(self) -> None:
        """Compute the gains about upright now rather than when they are first needed."""
        _ = self.capture_level

    def prepare(self, trajectory: Trajectory) -> SwingUpLaw:
        """Compute the gains along the plan."""
        plant = self.parameters.plant
        smooth = (
            trajectory if trajectory.rates is not None else trajectory.with_rates(plant.derivative)
        )
        steps = min(max(1, round(trajectory.duration / _GAIN_STEP)), _MOST_GAINS)
        step = trajectory.duration / steps
        times = trajectory.times[0] + step * (np.arange(steps) + 0.5)
        sample = smooth.sample(times)
        a, b = plant.jacobians(sample.state, sample.control)
        terminal = self.upright.cost_to_go
        try:
            along = time_varying_regulator(a, b, self._q, self._r, terminal, step)
        except ValueError as error:
            raise TrajectoryRefused(
                f'there is no feedback along the trajectory: {error}'
            ) from None
        if not np.isfinite(along.gains).all():
            raise TrajectoryRefused('there is no finite feedback along the trajectory')
        return SwingUpLaw(Feedforward(trajectory), along, step, smooth)

    def error(self, state: Array, reference: Array) -> Array:
        """State minus reference (4,); theta the shorter way round."""
        error = state - reference
        error[0] = wrapped(error[0])
        return error

    def deviation(self, error: Array) -> float:
        """Return the larger deviation of the two angles [rad]."""
        return float(np.abs(error[:2]).max())

    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Mean planned torque plus time-varying feedback."""
        law: SwingUpLaw = motion.law
        elapsed = time - motion.start
        first = law.trajectory.times[0]
        planned = law.feedforward.mean(first + elapsed, first + elapsed + self.parameters.interval)
        reference = law.trajectory.sample(first + elapsed).state
        return self._action(planned, law.gain(elapsed), state, reference)

    def hold(self, motion: Motion, time: float, state: Array) -> Action:
        """Feedback about upright, the disk at the plan's last angle."""
        goal = motion.trajectory.states[-1] * np.array([1.0, 1.0, 0.0, 0.0])
        return self._action(np.zeros(1), self.upright.gain, state, goal)

    def captured(self, motion: Motion, time: float, state: Array) -> bool:
        """Whether the regulator about upright may take over."""
        if time >= motion.end:
            return True
        if time - motion.start < _CAPTURE_SHARE * motion.trajectory.duration:
            return False
        error = self.error(state, motion.trajectory.states[-1])
        return float(error @ self.upright.cost_to_go @ error) < self.capture_level

    @cached_property
    def recovery_gain(self) -> Array:
        """Gain (4,) of the spring and damper on the disk with which it is brought to rest."""
        plant = self.parameters.plant
        frequency, inertia = plant.natural_frequency, plant.coefficients.disk
        spring = _RECOVERY_STIFFNESS * inertia * frequency**2
        damper = 2.0 * _RECOVERY_DAMPING * inertia * frequency
        return np.array([0.0, spring, 0.0, damper])

    def recover(self, state: Array) -> Array:
        """Spring and damper on the disk: they take energy out until the pendulum hangs at rest."""
        limit = self.parameters.limits.torque
        torque = float(-self.recovery_gain @ state)
        return np.array([min(max(torque, -limit), limit)])

    def calm(self, state: Array, slack: float) -> bool:
        """Whether the pendulum hangs nearly at rest."""
        from_hanging = np.array([wrapped(state[0] - math.pi), state[1], state[2], state[3]])
        frequency = self.parameters.plant.natural_frequency
        largest = slack * _CALM * np.array([1.0, 1.0, frequency, frequency])
        return bool((np.abs(from_hanging) < largest).all())

    def _action(self, planned: Array, gain: Array, state: Array, reference: Array) -> Action:
        error = self.error(state, reference)
        limit = self.parameters.limits.torque
        torque = np.clip(planned - gain @ error, -limit, limit)
        return Action(torque, torque - planned, error, reference)


def _estimator(parameters: PendulumTrackerParameters, history: CommandHistory) -> StateEstimator:
    assumed = parameters.estimator
    floor = _RATE_FLOOR * parameters.plant.natural_frequency**2
    noise = EstimatorNoise(
        measurement=np.array([assumed.angle_noise] * 2 + [assumed.rate_noise] * 2),
        model=assumed.model_error,
        rate_floor=np.full(4, floor),
        driven=np.array([False, False, True, True]),
    )
    theta_only = np.array([True, False, False, False])
    return StateEstimator(
        parameters.plant, noise, theta_only, history, longest_gap=parameters.state_timeout
    )
