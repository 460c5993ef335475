# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Trajectories of rounded polylines: held controls, every switch of thrust and torque a sample.

The thruster turns as soon as a burn is over, rests while the robot coasts, and holds the thrust's
direction in the arena while it burns.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.formation_verification import flown
from tdm_planner.problems.thrust_arcs_kernels import attitude, turning
from tdm_planner.trajectory import to_nanoseconds, Trajectory

Array = NDArray[np.float64]

_SAMPLES = 50  # of a motion at least, for those that draw it or follow it
_TURNED = 2e-5  # rad: how far a held rate may let the thrust turn from its direction in a burn
_GENTLE = 0.5  # of the thruster's rate, with which it turns where there is time
_FULL = 0.9999  # of the thruster's rate
_SAME = 5e-9  # s: samples nearer than that are one
_MISSED = 1e-11  # m, m/s: what is left of an error of the end
_CORRECTIONS = 8
_DIGITS = 11  # of a rate [rad/s]: less is rounding, and no switch


def cleaned(
    task: FormationTask, robot: int, burns: Array, duration: float, weakest: float
) -> Array:
    """
    Burns (k, 4) without those that change the velocity by less than `weakest` m/s.

    The others, two at least, are corrected so that the robot rests at its goal after `duration`.
    """
    sizes = np.hypot(burns[:, 0], burns[:, 1])
    keep = np.zeros(sizes.size, dtype=bool)
    keep[np.argsort(sizes, kind='stable')[-2:]] = True
    keep |= sizes >= weakest
    found = burns[keep]
    ends = np.flatnonzero(keep)
    first, last = ends == 0, ends == sizes.size - 1
    begin = burns[0, 2] - burns[0, 3]
    velocity = task.velocity[robot]
    way = task.goal[robot] - task.start[robot] - velocity * duration
    for _ in range(_CORRECTIONS):
        p = found[:, :2]
        half = np.hypot(p[:, 0], p[:, 1]) / (2.0 * task.thrust)
        found[:, 3] = half
        found[first, 2] = begin + half[first]
        found[last, 2] = duration - half[last]
        left = duration - found[:, 2]
        missed = np.concatenate([way - left @ p, -velocity - p.sum(axis=0)])
        if np.abs(missed).max() < _MISSED:
            break
        bend = np.where(first, -1.0, np.where(last, 1.0, 0.0)) / (2.0 * task.thrust)
        unit = p / np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-12)[:, None]
        slopes = left[:, None, None] * np.eye(2)
        slopes = slopes + bend[:, None, None] * unit[:, :, None] * p[:, None]
        rows = np.concatenate([slopes, np.broadcast_to(np.eye(2), slopes.shape)], axis=1)
        rows = np.swapaxes(rows, 0, 1).reshape(4, -1)
        # Instants are worth more than velocities: both in metres.
        scale = np.array([1.0, 1.0, duration, duration])
        change = np.linalg.lstsq(rows * scale[:, None], missed * scale, rcond=1e-9)[0]
        found[:, :2] += change.reshape(-1, 2)
    return found


def arc_trajectory(task: FormationTask, robot: int, burns: Array, duration: float) -> Trajectory:
    """Return the held controls of a robot's burns (k, 4), and the states that follow."""
    plant = task.plant
    yaw, rate, goal = task.yaw[robot], task.yaw_rate[robot], task.goal_yaw[robot]
    a, switch = turning(duration, goal - yaw, rate)
    spin = a, switch, yaw, rate, goal
    on = np.stack([burns[:, 2] - burns[:, 3], burns[:, 2] + burns[:, 3]], axis=1)
    on = np.clip(on, 0.0, duration)
    path = _thruster_path(task, robot, burns, on, duration, spin)
    edges = [0.0, duration, *on.ravel(), *path[0], *np.linspace(0.0, duration, _SAMPLES)]
    if 0.0 < switch < duration:
        edges.append(switch)
    times = np.unique(to_nanoseconds(np.array(edges)))
    times = times[np.concatenate([[True], np.diff(times) > _SAME])]
    alpha = _turned(times, np.interp(times, *path), task.thruster_rate)
    middle = 0.5 * (times[1:] + times[:-1])
    burning = ((middle[:, None] > on[:, 0]) & (middle[:, None] < on[:, 1])).any(axis=1)
    controls = np.zeros((times.size, 3))
    controls[:-1, 0] = plant.mass * task.thrust * burning
    controls[:-1, 1] = np.round(np.diff(alpha) / np.diff(times), _DIGITS)
    controls[:-1, 2] = plant.inertia * np.where(middle < switch, a, -a)
    found = flown(task, robot, times, controls, alpha[0], 'zero_order_hold')
    return found.with_rates(plant.derivative)


def _thruster_path(
    task: FormationTask,
    robot: int,
    burns: Array,
    on: Array,
    duration: float,
    spin: tuple[float, float, float, float, float],
) -> tuple[Array, Array]:
    """Instants and angles of the thruster between which it turns evenly, at any rate."""
    now, angle = 0.0, float(task.alpha[robot])
    times, angles = [], []
    if not math.isnan(angle):
        times, angles = [0.0], [angle]
    step = math.sqrt(8.0 * _TURNED / max(abs(spin[0]), 1e-12))
    for burn, (begin, end) in zip(burns, on, strict=True):
        count = 1 + max(1, math.ceil((end - begin) / step))
        instants = np.linspace(begin, end, count)
        yaw = np.array([attitude(t, duration, *spin) for t in instants])
        held = math.atan2(burn[1], burn[0]) - yaw
        if math.isnan(angle):
            angle = held[0]
        held += 2.0 * math.pi * round((angle - held[0]) / (2.0 * math.pi))
        turn = abs(held[0] - angle)
        if begin > now and turn > 0.0:
            speed = max(_GENTLE * task.thruster_rate, turn / (begin - now))
            times.append(now + turn / speed)
            angles.append(held[0])
        known = 1 if times and begin <= times[-1] else 0  # burning from the start
        times.extend(instants[known:])
        angles.extend(held[known:])
        now, angle = end, held[-1]
    if not times:
        times, angles = [0.0], [0.0]
    return np.array(times), np.array(angles)


def _turned(times: Array, wanted: Array, most: float) -> Array:
    """Angles of a thruster that follows `wanted` (N,) as far as its rate allows."""
    reach = _FULL * most * np.diff(times)
    found = wanted.copy()
    if (np.abs(np.diff(wanted)) <= reach).all():
        return found
    for k in range(reach.size):
        found[k + 1] = found[k] + min(max(wanted[k + 1] - found[k], -reach[k]), reach[k])
    return found
