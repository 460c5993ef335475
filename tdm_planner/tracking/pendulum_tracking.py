# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Tracking of a swing-up: time-varying LQR along the plan, then LQR about upright.

The torque over the coming command interval is

    T = mean of the planned torque - K(t) (x - x_plan(t)),

saturated at the actuator's limit, of which the plan leaves a share to the feedback. The regulator
about upright takes over at the plan's end. It does so before where the plan is lost, if the state
is inside the largest level set of its cost to go, x'P x <= T_max^2 / (K P^-1 K'), in which its
torque does not saturate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.plants.rotary_pendulum import PendulumLimits, RotaryPendulum
from tdm_planner.tracking.estimator import CommandHistory, EstimatorNoise, StateEstimator
from tdm_planner.tracking.feedforward import PlanLaw
from tdm_planner.tracking.linear_quadratic import discrete_regulator, Regulator
from tdm_planner.tracking.tracker import Action, Motion, TrajectoryTracker, wrapped
from tdm_planner.tracking.tracker_parameters import NOISE, TrackerParameters
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_GAIN_STEP = 5e-3  # s between the gains along a plan, and of a prediction: at most
_FINE = 0.1  # of the time scale of the quickest swings, likewise
_RATE_NOISE = 0.0094  # of w0; .1 rad/s of the default rig
_SLOWEST = 12.0  # commands in the time scale of the quickest swings, and of the disk:
_DISK = 3.0  # rad that it turns by the torque in the square of the latter
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
    rate_noise: float | None = parameter(
        None,
        "standard deviation of measured rates; unset: in proportion to the rig's speed",
        unit='rad/s',
        allowed=NOISE,
    )
    model_error: float = parameter(
        0.1, "relative error of the model's accelerations", allowed=NOISE
    )


@dataclass(frozen=True)
class PendulumTrackerParameters(TrackerParameters):
    """Parameters of the pendulum's tracker."""

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumLimits = group(PendulumLimits)
    weights: FeedbackWeights = group(FeedbackWeights)
    estimator: EstimatorParameters = group(EstimatorParameters)


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

    def level(self, state: Array, goal: Array) -> float:
        """Cost to go about upright, as a share of what its regulator takes without saturating."""
        error = self.error(state, goal)
        return float(error @ self.upright.cost_to_go @ error) / self.capture_level

    @property
    def warning(self) -> str:
        """Say that the commands are too slow for the rig, where they are."""
        plant, given = self.parameters.plant, self.parameters
        disk = math.sqrt(plant.disk_acceleration(given.limits.torque) / _DISK)
        least = _SLOWEST * max(plant.natural_frequency * plant.quickness, disk)
        if given.rate >= least:
            return ''
        return f'rate = {given.rate:g} Hz is too slow for this rig: must be {least:.0f} Hz or more'

    def prepare_hold(self) -> None:
        """Compute the gains about upright now rather than when they are first needed."""
        _ = self.capture_level

    def prepare(self, trajectory: Trajectory) -> PlanLaw:
        """Compute the gains along the plan."""
        plant, terminal = self.parameters.plant, self.upright.cost_to_go
        spacing = min(_GAIN_STEP, _FINE / plant.natural_frequency / plant.quickness)
        return PlanLaw.along(plant, trajectory, (self._q, self._r), terminal, spacing)

    def error(self, state: Array, reference: Array) -> Array:
        """State minus reference (4,); theta the shorter way round."""
        error = state - reference
        error[0] = wrapped(error[0])
        return error

    def deviation(self, error: Array) -> float:
        """Return the larger deviation: of theta [rad], of the disk as a share of its range."""
        return float(max(abs(error[0]), abs(error[1]) / self.parameters.limits.disk_angle))

    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Mean planned torque plus time-varying feedback."""
        law: PlanLaw = motion.law
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
        """Whether the regulator about upright takes over: at the end, or where it is lost."""
        if time >= motion.end:
            return True
        away = self.deviation(self.error(state, motion.reference(time)))
        goal = motion.trajectory.states[-1]
        return away > self.parameters.tolerance.path and self.level(state, goal) < 1.0

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
    plant, rate_noise = parameters.plant, assumed.rate_noise
    frequency = plant.natural_frequency
    if rate_noise is None:
        rate_noise = _RATE_NOISE * frequency
    floor = _RATE_FLOOR * frequency**2
    noise = EstimatorNoise(
        measurement=np.array([assumed.angle_noise] * 2 + [rate_noise] * 2),
        model=assumed.model_error,
        rate_floor=np.full(4, floor),
        driven=np.array([False, False, True, True]),
    )
    theta_only = np.array([True, False, False, False])
    step = min(_GAIN_STEP, _FINE / frequency / plant.quickness)
    return StateEstimator(plant, noise, theta_only, history, parameters.state_timeout, step)
