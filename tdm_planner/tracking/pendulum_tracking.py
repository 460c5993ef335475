# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Tracking of a swing-up: time-varying LQR along the plan, then LQR about upright.

The torque over the coming command interval is

    T = mean of the planned torque - K(s) (x - x_plan(s)),

saturated at the actuator's limit, of which the plan leaves a share to the feedback.

A pendulum may swing more slowly than its model, and a weak motor cannot make up for that. The
tracker therefore shifts the plan in time towards the instant s at which it is nearest to the
state. It plays the plan at the pendulum's own pace, the root of its gravity over the model's; that
gravity is estimated on the way. Planned rates grow with the pace, planned torques with its square.
Where commands turn out to act later than was known at the start, it is played a little faster, so
that it ends when it was to end.

The other constants are estimated, too, and the damping of pivot and disk. Their errors are a
constant part of x: the feedback takes into account what they do along the rest of the plan.

After the plan's end the regulator about upright is active. It is active earlier where the plan is
lost, and the state is inside the largest level set of the regulator's cost to go in which its
torque does not saturate, x'P x <= T_max^2 / (K P^-1 K').
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array, wrapped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import group, parameter, positive, Validated
from tdm_planner.plants.rotary_pendulum import (
    accelerations_by,
    Coefficients,
    PendulumDamping,
    PendulumLimits,
    RotaryPendulum,
)
from tdm_planner.tracking.estimator import (
    EstimatorNoise,
    PlantWithGains,
    PREDICTION_STEP,
    StateEstimator,
)
from tdm_planner.tracking.linear_quadratic import discrete_regulator, mean_controls, PlanLaw
from tdm_planner.tracking.motion import Action, Motion, NOISE, Steps, TrackerParameters
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.trajectory import Trajectory

_CONSTANTS = 'gravity_gain', 'arm_gain', 'disk_gain', 'coupling_gain', 'torque_gain'
GAINS = (*_CONSTANTS, 'pivot_damping', 'disk_damping')
_GAIN_SPREAD = 0.05  # standard deviation of the gains before anything is known of them
_FINE = 0.1  # of the time scale of the quickest swings: steps of gains and predictions, at most
_RATE_NOISE = 0.0094  # of w0; .1 rad/s of the default rig
# Rates below this share of w0^2 count as that: the estimator must not trust the model blindly.
_RATE_FLOOR = 0.1
_LEAST_ERROR = 0.03  # of the model's error that is assumed: what it may be found to be
_LASTING = 0.05  # 1 / w0 for which an error of the model's accelerations stays the same
_DISK = 3.0  # rad that the disk turns by the torque in the square of its time scale
# Recovery: stiffness and damping of the disk relative to the pendulum's natural frequency; chosen
# for the quickest decay over strong and weak motors. Calm: angles in rad, rates in units of w0.
_RECOVERY_STIFFNESS, _RECOVERY_DAMPING = 0.3, 0.4
_CALM = np.array([0.3, 0.5, 0.3, 0.1])
_SHIFT = 0.5  # share of what the state is ahead of the plan that is made up for in 1 / w0
_AHEAD = 0.04  # of 1 / w0, by which it counts as ahead at most: pushes are for the feedback
_CATCH_UP = 0.003  # of an interval: the most lateness to make up for in one, as any motor can
PACES = 0.85, 1.15  # at which a plan may be played
UPRIGHT = 0.05  # rad from upright that counts as reached


@dataclass(frozen=True)
class FeedbackWeights(Validated):
    """
    Weights of the quadratic cost on dimensionless deviations.

    Angles count in rad, rates in units of the pendulum's natural frequency, torque in units of
    limits.torque.
    """

    theta: float = positive(1.0, "weight of the pendulum's angle")
    psi: float = positive(0.1, "weight of the disk's angle")
    theta_dot: float = positive(1.0, "weight of the pendulum's rate")
    psi_dot: float = positive(0.1, "weight of the disk's rate")
    torque: float = positive(2.0, 'weight of the feedback torque')


