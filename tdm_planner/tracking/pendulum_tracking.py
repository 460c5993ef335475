# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Tracking of a swing-up: time-varying LQR along the plan, then LQR about upright.

The torque over the coming command interval is

    T = mean of the planned torque - K(s) (x - x_plan(s)),

saturated at the actuator's limit, of which the plan leaves a share to the feedback. A pendulum
that swings more slowly than its model is late after a few swings, and no weak motor brings it
forward: s, how far the plan has come, follows the state, and the plan is played at the pendulum's
own pace, the root of its gravity over the model's, which is estimated on the way. Planned rates
grow with the pace, planned torques with its square. The other constants are estimated as well.
What they differ by is a constant part of x: the feedback takes into account what that does along
the rest of the plan. The regulator about upright is active from the plan's end. It is so before
where the plan is lost, if the state is inside the largest level set of its cost to go,
x'P x <= T_max^2 / (K P^-1 K'), in which its torque does not saturate.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.tracking.estimator import (
    EstimatedPendulum,
    GAINS,
    longest_step,
    pendulum_estimator,
)
from tdm_planner.tracking.linear_quadratic import discrete_regulator, mean_controls, PlanLaw
from tdm_planner.tracking.motion import Action, Motion, wrapped
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.tracking.tracker_parameters import PendulumTrackerParameters
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_DISK = 3.0  # rad that the disk turns by the torque in the square of its time scale
# Recovery: stiffness and damping of the disk relative to the pendulum's natural frequency; chosen
# for the quickest decay over strong and weak motors. Calm: angles in rad, rates in units of w0.
_RECOVERY_STIFFNESS, _RECOVERY_DAMPING = 0.3, 0.4
_CALM = np.array([0.3, 0.5, 0.3, 0.1])
_SHIFT = 0.5  # share of what the state is ahead of the plan that is made up for in 1 / w0
_AHEAD = 0.04  # of 1 / w0, by which it counts as ahead at most: pushes are for the feedback
_PACES = 0.85, 1.15  # at which a plan may be played
_TOLD_APART = 3.0  # standard deviations of measured angles


