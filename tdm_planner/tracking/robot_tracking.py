# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Tracking of a floating robot whose one thruster turns slowly, and station-keeping.

The acceleration wanted is the plan's plus linear-quadratic feedback on position and velocity. The
thruster turns towards it; the thrust is the projection of the wanted acceleration on the direction
held, and none while that direction is off by more than a set angle. The yaw is independent:
planned torque plus feedback.

A plan that burns and coasts is followed otherwise. In a burn the feedback takes away the velocity
that would lead astray by the end of the coast that follows. A coast is corrected by one short burn
where it would miss the plan at its end by more than is allowed, and else left alone. Keeping
station is a coast as well. While little thrust is planned, no correction turns the thruster so
far that it would be late for more.

How well the thruster and the wheel work (true over assumed acceleration) is estimated on the way,
and the commands are divided by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.arrays import Array, wrapped
from tdm_planner.parameters import group, parameter, positive, Range, Validated
from tdm_planner.plants.floating_robot import FloatingRobot, RobotInertia, RobotLimits
from tdm_planner.tracking.estimator import EstimatorNoise, PlantWithGains, StateEstimator
from tdm_planner.tracking.linear_quadratic import mean_controls
from tdm_planner.tracking.motion import (
    Action,
    Motion,
    NOISE,
    Steps,
    Tolerances,
    TrackerParameters,
)
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.trajectory import Trajectory

_YAW, _OMEGA, _ALPHA = 4, 5, 6
_ACTUATORS_SPREAD = 0.1  # standard deviation of an actuator's gain before anything is known of it
_GAIN_RANGE = (0.5, 2.0)  # of the estimated actuator gains
_SERVO_SHARE = 0.25  # of the error of the thruster's angle that one command takes away
_CALM_SPEED, _CALM_TURN = 0.01, 0.05  # m/s, rad/s at which a new plan can be asked for
GOAL_DISTANCE, GOAL_TURN = 0.02, 0.03  # m, rad from the goal that count as reached
_GOAL_CALM = 3.0  # times the speeds above, at the goal
_MUCH = 0.1  # of limits.thrust, planned with, for which the thruster is there in time
_ANY_ANGLE, _FREE = 1e6, (-math.inf, math.inf)  # rad
# s, and half-turns of the thruster, in which a correction is over: away, and back.
_SETTLING, _TURNS = 8.0, 5.0
_PULSE = 10  # ticks in which a correction takes an error of the velocity away, at the least
_ALIGNED = 0.3  # rad off at which a correction begins to fire


@dataclass(frozen=True)
class RobotTolerances(Tolerances):
    """How far the robot may be from the trajectory."""

    start: float = positive(
        0.1, 'largest distance from the start for a trajectory to be accepted', 'm'
    )
    path: float = positive(0.3, 'distance from the plan at which the motion is aborted', 'm')


@dataclass(frozen=True)
class RobotFeedback(Validated):
    """Feedback; the gains are those of the linear-quadratic regulator of a double integrator."""

    position: float = positive(
        0.1, 'position error that gives full thrust; smaller is stiffer', 'm'
    )
    yaw: float = positive(0.1, 'yaw error that gives full torque; smaller is stiffer', 'rad')
    deadband: float = parameter(
        0.03,
        'share of limits.thrust below which feedback does not turn the thruster, except to '
        'correct a coast',
        allowed=Range(0.0, 0.5),
    )
    coasting: float = positive(
        0.004,
        'position error, predicted at the next burn or the goal, above which a coast is corrected',
        'm',
    )
    misalignment: float = parameter(
        1.0,
        'angle between wanted acceleration and thruster beyond which there is no thrust',
        unit='rad',
        allowed=Range(0.0, math.pi / 2, lower_open=True),
    )


@dataclass(frozen=True)
class RobotEstimatorParameters(Validated):
    """What the state estimator assumes."""

    position_noise: float = parameter(
        0.002, 'standard deviation of x and of y', unit='m', allowed=NOISE
    )
    velocity_noise: float = parameter(
        0.002, 'standard deviation of the velocity along x and y', unit='m/s', allowed=NOISE
    )
    angle_noise: float = parameter(
        0.005, 'standard deviation of the yaw and its rate', unit='rad, rad/s', allowed=NOISE
    )
    thruster_noise: float = parameter(
        0.005, "standard deviation of the thruster's angle", unit='rad', allowed=NOISE
    )
    model_error: float = parameter(
        0.03,
        "error of the model's accelerations and the thruster's rate relative to the largest",
        allowed=NOISE,
    )


@dataclass(frozen=True)
class RobotTrackerParameters(TrackerParameters):
    """Parameters of a robot's tracker."""

    planner_service: str = parameter(
        '/robots/plan', "name of the planner's service", read_only=True
    )
    tolerance: RobotTolerances = group(RobotTolerances)
    plant: FloatingRobot = group(FloatingRobot)
    limits: RobotLimits = group(RobotLimits)
    feedback: RobotFeedback = group(RobotFeedback)
    estimator: RobotEstimatorParameters = group(RobotEstimatorParameters)


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


