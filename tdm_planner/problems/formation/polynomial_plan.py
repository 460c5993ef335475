# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
From reference motions to trajectories: inverse dynamics, with a thruster that turns slowly.

A robot that accelerates and then brakes turns its thrust by half a turn while little thrust is
wanted. An error of the direction costs a lateral acceleration F sin(error), so the error allowed
at an instant is e / F for some acceleration e. The smallest e is sought for which a direction
exists that is within the allowed errors at all instants and turns no faster than the limit: the
upper and lower envelopes of the allowed directions, with the limit as their Lipschitz constant,
must not cross. One causal pass then follows the wanted direction between the envelopes.

Where the thruster cannot follow, the thrust is the projection of the wanted acceleration on the
direction it has, and the small error this leaves at the end is taken back by shooting: a smooth
acceleration is added where thrust is on and has room, until forward integration of (17) under
exactly the controls that are published ends at the goal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from tdm_planner.arrays import Array
from tdm_planner.direct_method.bases import bernstein_basis
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.formation.polynomial_kernels import Values
from tdm_planner.problems.formation.reference_motion import (
    acceleration,
    arcs_at,
    end_derivatives,
    MotionForm,
)
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.verification import flown
from tdm_planner.trajectory import to_nanoseconds, Trajectory

_SAMPLES = 401
_SHORTEST_STEP = 0.01
_SHOTS = 9
_TURNED = 1e-12  # rad, rad/s: what is left of an error of the attitude at the end
_AIM = np.array([2e-4, 1e-4, 2e-4, 1e-4])  # of x, u, y, v [m, m/s]
_ANY_DIRECTION = 50.0  # [rad] an allowed error that allows everything
_RATE_SHARE = 0.98  # of the limit used to turn
_SLACK = 1.2  # over the least error, so that small changes of what is wanted fit in
_BISECTIONS = 12


def trajectory(
    task: FormationTask,
    form: MotionForm,
    values: Values,
    robot: int,
    budget: Budget,
    enough: float,
) -> Trajectory:
    """
    Return controls of one robot and the states that follow from them by forward integration.

    The end is corrected until it misses the goal by `enough` times .2 mm, .1 mm/s, or until the
    `budget` is spent.
    """
    times, wanted, yaw_acceleration = _wanted(task, form, values, robot)
    yaw, torque = _turned(task, robot, times, yaw_acceleration)
    given = task.thruster_rate, task.thrust, float(task.alpha[robot])
    direction = ThrustDirection(times, wanted, yaw, *given)

    def fly(aim: Array) -> Trajectory:
        """Project accelerations on the thruster's direction and integrate (17)."""
        alpha, rate = direction.follow(aim)
        heading = alpha + yaw
        along = aim[:, 0] * np.cos(heading) + aim[:, 1] * np.sin(heading)
        push = task.plant.mass * np.clip(along, 0.0, task.thrust)
        controls = np.stack([push, rate, task.plant.inertia * torque], axis=1)
        return flown(task, robot, times, controls, alpha[0], 'linear')

    if task.staying[robot]:
        return fly(np.zeros_like(wanted))
    goal = np.array([task.goal[robot, 0], 0.0, task.goal[robot, 1], 0.0])
    shapes, effects = _corrections(times, wanted, task.thrust)

    def shot(sizes: Array) -> CorrectedMotion:
        added = np.stack([shapes @ sizes[:2], shapes @ sizes[2:]], axis=1)
        motion = fly(wanted + added)
        return CorrectedMotion(sizes, motion, (motion.states[-1, [0, 2, 1, 3]] - goal) / _AIM)

    return _shoot(shot, effects, budget, enough).flown


def _wanted(
    task: FormationTask, form: MotionForm, values: Values, robot: int
) -> tuple[Array, Array, Array]:
    """Evenly spaced instants (N,) s, accelerations wanted then, (N, 2) and of the yaw (N,)."""
    coast, b = float(task.coast[robot]), values.x[robot, : form.degree + 1]
    moving = float(b.mean())
    count = min(_SAMPLES, max(8, int((coast + moving) / _SHORTEST_STEP)))
    times = to_nanoseconds(np.linspace(0.0, coast + moving, count))
    s = arcs_at(values.times[robot], moving, times - coast)
    speed = [bernstein_basis(form.degree, s, d) @ b for d in range(2)]
    basis, _ = end_derivatives(form.order, form.vary_ends)
    yaw_basis, _ = end_derivatives(form.yaw_order, False)
    position, yaw = values.ends[robot, :2, : form.order + 1], values.ends[robot, 2]
    path = [position @ basis.values(s, d).T for d in (1, 2)]
    turn = [yaw[: form.yaw_order + 1] @ yaw_basis.values(s, d).T for d in (1, 2)]
    wanted, yaw_acceleration = acceleration(*speed, *path), acceleration(*speed, *turn)
    wanted[:, times < coast] = 0.0
    yaw_acceleration[times < coast] = 0.0
    return times, wanted.T, yaw_acceleration


