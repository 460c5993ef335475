# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Tracking of a floating robot whose one thruster turns slowly, and station-keeping.

The acceleration wanted is the plan's plus linear-quadratic feedback on position and velocity. The
thruster turns towards it as far as it can still be where the plan will need it; the thrust is the
projection of the wanted acceleration on the direction held, and none while that direction is off
by more than a set angle. The yaw is independent: planned torque plus feedback.

A plan that burns and coasts is followed otherwise. In a burn the feedback takes away the velocity
that would lead astray by the end of the coast that follows. A coast is corrected by one short burn
where it would miss the plan at its end by more than is allowed, and else left alone. Keeping
station is a coast as well.

How well the thruster and the wheel work (true over assumed acceleration) is estimated on the way,
and the commands are divided by it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.tracking.estimator import actuator_gains, robot_estimator
from tdm_planner.tracking.linear_quadratic import mean_controls
from tdm_planner.tracking.motion import Action, Motion, wrapped
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.tracking.tracker_parameters import RobotTrackerParameters
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_YAW, _OMEGA, _ALPHA = 4, 5, 6
_SERVO_SHARE = 0.25  # of the error of the thruster's angle that one command takes away
_LATERAL = 0.3  # share of the largest thrust that may be wrong sideways for a direction to serve
_BURN_LATERAL = 0.05  # the same at a burn of a plan that burns and coasts
_ANY_DIRECTION = 50.0  # rad
_CALM_SPEED, _CALM_TURN = 0.01, 0.05  # m/s, rad/s at which a new plan can be asked for
_PULSE = 10  # ticks in which a correction takes an error of the velocity away, at the least
_SETTLED = 0.25  # share of the miss left alone at which a correction ends
_ALIGNED = 0.3  # rad off at which a correction begins to fire
_REACH_STEP = 0.02  # s between the tabulated ranges of the thruster's angle


class Reach(NamedTuple):
    """Angles of the thruster from which it can be in time where the plan needs it [rad]."""

    lower: float
    upper: float


_FREE = Reach(-math.inf, math.inf)


@dataclass(frozen=True, eq=False)
class RobotLaw:
    """
    What is prepared before the start: `lower` and `upper` hold the reach every `step` s.

    `burns` (n, 3) are the burns of a plan that burns and coasts: start and end [s], and the
    thruster's angle at the start.
    """

    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    burns: Array | None = field(repr=False)
    step: float = _REACH_STEP

    def reach(self, elapsed: float) -> Reach:
        """Return the range of the thruster's angle at `elapsed` s after the start."""
        k = min(max(math.ceil(elapsed / self.step), 0), len(self.lower) - 1)
        return Reach(float(self.lower[k]), float(self.upper[k]))

    def ahead(self, start: float, end: float) -> tuple[float, float, float | None]:
        """
        Return what is left of the burn that goes on within [start, end], and how its coast ends.

        That is the time until the coast ends that goes on or comes next, infinite where no burn
        follows, and the thruster's angle then. Times [s] count from `start`; nothing is left of a
        burn while coasting.
        """
        assert self.burns is not None
        begins, ends, angles = self.burns.T
        k = int(np.searchsorted(ends, start, side='right'))
        burning = k < len(ends) and begins[k] < end
        left = float(ends[k] - start) if burning else 0.0
        k += burning
        if k == len(begins):
            return left, math.inf, None
        return left, float(begins[k] - start), float(angles[k])


@dataclass(frozen=True, eq=False)
class DesiredCommand:
    """
    What the robot should do now, from plan and feedback.

    `acceleration` (2,) m/s^2 and `torque` N m are wanted of a perfect robot; `alpha` is where the
    thruster rests when no more than `quiet` m/s^2 is wanted, `reach` where it may be. There is no
    thrust while the thruster is off by more than `aligned` rad. It turns the way round that brings
    it to the angle `onward` soonest after, where that is given.
    """

    acceleration: Array
    torque: float
    alpha: float
    reach: Reach
    quiet: float
    aligned: float
    onward: float | None = None