class PlanLaw(NamedTuple):
    """
    What is prepared for a plan with samples at N instants.

    `burns` (n, 2) are start and end [s], None where thrust runs smoothly. While little thrust is
    planned the thruster stays between `least` and `most` (N,) rad, to be in time for more.
    """

    burns: Array | None
    least: Array
    most: Array


def settling_time(limits: RobotLimits) -> float:
    """Return the time [s] after a plan's end in which a robot takes the rest of its error away."""
    return max(_SETTLING, _TURNS * math.pi / limits.thruster_rate)


class RobotTracker(TrajectoryTracker):
    """Tracker of one floating robot; a command takes away `servo_share` of an error of alpha."""

    parameters: RobotTrackerParameters
    plant: FloatingRobot

    def __init__(
        self, parameters: RobotTrackerParameters, servo_share: float = _SERVO_SHARE
    ) -> None:
        plant, limits, feedback = parameters.plant, parameters.limits, parameters.feedback
        push, spin = limits.thrust / plant.mass, limits.torque / plant.inertia
        assumed = parameters.estimator
        place, speed, angle = assumed.position_noise, assumed.velocity_noise, assumed.angle_noise
        noise = EstimatorNoise(
            np.array([place, place, speed, speed, angle, angle, assumed.thruster_noise]),
            assumed.model_error,
            # The thruster may turn more slowly than told, and later.
            rate_floor=np.array([0.0, 0.0, push, push, 0.0, spin, limits.thruster_rate]),
            gains=_ACTUATORS_SPREAD,
        )
        angles, gap, delay = [_YAW, _ALPHA], parameters.state_timeout, parameters.command_delay
        estimator = StateEstimator(EstimatedRobot(plant), noise, angles, gap, delay=delay)
        super().__init__(parameters, plant, estimator)
        self.settling = settling_time(limits)
        rate, torque = limits.thruster_rate, limits.torque
        self.limits = {
            'thrust': (0.0, limits.thrust),
            'thruster_rate': (-rate, rate),
            'torque': (-torque, torque),
        }
        self._largest = push
        self._servo_share = servo_share
        # The double integrator's regulator for weights 1 / error^2 and 1 / acceleration^2.
        self._stiffness = self._largest / feedback.position
        self._damping = math.sqrt(2.0 * self._stiffness)
        # An error of the position is taken away in this time or more. When keeping station the
        # thruster must turn half round to brake: there is time for it.
        self._shortest = self._damping / self._stiffness
        self._station = max(self._shortest, math.tau / limits.thruster_rate)
        self._yaw_stiffness = spin / feedback.yaw
        self._yaw_damping = math.sqrt(2.0 * self._yaw_stiffness)

    def prepare(self, trajectory: Trajectory) -> Steps[PlanLaw]:
        """Look for burns, and for how far the thruster may turn away before much thrust."""
        yield from ()
        alpha, thrust = trajectory.states[:, _ALPHA], trajectory.controls[:, 0]
        limits = self.parameters.limits
        # A direction needed later is reached at the thruster's rate: the tightest of all.
        free = np.where(thrust > _MUCH * limits.thrust, _ALIGNED, _ANY_ANGLE)
        turned = limits.thruster_rate * trajectory.times
        least = np.maximum.accumulate((alpha - free - turned)[::-1])[::-1] + turned
        most = np.minimum.accumulate((alpha + free + turned)[::-1])[::-1] - turned
        burns = None
        if trajectory.interpolation == 'zero_order_hold':
            on = np.concatenate([[False], thrust[:-1] > 0.0, [False]])
            edges = np.flatnonzero(np.diff(on)).reshape(-1, 2)
            burns = np.asarray(trajectory.times[edges] - trajectory.times[0])
        return PlanLaw(burns, least, most)

    def deviation(self, motion: Motion, error: Array) -> float:
        """Return the distance from the planned position [m]."""
        return math.hypot(error[0], error[1])

    def wait(self, motion: Motion, state: Array) -> Array:
        """Turn the thruster to where the motion begins."""
        left = self.error(motion.trajectory.states[0], state[: _ALPHA + 1])
        return np.array([0.0, self._servo(left[_ALPHA]), 0.0])

    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Planned acceleration and torque plus feedback."""
        law: PlanLaw = motion.law
        elapsed = time - motion.start
        at = motion.trajectory.times[0] + elapsed
        interval = self.parameters.interval
        instants = at + interval * np.array([0.0, 0.5, 1.0])
        reference, middle, after = motion.trajectory.sample(instants).state
        thrust, _, torque = mean_controls(motion.trajectory, [at, at + interval])[0]
        driven = self.plant.derivative(middle, np.array([thrust, 0.0, torque]))
        error = self.error(state, reference)
        near = float(state[_ALPHA] - error[_ALPHA] - reference[_ALPHA])  # whole turns apart
        wanted = -self._stiffness * error[:2] - self._damping * error[2:4]
        bounds = _FREE
        if thrust <= _MUCH * self.parameters.limits.thrust:
            sides, times = (law.least, law.most), motion.trajectory.times
            bounds = tuple(near + np.interp(instants[2], times, side) for side in sides)
        coasting = False
        if law.burns is not None:
            left, horizon = _ahead(law.burns, elapsed, elapsed + interval)
            horizon = self._station if horizon == math.inf else max(horizon, self._shortest)
            coasting = left == 0.0
            if coasting:
                wanted = self._correction(error, horizon)
            else:
                wanted = -_excess(error, horizon) / max(left, _PULSE * interval)
        control = self._drive(
            state,
            driven[2:4] + wanted,
            torque + self._yaw_feedback(error[_YAW], error[_OMEGA]),
            float(after[_ALPHA]) + near,
            coasting,
            bounds,
        )
        feedback = control - [thrust, 0.0, torque]
        return Action(control, feedback, error)

    def at_goal(self, motion: Motion, state: Array) -> bool:
        """Whether it is in its place, as near as station-keeping is to keep it, and calm."""
        error = self.error(state, motion.trajectory.states[-1])
        near = max(GOAL_DISTANCE, self.parameters.feedback.coasting)
        placed = self.deviation(motion, error) < near and abs(error[_YAW]) < GOAL_TURN
        return bool(placed and self.calm(state, _GOAL_CALM))

    def hold(self, motion: Motion, time: float, state: Array) -> Action:
        """Keep station at the end of the trajectory."""
        goal = motion.trajectory.states[-1].copy()
        goal[[2, 3, _OMEGA]] = 0.0
        goal[_ALPHA] = state[_ALPHA]
        error = self.error(state, goal)
        wanted = self._correction(error, self._station)
        torque = self._yaw_feedback(error[_YAW], error[_OMEGA])
        control = self._drive(state, wanted, torque, float(state[_ALPHA]), coasting=True)
        return Action(control, control, error)

    def recover(self, state: Array) -> Array:
        """Brake."""
        torque = self._yaw_feedback(0.0, state[_OMEGA])
        return self._drive(state, -self._damping * state[2:4], torque, float(state[_ALPHA]))

    def calm(self, state: Array, slack: float) -> bool:
        """Whether the robot drifts and turns slowly."""
        speed, turn = math.hypot(state[2], state[3]), abs(state[_OMEGA])
        return speed < slack * _CALM_SPEED and turn < slack * _CALM_TURN

    def _correction(self, error: Array, horizon: float) -> Array:
        """Acceleration (2,) that corrects a coast of `horizon` s: short burns cost least gas."""
        off = _excess(error, horizon)
        missed = math.hypot(off[0], off[1]) * horizon > self.parameters.feedback.coasting
        return -off / (_PULSE * self.parameters.interval) * missed

    def _yaw_feedback(self, yaw: float, omega: float) -> float:
        turn = self._yaw_stiffness * yaw + self._yaw_damping * omega
        return float(-self.plant.inertia * turn)

    def _servo(self, angle: float) -> float:
        """Rate of the thruster that takes away an error `angle` [rad]."""
        limit = self.parameters.limits.thruster_rate
        return min(max(self._servo_share * angle / self.parameters.interval, -limit), limit)

    def _drive(
        self,
        state: Array,
        wanted: Array,
        torque: float,
        alpha: float,
        coasting: bool = False,
        bounds: tuple[float, ...] = _FREE,
    ) -> Array:
        """
        Return the controls (3,) nearest to what is wanted of a perfect robot.

        That is the acceleration `wanted` (2,) and the `torque`. The thruster rests at `alpha`
        where next to no acceleration is wanted, and stays within `bounds`.
        """
        limits, feedback = self.parameters.limits, self.parameters.feedback
        quiet = 0.0 if coasting else feedback.deadband * self._largest
        size = math.hypot(wanted[0], wanted[1])
        now, heading = float(state[_ALPHA]), float(state[_YAW] + state[_ALPHA])
        off = float(wrapped(np.asarray(math.atan2(wanted[1], wanted[0]) - heading)))
        target = min(max(alpha if size <= quiet else now + off, bounds[0]), bounds[1])
        thruster, wheel = np.clip(state[7:], *_GAIN_RANGE).tolist()
        thrust = 0.0
        if abs(off) < (_ALIGNED if coasting else feedback.misalignment):
            thrust = self.plant.mass * size * math.cos(off) / thruster
        torque = min(max(torque / wheel, -limits.torque), limits.torque)
        return np.array([min(thrust, limits.thrust), self._servo(target - now), torque])


def _excess(error: Array, horizon: float) -> Array:
    """Return the velocity (2,) too much for the error to be gone after `horizon` s."""
    return np.asarray(error[2:4] + error[:2] / horizon)


def _ahead(burns: Array, start: float, end: float) -> tuple[float, float]:
    """
    Return what is left of the burn that goes on within [start, end], 0 while coasting.

    And the time from `start` until the coast ends that goes on or comes next, infinite where no
    burn follows. `burns` (n, 2) are start and end [s].
    """
    begins, ends = burns.T
    k = int(np.searchsorted(ends, start, side='right'))
    burning = k < len(ends) and begins[k] < end
    left = float(ends[k] - start) if burning else 0.0
    k += burning
    return left, math.inf if k == len(begins) else float(begins[k] - start)
