# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
From reference motions to trajectories: inverse dynamics, with a thruster that turns slowly.

Where the thruster cannot follow, the thrust is the projection of the wanted acceleration on the
direction it has, and the small error this leaves at the end is taken back by shooting: a smooth
acceleration is added where thrust is on and has room, until forward integration of (17) under
exactly the controls that are published ends at the goal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.problems.formation.reference_motion import acceleration as in_time
from tdm_planner.problems.formation.reference_motion import FormationMotion, ReferenceMotion
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.thrust_direction import ThrustDirection
from tdm_planner.problems.formation.verification import flown
from tdm_planner.trajectory import to_nanoseconds, Trajectory

Array = NDArray[np.float64]

_SAMPLES = 401
_SHORTEST_STEP = 0.01
_SHOTS, _CAREFUL_SHOTS = 9, 10
_STEP = 0.1  # of the error, by which corrections are differenced
_WEAK = 0.1  # of F_max: a manoeuvre may begin with less thrust in a wrong direction
_TURNED = 1e-12  # rad, rad/s: what is left of an error of the attitude at the end
_AIM = np.array([2e-4, 1e-4, 2e-4, 1e-4])  # of x, u, y, v [m, m/s]


@dataclass(frozen=True)
class Wanted:
    """
    What the reference motion asks of one robot at `times` (N,) s.

    `acceleration` (N, 2) m/s^2, `yaw` (N,) rad, `yaw_acceleration` (N,) rad/s^2.
    """

    times: Array
    acceleration: Array
    yaw: Array
    yaw_acceleration: Array


def wanted(model: ReferenceMotion, motion: FormationMotion, robot: int) -> Wanted:
    """Exact inverse of the reference motion of one robot on evenly spaced instants."""
    task = model.task
    coast = float(task.coast[robot])
    duration = coast + float(motion.durations[robot])
    count = min(_SAMPLES, max(8, int(duration / _SHORTEST_STEP)))
    times = to_nanoseconds(np.linspace(0.0, duration, count))
    s = model.arcs_at(motion, robot, times)
    speed = model.speed(motion, robot, s)
    turn = [motion.yaw[robot] @ model.yaw_basis.basis.values(s, d).T for d in range(3)]
    path = [motion.position[robot] @ model.basis.basis.values(s, d).T for d in (1, 2)]
    acceleration, yaw_acceleration = in_time(*speed, *path), in_time(*speed, *turn[1:])
    waiting = times < coast
    acceleration[:, waiting] = 0.0
    yaw_acceleration[waiting] = 0.0
    yaw = turn[0] + task.yaw_rate[robot] * np.minimum(times - coast, 0.0)
    return Wanted(times, acceleration.T, yaw, yaw_acceleration)


def initial_misalignment(model: ReferenceMotion, motion: FormationMotion) -> Array:
    """
    Angle [rad] by which each thruster must turn before the manoeuvre begins (n,).

    Zero where the thruster's angle is free, the robot stays, or the manoeuvre begins with so
    little thrust that the thruster can turn on the way.
    """
    task = model.task
    mu, slope = motion.rates[:, :1], (motion.rates @ model.tables.slope)[:, None]
    acceleration = in_time(mu, slope, motion.position[..., 1], motion.position[..., 2])
    heading = np.arctan2(acceleration[:, 1], acceleration[:, 0])
    away = heading - task.departure_yaw - task.alpha
    away = np.abs(np.angle(np.exp(1j * np.nan_to_num(away))))
    weak = np.linalg.norm(acceleration, axis=1) < _WEAK * task.thrust
    return np.where(task.staying | weak | np.isnan(task.alpha), 0.0, away)


def trajectory(
    model: ReferenceMotion,
    motion: FormationMotion,
    robot: int,
    budget: Budget | None = None,
    enough: float = 1.0,
    careful: bool = True,
) -> Trajectory:
    """
    Return controls of one robot and the states that follow from them by forward integration.

    The end is corrected until it misses the goal by `enough` times .2 mm, .1 mm/s, or until the
    `budget` is spent; by differences, where nothing else leads there, only if `careful`.
    """
    task, goal = model.task, model.task.goal[robot]
    aim = _turnable(task, robot, wanted(model, motion, robot))
    direction = ThrustDirection(
        aim.times,
        aim.acceleration,
        aim.yaw,
        task.thruster_rate,
        task.thrust,
        float(task.alpha[robot]),
    )
    if task.staying[robot]:
        return _fly(task, robot, aim, aim.acceleration, *direction.follow(aim.acceleration))
    shapes, effects = _corrections(aim.times, _room(aim.acceleration, task.thrust))

    def fly(sizes: Array) -> Shot:
        added = np.stack([shapes @ sizes[:2], shapes @ sizes[2:]], axis=1)
        acceleration = aim.acceleration + added
        flown = _fly(task, robot, aim, acceleration, *direction.follow(acceleration))
        error = flown.states[-1, [0, 2, 1, 3]] - [goal[0], 0.0, goal[1], 0.0]
        return Shot(sizes, flown, error / _AIM)

    return _shoot(fly, effects, budget, enough, _CAREFUL_SHOTS if careful else 0).flown


@dataclass(frozen=True, eq=False)
class Shot:
    """Sizes of the corrections (4,), the flight they lead to, its errors in units of `_AIM`."""

    sizes: Array
    flown: Trajectory
    error: Array

    @property
    def miss(self) -> float:
        """Return the largest error."""
        return float(np.abs(self.error).max())