@dataclass(frozen=True)
class PendulumEstimatorParameters(Validated):
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
        0.1,
        "largest relative error of the model's accelerations; the tracker finds the present one",
        allowed=NOISE,
    )


@dataclass(frozen=True)
class PendulumTrackerParameters(TrackerParameters):
    """Parameters of the pendulum's tracker."""

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumLimits = group(PendulumLimits)
    weights: FeedbackWeights = group(FeedbackWeights)
    estimator: PendulumEstimatorParameters = group(PendulumEstimatorParameters)


class EstimatedPendulum(PlantWithGains):
    """
    The pendulum with seven more states: its constants over those of the model, and damping.

    The pendulum's own inertia is the model's: only ratios of inertias and torques matter. Those of
    the coupling and of what the disk feels of a tilted pendulum hardly differ. `disk_gain` is that
    of the inertia that the disk has beyond the least at which a rig with that arm is physical: the
    mass matrix is positive definite where it is positive. Damping of pivot and disk is 1 where
    it is the model's; one more would take rates away within 1/w0.
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
        theta, _, theta_dot, psi_dot, gravity, arm, disk, coupling, motor, pivot, bearing = state
        least = k.arm**2 / k.pendulum
        true = k._replace(
            gravity=gravity * k.gravity,
            arm=arm * k.arm,
            disk=arm**2 * least + disk * (k.disk - least),
            coupling=coupling * k.coupling,
            disk_sine=coupling * k.disk_sine,
        )
        (torque,), w0 = control, np.sqrt(k.gravity / k.pendulum)
        torque = motor * torque - (bearing - 1.0) * w0 * k.disk * psi_dot
        moment = (1.0 - pivot) * w0 * k.pendulum * theta_dot
        turned = accelerations_by(true, theta, theta_dot, psi_dot, moment, torque)
        return (theta_dot, psi_dot, *turned, *[0.0] * len(GAINS))


def settling(plant: RotaryPendulum) -> float:
    """Return the time [s] after a swing-up in which a pendulum that is caught stands upright."""
    return max(3.0, 12.0 / plant.natural_frequency)


def longest_step(plant: RotaryPendulum) -> float:
    """Return the longest step [s] in which a prediction is accurate."""
    return min(PREDICTION_STEP, _FINE / plant.natural_frequency / plant.quickness)


def _ends_upright(motion: Motion) -> bool:
    """Whether a plan ends above the pivot, as swing-ups do; others may be sent to a tracker."""
    return math.cos(motion.trajectory.states[-1, 0]) > 0.0


class PendulumTracker(TrajectoryTracker):
    """
    Tracker of the rotary pendulum; states theta, psi, theta_dot, psi_dot, control torque.

    `upright` is the regulator about upright for torques held over a command interval;
    `recovery_gain` (4,) that of the spring and damper by which the disk is brought to rest.

    Raise InvalidProblem if there is no feedback about upright.
    """

    parameters: PendulumTrackerParameters
    plant: RotaryPendulum

    def __init__(self, parameters: PendulumTrackerParameters) -> None:
        plant = parameters.plant
        frequency, assumed = plant.natural_frequency, parameters.estimator
        rate_noise = assumed.rate_noise
        if rate_noise is None:
            rate_noise = _RATE_NOISE * frequency
        noise = EstimatorNoise(
            measurement=np.array([assumed.angle_noise] * 2 + [rate_noise] * 2),
            model=assumed.model_error,
            rate_floor=_RATE_FLOOR * frequency**2 * np.array([0.0, 0.0, 1.0, 1.0]),
            gains=_GAIN_SPREAD,
            lasting=_LASTING / frequency,
            least=_LEAST_ERROR,
        )
        model, times = EstimatedPendulum(plant), (parameters.state_timeout, longest_step(plant))
        estimator = StateEstimator(model, noise, [0], *times, parameters.command_delay)
        super().__init__(parameters, plant, estimator)
        self.settling = settling(plant)
        weights, limit = parameters.weights, parameters.limits.torque
        reach = parameters.limits.disk_angle
        self.limits = {'torque': (-limit, limit), 'psi': (-reach, reach)}
        scale = np.array([1.0, 1.0, frequency, frequency])
        diagonal = np.array([weights.theta, weights.psi, weights.theta_dot, weights.psi_dot])
        self._q = np.diag(diagonal / scale**2)
        self._r = np.array([[weights.torque / limit / limit]])
        disk = math.sqrt(plant.disk_acceleration(limit) / _DISK)
        try:
            a, b = plant.jacobians(np.zeros(4), np.zeros(1))
            falling = float(np.linalg.eigvals(a).real.max())
            undamped = replace(plant, damping=PendulumDamping())
            self.growth_rate = max(falling, frequency * undamped.quickness, disk)
            self.upright = discrete_regulator(a, b, self._q, self._r, parameters.interval)
            gain, cost = self.upright
            spread = float((gain @ np.linalg.solve(cost, gain.T))[0, 0])
        except np.linalg.LinAlgError as error:
            raise InvalidProblem(
                "parameters 'plant.*', 'weights.*' and 'limits.torque' allow no feedback about "
                f'upright: {error}'
            ) from None
        self._capture_level = float(limit**2 / spread)
        k = plant.coefficients
        damping = k.pivot_damping / k.pendulum, k.disk_damping / k.disk
        self._damping = np.array(damping) / frequency  # of the model, as in `GAINS`
        spring = _RECOVERY_STIFFNESS * plant.coefficients.disk * frequency**2
        damper = 2.0 * _RECOVERY_DAMPING * plant.coefficients.disk * frequency
        self.recovery_gain = np.array([0.0, spring, 0.0, damper])

    @property
    def found(self) -> dict[str, float]:
        """Return what the samples say of commands and plant, by name and unit."""
        found, estimator, k = super().found, self.estimator, self.plant.coefficients
        if estimator.stamp is not None:
            gains = dict(zip(GAINS, estimator.predict(estimator.stamp)[4:].tolist(), strict=True))
            w0 = self.plant.natural_frequency
            pivot, disk = (w0 * (gains[f'{name}_damping'] - 1.0) for name in ('pivot', 'disk'))
            found['natural frequency [rad/s]'] = w0 * math.sqrt(max(gains['gravity_gain'], 0.0))
            found['torque, of what is commanded'] = gains['torque_gain']
            found['damping of the pivot [N m s]'] = k.pivot_damping + pivot * k.pendulum
            found['damping of the disk [N m s]'] = k.disk_damping + disk * k.disk
        return found

    def capture_share(self, state: Array, goal: Array) -> float:
        """Cost to go about upright, as a share of what its regulator takes without saturating."""
        error = self.error(state, goal)
        return float(error @ self.upright.cost_to_go @ error) / self._capture_level

    def prepare(self, trajectory: Trajectory) -> Steps[PlanLaw]:
        """Compute the gains along the plan."""
        plant, more = self.plant, (0, len(GAINS))
        weights = np.pad(self._q, more), self._r
        terminal = np.pad(self.upright.cost_to_go, more)
        steps = longest_step(plant), self.parameters.interval
        return PlanLaw.along(EstimatedPendulum(plant), trajectory, weights, terminal, *steps)

    def deviation(self, motion: Motion, error: Array) -> float:
        """Return the larger deviation: of theta [rad], of the disk as a share of its range."""
        return float(max(abs(error[0]), abs(error[1]) / self.parameters.limits.disk_angle))

    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Mean planned torque plus time-varying feedback."""
        law: PlanLaw = motion.law
        elapsed = motion.elapsed(time)
        first, step = law.trajectory.times[0] + elapsed, motion.pace * self.parameters.interval
        planned = motion.pace**2 * mean_controls(law.trajectory, [first, first + step])[0]
        reference = law.trajectory.sample(first).state * self._scale(motion.pace)
        gain, off = law.gain(elapsed), state[4:].copy()
        # At its own pace the plan is that of its gravity; damping grows with the pace alone.
        off[0] /= motion.pace**2
        off[-2:] = 1.0 + (self._damping + off[-2:] - 1.0) / motion.pace - self._damping
        return self._action(planned - gain[:, 4:] @ (off - 1.0), gain[:, :4], state, reference)

    def paced(self, motion: Motion, time: float, state: Array) -> Motion:
        """Move the plan towards where the state is on it, and play it at the rig's own pace."""
        law: PlanLaw = motion.law
        plant, elapsed = self.plant, motion.elapsed(time)
        planned = law.trajectory.sample(law.trajectory.times[0] + elapsed)
        error = self.error(state, planned.state * self._scale(motion.pace))
        rates = plant.derivative(planned.state, planned.control)
        step = plant.natural_frequency * self.parameters.interval
        most = _AHEAD / plant.natural_frequency
        ahead = min(max(law.ahead(elapsed, rates, error), -most), most)
        pace = float(np.clip(math.sqrt(max(state[4], 0.0)), *PACES))
        # Commands that act later than was known at the start have made it so late.
        owed = min(motion.late, self.estimator.delay - self.parameters.command_delay)
        hurry = min(max(step * owed, 0.0), _CATCH_UP * self.parameters.interval)
        come = elapsed + min(_SHIFT * step, 1.0) * ahead + hurry
        return replace(motion, late=time - motion.start - come / pace, pace=pace)

    @staticmethod
    def _scale(pace: float) -> Array:
        """Factors (4,) of planned states where the plan is played at a pace."""
        return np.array([1.0, 1.0, pace, pace])

    def at_goal(self, motion: Motion, state: Array) -> bool:
        """Whether it is near the plan's last angle; upright, whether the regulator holds it."""
        goal = motion.trajectory.states[-1]
        near = abs(self.error(state, goal)[0]) < UPRIGHT
        return bool(near and (self.capture_share(state, goal) < 1.0 or not _ends_upright(motion)))

    def hold(self, motion: Motion, time: float, state: Array) -> Action:
        """Feedback about the plan's end: upright or, after a plan that ends below, hanging."""
        goal = motion.trajectory.states[-1] * np.array([1.0, 1.0, 0.0, 0.0])
        gain = self.upright.gain if _ends_upright(motion) else self.recovery_gain[None]
        return self._action(np.zeros(1), gain, state, goal)

    def captured(self, motion: Motion, time: float, state: Array) -> bool:
        """Whether the regulator about upright is active: at the end, or where the plan is lost."""
        if time >= motion.end:
            return True
        away = self.deviation(motion, self.error(state, motion.reference(time)))
        lost = away > self.parameters.tolerance.path and _ends_upright(motion)
        return lost and self.capture_share(state, motion.trajectory.states[-1]) < 1.0

    def recover(self, state: Array) -> Array:
        """Spring and damper on the disk: they take energy out until the pendulum hangs at rest."""
        limit = self.parameters.limits.torque
        torque = float(-self.recovery_gain @ state[:4])
        return np.array([min(max(torque, -limit), limit)])

    def calm(self, state: Array, slack: float) -> bool:
        """Whether the pendulum hangs nearly at rest."""
        from_hanging = np.array([wrapped(state[0] - math.pi), state[1], state[2], state[3]])
        frequency = self.plant.natural_frequency
        largest = slack * _CALM * np.array([1.0, 1.0, frequency, frequency])
        return bool((np.abs(from_hanging) < largest).all())

    def _action(self, planned: Array, gain: Array, state: Array, reference: Array) -> Action:
        error = self.error(state, reference)
        limit = self.parameters.limits.torque
        torque = np.clip(planned - gain @ error, -limit, limit)
        return Action(torque, torque - planned, error)