class RobotTracker(TrajectoryTracker):
    """
    Tracker of one floating robot; states and controls are those of `FloatingRobot`.

    `servo_share` of the error of the thruster's angle is taken away by one command.
    """

    parameters: RobotTrackerParameters

    def __init__(
        self, parameters: RobotTrackerParameters, servo_share: float = _SERVO_SHARE
    ) -> None:
        super().__init__(parameters, parameters.plant, robot_estimator(parameters))
        plant, limits, feedback = parameters.plant, parameters.limits, parameters.feedback
        self._largest = limits.thrust / plant.mass
        self._correcting = False
        self._servo_share = servo_share
        # The double integrator's regulator for weights 1 / error^2 and 1 / acceleration^2.
        self._stiffness = self._largest / feedback.position
        self._damping = math.sqrt(2.0 * self._stiffness)
        # An error of the position is taken away in this time or more. When keeping station the
        # thruster must turn half round to brake: there is time for it.
        self._shortest = self._damping / self._stiffness
        self._station = max(self._shortest, 2.0 * math.pi / limits.thruster_rate)
        spin = limits.torque / plant.inertia
        self._yaw_stiffness = spin / feedback.yaw
        self._yaw_damping = math.sqrt(2.0 * self._yaw_stiffness)

    def prepare(self, trajectory: Trajectory) -> RobotLaw:
        """Tabulate from where the thruster can reach the planned directions in time."""
        steps = max(1, math.ceil(trajectory.duration / _REACH_STEP))
        t = _REACH_STEP * np.arange(steps + 1)
        sample = trajectory.sample(trajectory.times[0] + t)
        alpha, thrust = sample.state[:, _ALPHA], sample.control[:, 0]
        burns = _burns(trajectory) if trajectory.interpolation == 'zero_order_hold' else None
        share = _LATERAL if burns is None else _BURN_LATERAL
        lateral = share * self.parameters.limits.thrust
        allowed = np.minimum(lateral / np.maximum(thrust, 1e-9), _ANY_DIRECTION)
        turned = self.parameters.limits.thruster_rate * t
        upper = np.minimum.accumulate((alpha + allowed + turned)[::-1])[::-1] - turned
        lower = np.maximum.accumulate((alpha - allowed - turned)[::-1])[::-1] + turned
        return RobotLaw(lower, upper, burns)

    def error(self, state: Array, reference: Array) -> Array:
        """State minus reference (7,); angles the shorter way round."""
        error = state[:7] - reference[:7]
        error[[_YAW, _ALPHA]] = wrapped(error[[_YAW, _ALPHA]])
        return error

    def deviation(self, error: Array) -> float:
        """Return the distance from the planned position [m]."""
        return math.hypot(error[0], error[1])

    @property
    def lead(self) -> float:
        """Time [s] that the thruster takes to turn to where a motion begins."""
        return math.pi / self.parameters.limits.thruster_rate

    def wait(self, motion: Motion, state: Array) -> Array:
        """Turn the thruster to where the motion begins."""
        target = float(motion.trajectory.states[0, _ALPHA])
        angle = float(wrapped(np.asarray(target - state[_ALPHA])))
        return np.array([0.0, self._servo(angle), 0.0])

    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Planned acceleration and torque plus feedback."""
        law: RobotLaw = motion.law
        elapsed = time - motion.start
        at = motion.trajectory.times[0] + elapsed
        interval = self.parameters.interval
        instants = at + interval * np.array([0.0, 0.5, 1.0])
        reference, middle, after = motion.trajectory.sample(instants).state
        thrust, _, torque = mean_controls(motion.trajectory, [at, at + interval])[0]
        driven = self.parameters.plant.derivative(middle, np.array([thrust, 0.0, torque]))
        error = self.error(state, reference)
        near = float(state[_ALPHA] - error[_ALPHA] - reference[_ALPHA])  # whole turns apart
        reach = law.reach(elapsed + interval)
        desired = self._desired(
            acceleration=-self._stiffness * error[:2] - self._damping * error[2:4],
            torque=torque + self._yaw_feedback(error),
            alpha=float(after[_ALPHA]) + near,
            reach=Reach(reach.lower + near, reach.upper + near),
        )
        if law.burns is not None:
            left, horizon, onward = law.ahead(elapsed, elapsed + interval)
            horizon = self._station if horizon == math.inf else max(horizon, self._shortest)
            if left == 0.0:
                onward = None if onward is None else onward + near
                desired = replace(self._coasting(desired, error, horizon), onward=onward)
            else:
                self._correcting = False
                wanted = -self._off(error, horizon) / max(left, _PULSE * interval)
                desired = replace(desired, acceleration=wanted)
        control = self._drive(
            state, replace(desired, acceleration=driven[2:4] + desired.acceleration)
        )
        feedback = control - [thrust, 0.0, torque]
        return Action(control, feedback, error, reference)

    def hold(self, motion: Motion, time: float, state: Array) -> Action:
        """Keep station at the end of the trajectory."""
        goal = motion.trajectory.states[-1].copy()
        goal[[2, 3, _OMEGA]] = 0.0
        goal[_ALPHA] = state[_ALPHA]
        error = self.error(state, goal)
        desired = self._desired(
            np.zeros(2), self._yaw_feedback(error), float(state[_ALPHA]), _FREE
        )
        control = self._drive(state, self._coasting(desired, error, self._station))
        return Action(control, control, error, goal)

    def recover(self, state: Array) -> Array:
        """Brake."""
        still = np.zeros(7)
        still[[0, 1, _YAW, _ALPHA]] = state[[0, 1, _YAW, _ALPHA]]
        desired = self._desired(
            acceleration=-self._damping * state[2:4],
            torque=self._yaw_feedback(self.error(state, still)),
            alpha=float(state[_ALPHA]),
            reach=_FREE,
        )
        return self._drive(state, desired)

    def calm(self, state: Array, slack: float) -> bool:
        """Whether the robot drifts and turns slowly."""
        speed, turn = math.hypot(state[2], state[3]), abs(state[_OMEGA])
        return speed < slack * _CALM_SPEED and turn < slack * _CALM_TURN

    def _desired(
        self, acceleration: Array, torque: float, alpha: float, reach: Reach
    ) -> DesiredCommand:
        feedback = self.parameters.feedback
        quiet = feedback.deadband * self._largest
        return DesiredCommand(acceleration, torque, alpha, reach, quiet, feedback.misalignment)

    def _coasting(self, desired: DesiredCommand, error: Array, horizon: float) -> DesiredCommand:
        """
        Return the desired command of a robot that coasts for another `horizon` s.

        What is to be corrected keeps its direction while the thruster turns. Feedback that led
        back sooner would turn it at the regulator's own rate, and a slow thruster after it.
        """
        off = self._off(error, horizon)
        allowed = self.parameters.feedback.coasting
        level = _SETTLED * allowed if self._correcting else allowed
        self._correcting = math.hypot(off[0], off[1]) * horizon > level
        pulse = off / (_PULSE * self.parameters.interval) if self._correcting else np.zeros(2)
        return replace(desired, acceleration=-pulse, quiet=0.0, aligned=_ALIGNED)

    @staticmethod
    def _off(error: Array, horizon: float) -> Array:
        """Return the velocity (2,) too much for the error to be gone after `horizon` s."""
        off: Array = error[2:4] + error[:2] / horizon
        return off

    def _yaw_feedback(self, error: Array) -> float:
        turn = self._yaw_stiffness * error[_YAW] + self._yaw_damping * error[_OMEGA]
        return float(-self.parameters.plant.inertia * turn)

    def _servo(self, angle: float) -> float:
        """Rate of the thruster that takes away an error `angle` [rad]."""
        limit = self.parameters.limits.thruster_rate
        return min(max(self._servo_share * angle / self.parameters.interval, -limit), limit)

    def _drive(self, state: Array, desired: DesiredCommand) -> Array:
        """Return the controls (3,) nearest to the desired command."""
        limits, plant = self.parameters.limits, self.parameters.plant
        wanted = math.hypot(desired.acceleration[0], desired.acceleration[1])
        alpha, heading = float(state[_ALPHA]), float(state[_YAW] + state[_ALPHA])
        off = math.atan2(desired.acceleration[1], desired.acceleration[0]) - heading
        off = float(wrapped(np.asarray(off)))
        turn = off
        if desired.onward is not None:
            onward, other = desired.onward - alpha, off - math.copysign(math.tau, off)
            if abs(other) + abs(onward - other) < abs(off) + abs(onward - off):
                turn = other
        target = desired.alpha if wanted <= desired.quiet else alpha + turn
        if desired.reach.lower <= desired.reach.upper:
            target = min(max(target, desired.reach.lower), desired.reach.upper)
        rate = self._servo(target - alpha)
        thrust = 0.0
        if abs(off) < desired.aligned:
            thrust = plant.mass * wanted * math.cos(off) / actuator_gains(state)[0]
        torque = desired.torque / actuator_gains(state)[1]
        torque = min(max(torque, -limits.torque), limits.torque)
        return np.array([min(thrust, limits.thrust), rate, torque])


def _burns(trajectory: Trajectory) -> Array:
    """Return a trajectory's burns (n, 3): start, end [s] and the thruster's angle at the start."""
    on = np.concatenate([[False], trajectory.controls[:-1, 0] > 0.0, [False]])
    begins, ends = np.flatnonzero(np.diff(on)).reshape(-1, 2).T
    times = trajectory.times - trajectory.times[0]
    return np.stack([times[begins], times[ends], trajectory.states[begins, _ALPHA]], axis=1)