def _shoot(
    fly: Callable[[Array], Shot],
    effects: Array,
    budget: Budget | None,
    enough: float,
    careful_shots: int,
) -> Shot:
    """
    Correct until the end is hit within `enough`, or the nearest shot where none is.

    Broyden's method from the `effects` (4, 4) that corrections had on the errors, were thrust
    ideal; then, where that has not led there, carefully, by what differences say they really do,
    in `careful_shots` at most.
    """
    best = shot = fly(np.zeros(4))
    first = effects

    def done() -> bool:
        return best.miss <= enough or (budget is not None and budget.spent)

    for _ in range(_SHOTS):
        if done():
            break
        change = -np.linalg.lstsq(first, shot.error, rcond=1e-6)[0]
        last, shot = shot, fly(shot.sizes + change)
        gained = shot.error - last.error - first @ change
        first = first + np.outer(gained, change) / (change @ change)
        best = min(best, shot, key=lambda each: each.miss)
    share = 1.0
    for _ in range(careful_shots):
        if done():
            break
        if share == 1.0:
            effects = _differenced(fly, best)
        change = -share * np.linalg.lstsq(effects, best.error, rcond=1e-3)[0]
        shot = fly(best.sizes + change)
        nearer = np.linalg.norm(shot.error) < np.linalg.norm(best.error)
        best, share = (shot, 1.0) if nearer else (best, 0.4 * share)
    return best


def _differenced(fly: Callable[[Array], Shot], at: Shot) -> Array:
    """Effects (4, 4) of every correction by differences."""
    step = max(1.0, _STEP * at.miss)
    columns = [(fly(at.sizes + step * unit).error - at.error) / step for unit in np.eye(4)]
    return np.stack(columns, axis=1)


def _effects(times: Array, shapes: Array) -> Array:
    """Return what accelerations `shapes` (N, m) add to final position and velocity (2, m)."""
    half = np.diff(times) / 2
    weights = np.append(half, 0.0)  # of the trapezoidal rule
    weights[1:] += half
    return np.stack([weights * (times[-1] - times), weights]) @ shapes


def _turnable(task: FormationTask, robot: int, aim: Wanted) -> Wanted:
    """
    Return what is wanted with the attitude that torques linear between samples really give.

    The torque is limited, and corrected where it has room so that the attitude ends at its goal.
    """
    torque = np.clip(aim.yaw_acceleration, -task.torque, task.torque)
    left = aim.times[-1] - aim.times
    steps = np.diff(aim.times)

    def integrate(torque: Array) -> tuple[Array, Array]:
        gain = steps * (torque[:-1] + torque[1:]) / 2
        rate = task.yaw_rate[robot] + np.concatenate([[0.0], np.cumsum(gain)])
        turned = steps * (rate[:-1] + steps * (2 * torque[:-1] + torque[1:]) / 6)
        return task.yaw[robot] + np.concatenate([[0.0], np.cumsum(turned)]), rate

    room = np.where(torque == 0.0, 0.0, 1.0 - np.abs(torque) / task.torque)
    shapes = room[:, None] * np.stack([np.ones_like(left), left / left[0]], axis=1)
    effects = _effects(aim.times, shapes)
    yaw, rate = integrate(torque)
    for _ in range(3 if room.any() else 0):
        error = np.array([yaw[-1] - task.goal_yaw[robot], rate[-1]])
        if np.abs(error).max() < _TURNED:
            break
        change = shapes @ np.linalg.lstsq(effects, -error, rcond=None)[0]
        torque = np.clip(torque + change, -task.torque, task.torque)
        yaw, rate = integrate(torque)
    return Wanted(aim.times, aim.acceleration, yaw, torque)


def _room(acceleration: Array, thrust: float) -> Array:
    """Where a correction goes (N,): thrust on, so that its direction is well held, and room."""
    force = np.hypot(acceleration[:, 0], acceleration[:, 1]) / thrust
    room = np.minimum(force, 0.3) * np.clip(1.03 - force, 0.02, 0.4) + 1e-6
    return np.asarray(np.where(force > 0.0, room, 0.0))


def _corrections(times: Array, room: Array) -> tuple[Array, Array]:
    """
    Corrections of the acceleration, and what they do to the final state.

    An axis has two, room(t) (1, d(t)) as (N, 2), scaled so that each moves the end by about
    `_AIM`. The effects (4, 4) are on the scaled errors of x, u, y, v, were thrust ideal.
    """
    left = times[-1] - times
    shapes = room[:, None] * np.stack([left / left[0], 1.0 - left / left[0]], axis=1)
    effects = _effects(times, shapes) / _AIM[:2, None]
    scale = np.abs(effects).max(axis=0)
    both = np.zeros((4, 4))
    both[:2, :2] = both[2:, 2:] = effects / scale
    return shapes / scale, both


def _fly(
    task: FormationTask,
    robot: int,
    aim: Wanted,
    acceleration: Array,
    alpha: Array,
    rate: Array,
) -> Trajectory:
    """Project the wanted acceleration on the thruster's direction and integrate (17)."""
    plant, heading = task.plant, alpha + aim.yaw
    along = acceleration[:, 0] * np.cos(heading) + acceleration[:, 1] * np.sin(heading)
    push = np.clip(along, 0.0, task.thrust)
    torque = plant.inertia * aim.yaw_acceleration
    controls = np.stack([plant.mass * push, rate, torque], axis=1)
    return flown(task, robot, aim.times, controls, alpha[0], 'linear')