def _turned(task: FormationTask, robot: int, times: Array, wanted: Array) -> tuple[Array, Array]:
    """
    Yaw (N,) and yaw acceleration that torques linear between samples really give.

    The torque is limited, and corrected where it has room so that the attitude ends at its goal.
    """
    torque = np.clip(wanted, -task.torque, task.torque)
    left = times[-1] - times
    steps = np.diff(times)

    def integrate(torque: Array) -> tuple[Array, Array]:
        rate = task.yaw_rate[robot] + cumulative_trapezoid(torque, times, initial=0)
        turned = steps * (rate[:-1] + steps * (2 * torque[:-1] + torque[1:]) / 6)
        return task.yaw[robot] + np.concatenate([[0.0], np.cumsum(turned)]), rate

    room = np.where(torque == 0.0, 0.0, 1.0 - np.abs(torque) / task.torque)
    shapes = room[:, None] * np.stack([np.ones_like(left), left / left[0]], axis=1)
    effects = _effects(times, shapes)
    yaw, rate = integrate(torque)
    for _ in range(3 if room.any() else 0):
        error = np.array([yaw[-1] - task.goal_yaw[robot], rate[-1]])
        if np.abs(error).max() < _TURNED:
            break
        change = shapes @ np.linalg.lstsq(effects, -error, rcond=None)[0]
        torque = np.clip(torque + change, -task.torque, task.torque)
        yaw, rate = integrate(torque)
    return yaw, torque


class CorrectedMotion(NamedTuple):
    """Sizes of the corrections (4,), the flight they lead to, its errors in units of `_AIM`."""

    sizes: Array
    flown: Trajectory
    error: Array

    @property
    def miss(self) -> float:
        """Return the largest error."""
        return float(np.abs(self.error).max())


def _shoot(
    fly: Callable[[Array], CorrectedMotion], effects: Array, budget: Budget, enough: float
) -> CorrectedMotion:
    """
    Correct until the end is hit within `enough`, or the nearest shot where none is.

    Broyden's method from the `effects` (4, 4) that corrections had on the errors, were thrust
    ideal.
    """
    best = shot = fly(np.zeros(4))
    for _ in range(_SHOTS):
        if best.miss <= enough or budget.spent:
            break
        change = -np.linalg.lstsq(effects, shot.error, rcond=1e-6)[0]
        last, shot = shot, fly(shot.sizes + change)
        gained = shot.error - last.error - effects @ change
        effects = effects + np.outer(gained, change) / (change @ change)
        best = min(best, shot, key=lambda each: each.miss)
    return best


def _effects(times: Array, shapes: Array) -> Array:
    """Return what accelerations `shapes` (N, m) add to final position and velocity (2, m)."""
    half = np.diff(times) / 2
    weights = np.append(half, 0.0)  # of the trapezoidal rule
    weights[1:] += half
    return np.stack([weights * (times[-1] - times), weights]) @ shapes


def _corrections(times: Array, wanted: Array, thrust: float) -> tuple[Array, Array]:
    """
    Corrections of the accelerations `wanted` (N, 2), and what they do to the final state.

    They go where thrust is on, so that its direction is well held, and where it has room. An axis
    has two, room(t) (1, d(t)) as (N, 2), scaled so that each moves the end by about `_AIM`. The
    effects (4, 4) are on the scaled errors of x, u, y, v, were thrust ideal.
    """
    force = np.hypot(wanted[:, 0], wanted[:, 1]) / thrust
    room = np.minimum(force, 0.3) * np.clip(1.03 - force, 0.02, 0.4) + 1e-6
    room[force == 0.0] = 0.0
    left = times[-1] - times
    shapes = room[:, None] * np.stack([left / left[0], 1.0 - left / left[0]], axis=1)
    effects = _effects(times, shapes) / _AIM[:2, None]
    scale = np.abs(effects).max(axis=0)
    return shapes / scale, np.kron(np.eye(2), effects / scale)


