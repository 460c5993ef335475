# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""First guesses of swing-ups for collocation: the straight line, and energy pumping."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.base import runge_kutta_step
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_LONGEST, _STEP = 3.0, 2e-3  # s


@dataclass(frozen=True)
class Pumping:
    """Gains of the energy controller, in units of the torque limit, rad and 1/w0."""

    energy: float
    angle: float
    rate: float


HARD = Pumping(1000.0, 0.0, 0.0)
GENTLE = Pumping(30.0, 1.0, 0.3)


def straight_line(task: SwingUpTask) -> Trajectory:
    """From the start straight to the nearest upright, without torque, in 6 / w0."""
    states = np.stack([task.start, task.goal_nearest(task.start)])
    duration = 6.0 / task.plant.natural_frequency
    return _motion(task, np.array([0.0, duration]), states, np.zeros(2))


def energy_swing(task: SwingUpTask, gains: Pumping) -> Trajectory:
    """
    Return the motion under energy pumping, up to where it comes nearest to upright at rest.

    The torque drives the pendulum's energy to that of upright (Astrom and Furuta, "Swinging up a
    pendulum by energy control", 2000) and the disk back to its zero.
    """
    plant, w0 = task.plant, task.plant.natural_frequency
    states, torques = [task.start], []
    for _ in range(int(_LONGEST / _STEP)):
        torques.append(_pump(states[-1], w0, gains) * task.torque)
        states.append(runge_kutta_step(plant, states[-1], np.array([torques[-1]]), _STEP))
    path = np.array(states)
    away = path * np.array([1.0, 0.3, 1.0 / w0, 0.3 / w0])
    away[:, 0] -= 2 * np.pi * np.round(path[:, 0] / (2 * np.pi))
    last = int(np.argmin(np.linalg.norm(away, axis=1)[50:])) + 50
    times = _STEP * np.arange(last + 1)
    return _motion(task, times, path[: last + 1], np.array([*torques[:last], 0.0]))


def _pump(state: Array, w0: float, gains: Pumping) -> float:
    theta, psi, rate, disk_rate = state.tolist()
    lack = 0.5 * (rate / w0) ** 2 + math.cos(theta) - 1.0
    drive = gains.energy * lack * (rate / w0 or 1e-3) * math.cos(theta)
    return max(-1.0, min(1.0, drive - gains.angle * psi - gains.rate * disk_rate / w0))


def _motion(task: SwingUpTask, times: Array, states: Array, torques: Array) -> Trajectory:
    return Trajectory.of(task.plant, times, states, torques[:, None], 'linear')