class PendulumTracker(TrajectoryTracker):
    """
    Tracker of the rotary pendulum; states theta, psi, theta_dot, psi_dot, control torque.

    `upright` is the regulator about upright for torques held over a command interval;
    `recovery_gain` (4,) that of the spring and damper by which the disk is brought to rest.

    Raise InvalidProblem if there is no feedback about upright.
    """

    parameters: PendulumTrackerParameters

    def __init__(self, parameters: PendulumTrackerParameters) -> None:
        plant = parameters.plant
        estimator = pendulum_estimator(plant, parameters.estimator, parameters.state_timeout)
        super().__init__(parameters, plant, estimator)
        frequency = plant.natural_frequency
        weights, limit = parameters.weights, parameters.limits.torque
        scale = np.array([1.0, 1.0, frequency, frequency])
        diagonal = np.array([weights.theta, weights.psi, weights.theta_dot, weights.psi_dot])
        self._q = np.diag(diagonal / scale**2)
        self._r = np.array([[weights.torque / limit / limit]])
        disk = math.sqrt(plant.disk_acceleration(limit) / _DISK)
        self.quickest = max(frequency * plant.quickness, disk)
        try:
            a, b = plant.linearise('upright')
            self.upright = discrete_regulator(a, b, self._q, self._r, parameters.interval)
        except np.linalg.LinAlgError as error:
            raise InvalidProblem(
                "parameters 'plant.*', 'weights.*' and 'limits.torque' allow no feedback about "
                f'upright: {error}'
            ) from None
        gain, cost = self.upright
        spread = float((gain @ np.linalg.solve(cost, gain.T))[0, 0])
        self._capture_level = float(limit**2 / spread)
        spring = _RECOVERY_STIFFNESS * plant.coefficients.disk * frequency**2
        damper = 2.0 * _RECOVERY_DAMPING * plant.coefficients.disk * frequency
        self.recovery_gain = np.array([0.0, spring, 0.0, damper])

    @property
    def warning(self) -> str:
        """Say that commands are too slow, and that the motor holds less than sensors tell."""
        # About the largest angle [rad] from which a weak motor keeps the pendulum from falling.
        leaning = self.parameters.plant.drive(self.parameters.limits.torque)
        noise = self.parameters.estimator.angle_noise
        weak = (
            f'limits.torque holds the pendulum within {leaning:.2g} rad of upright only, and '
            f'sensors are off by {noise:g} rad (estimator.angle_noise): it will hardly be caught'
        )
        told = [super().warning, weak if leaning < _TOLD_APART * noise else '']
        return '; '.join(filter(None, told))

    def level(self, state: Array, goal: Array) -> float:
        """Cost to go about upright, as a share of what its regulator takes without saturating."""
        error = self.error(state, goal)
        return float(error @ self.upright.cost_to_go @ error) / self._capture_level

    def prepare(self, trajectory: Trajectory) -> PlanLaw:
        """Compute the gains along the plan."""
        plant, more = self.parameters.plant, (0, len(GAINS))
        weights = np.pad(self._q, more), self._r
        terminal = np.pad(self.upright.cost_to_go, more)
        spacing = longest_step(plant)
        return PlanLaw.along(EstimatedPendulum(plant), trajectory, weights, terminal, spacing)

    def error(self, state: Array, reference: Array) -> Array:
        """State minus reference (4,); theta the shorter way round."""
        error = state[:4] - reference
        error[0] = wrapped(error[0])
        return error

    def deviation(self, error: Array) -> float:
        """Return the larger deviation: of theta [rad], of the disk as a share of its range."""
        return float(max(abs(error[0]), abs(error[1]) / self.parameters.limits.disk_angle))

    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Mean planned torque plus time-varying feedback."""
        law: PlanLaw = motion.law
        elapsed = motion.elapsed(time)
        first, step = law.trajectory.times[0] + elapsed, motion.pace * self.parameters.interval
        planned = motion.pace**2 * mean_controls(law.trajectory, [first, first + step])[0]
        reference = law.trajectory.sample(first).state * self._scale(motion.pace)
        gain, off = law.gain(elapsed), self._off(state, motion.pace)
        return self._action(planned - gain[:, 4:] @ off, gain[:, :4], state, reference)

    @staticmethod
    def _off(state: Array, pace: float) -> Array:
        """Return what the estimated gains differ by from those of a plan played at a pace."""
        played = [pace**2] + [1.0] * (len(GAINS) - 1)
        return np.asarray(state[4:] / played - 1.0)

    def paced(self, motion: Motion, time: float, state: Array) -> Motion:
        """Move the plan towards where the state is on it, and play it at the rig's own pace."""
        law: PlanLaw = motion.law
        plant, elapsed = self.parameters.plant, motion.elapsed(time)
        planned = law.trajectory.sample(law.trajectory.times[0] + elapsed)
        error = self.error(state, planned.state * self._scale(motion.pace))
        rates = plant.derivative(planned.state, planned.control)
        step = plant.natural_frequency * self.parameters.interval
        most = _AHEAD / plant.natural_frequency
        ahead = min(max(law.ahead(elapsed, rates, error), -most), most)
        pace = float(np.clip(math.sqrt(max(state[4], 0.0)), *_PACES))
        return motion.played(time, elapsed + min(_SHIFT * step, 1.0) * ahead, pace)

    @staticmethod
    def _scale(pace: float) -> Array:
        """Factors (4,) of planned states where the plan is played at a pace."""
        return np.array([1.0, 1.0, pace, pace])

    def hold(self, motion: Motion, time: float, state: Array) -> Action:
        """Feedback about upright, the disk at the plan's last angle."""
        goal = motion.trajectory.states[-1] * np.array([1.0, 1.0, 0.0, 0.0])
        return self._action(np.zeros(1), self.upright.gain, state, goal)

    def captured(self, motion: Motion, time: float, state: Array) -> bool:
        """Whether the regulator about upright is active: at the end, or where the plan is lost."""
        if time >= motion.end:
            return True
        away = self.deviation(self.error(state, motion.reference(time)))
        goal = motion.trajectory.states[-1]
        return away > self.parameters.tolerance.path and self.level(state, goal) < 1.0

    def recover(self, state: Array) -> Array:
        """Spring and damper on the disk: they take energy out until the pendulum hangs at rest."""
        limit = self.parameters.limits.torque
        torque = float(-self.recovery_gain @ state[:4])
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