class ThrustDirection:
    """
    Follow wanted accelerations (n, 2) [m/s^2] at evenly spaced `times` (n,) s.

    `yaw` (n,) rad; `rate` [rad/s] limits the thruster, `thrust` [m/s^2] the acceleration; `alpha`
    is the thruster's angle at the start, NaN where it is free.
    """

    def __init__(
        self, times: Array, wanted: Array, yaw: Array, rate: float, thrust: float, alpha: float
    ) -> None:
        self.times, self.yaw = times, yaw
        self.rate, self.thrust, self.alpha = rate, thrust, alpha
        self.steps = np.diff(_RATE_SHARE * rate * times)
        self.heading = np.unwrap(self._headings(wanted))
        if not np.isnan(alpha):
            away = self.heading[0] - yaw[0] - alpha
            self.heading -= 2 * np.pi * np.round(away / (2 * np.pi))
        self.error = self._least_error(wanted)

    def _headings(self, wanted: Array) -> Array:
        """Headings of the wanted accelerations, held where nothing is wanted (n,) rad."""
        heading = np.arctan2(wanted[:, 1], wanted[:, 0])
        idle = np.hypot(wanted[:, 0], wanted[:, 1]) < 1e-9 * self.thrust
        if idle.all():
            return np.zeros(len(wanted))
        powered = np.maximum.accumulate(np.where(idle, -1, np.arange(len(wanted))))
        return np.asarray(heading[np.where(powered < 0, int(np.argmin(idle)), powered)])

    def _directions(self, wanted: Array) -> Array:
        """
        Directions of the wanted accelerations from the robot's front, continuous (n,) rad.

        They stay on the branch of the accelerations first asked for, which may differ a little.
        """
        change = np.angle(np.exp(1j * (self._headings(wanted) - self.heading)))
        return np.asarray(self.heading + change - self.yaw)

    def _envelopes(
        self, wanted: Array, direction: Array, error: float
    ) -> tuple[Array, Array, bool]:
        """Bounds (n,) of directions within `error` [m/s^2] of what is wanted; if any are left."""
        force = np.maximum(np.hypot(wanted[:, 0], wanted[:, 1]), 1e-12)
        allowed = np.minimum(error / force, _ANY_DIRECTION)
        upper, lower = direction + allowed, direction - allowed
        if not np.isnan(self.alpha):
            upper[0] = lower[0] = self.alpha
        _enclose(upper, lower, self.steps)
        return upper, lower, bool((upper >= lower).all())

    def _least_error(self, wanted: Array) -> float:
        direction = self._directions(wanted)
        if self._envelopes(wanted, direction, 1e-9 * self.thrust)[2]:
            return 1e-9 * self.thrust
        low, high = 0.0, 6.0 * self.thrust
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high) if low > 0 else 0.25 * high
            if self._envelopes(wanted, direction, middle)[2]:
                high = middle
            else:
                low = middle
            if high < 1e-4 * self.thrust:
                break
        return high

    def follow(self, wanted: Array) -> tuple[Array, Array]:
        """
        Thruster angle [rad] and rate [rad/s] (n,) that follow the wanted accelerations.

        The rate runs linearly between samples, the angle is its exact integral. A thruster whose
        thrust is never wanted rests.
        """
        if np.abs(wanted).max() < 1e-9 * self.thrust:
            rest = 0.0 if np.isnan(self.alpha) else self.alpha
            return np.full(len(wanted), rest), np.zeros(len(wanted))
        direction = self._directions(wanted)
        error = _SLACK * self.error
        upper, lower, some = self._envelopes(wanted, direction, error)
        while not some and error < 6.0 * self.thrust:
            error = max(1.1 * error, 1e-5 * self.thrust)
            upper, lower, some = self._envelopes(wanted, direction, error)
        # Where no direction will do, the thruster still starts where it stands.
        first = self.alpha
        if np.isnan(first):
            first = min(max(float(direction[0]), float(lower[0])), float(upper[0]))
        angles = np.empty(direction.size)
        follow(direction, lower, upper, self.steps, first, angles)
        slopes = np.diff(angles) / np.diff(self.times)
        padded = np.concatenate([slopes[:1], slopes, slopes[-1:]])
        rate = 0.5 * (padded[1:] + padded[:-1])
        return angles[0] + cumulative_trapezoid(rate, self.times, initial=0), rate


@compiled
def follow(
    wished: Array, lower: Array, upper: Array, steps: Array, first: float, angles: Array
) -> None:
    """Fill `angles` (n,): as desired within the envelopes, in `steps` (n - 1,) at most."""
    angle = angles[0] = first
    for k in range(1, wished.size):
        step = steps[k - 1]
        least, most = max(lower[k], angle - step), min(upper[k], angle + step)
        angle = max(min(max(wished[k], least), most, angle + step), angle - step)
        angles[k] = angle


@compiled
def _enclose(upper: Array, lower: Array, steps: Array) -> None:
    """Tighten bounds (n,) to what can be reached from all others with `steps` (n - 1,) at most."""
    last = steps.size
    for k in range(last):
        upper[k + 1] = min(upper[k + 1], upper[k] + steps[k])
        lower[k + 1] = max(lower[k + 1], lower[k] - steps[k])
    for k in range(last - 1, -1, -1):
        upper[k] = min(upper[k], upper[k + 1] + steps[k])
        lower[k] = max(lower[k], lower[k + 1] - steps[k])
