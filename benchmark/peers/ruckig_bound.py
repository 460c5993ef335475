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
What robots alone on an empty floor could do at best: motions by Ruckig along straight ways.

Thrust off, full thrust one way, coasting, full thrust the other way: no motion of the same time
takes less gas. Without collisions, turning of thrusters and walls its J bounds every plan's from
below; Ruckig, which knows nothing of gas, is told the speed of coasting.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import time

import numpy as np
from numpy.typing import NDArray
import ruckig
from scipy.optimize import minimize_scalar
from tdm_planner.problems.formation_task import FormationTask

Array = NDArray[np.float64]

_LONGEST = 300.0  # s
_SAMPLES = 400


@dataclass(frozen=True)
class Bound:
    """Lower bound of J, processor time of Ruckig [s], smallest distance of two robots [m]."""

    cost: float
    seconds: float
    separation: float


def coasting_speed(distance: float, duration: float, acceleration: float) -> float:
    """Speed [m/s] at which a way is covered from rest to rest in a time."""
    reach = acceleration * duration
    return (reach - math.sqrt(max(reach**2 - 4 * acceleration * distance, 0.0))) / 2


def shortest_time(distance: float, acceleration: float) -> float:
    """Time [s] that full thrust one way, then the other takes."""
    return 2 * math.sqrt(distance / acceleration)


def bound(task: FormationTask) -> Bound:
    """
    Return the bound of a manoeuvre from rest, its arrivals `interval` apart.

    Leaving that sequence cannot pay where a second of it costs as much as one of the first
    arrival.
    """
    ways = np.linalg.norm(task.goal - task.start, axis=1)
    late = task.interval * np.arange(task.n)
    earliest = max(
        shortest_time(float(way), task.thrust) - float(lag)
        for way, lag in zip(ways, late, strict=True)
    )

    def cost(first: float) -> float:
        speeds = [
            coasting_speed(float(way), first + float(lag), task.thrust)
            for way, lag in zip(ways, late, strict=True)
        ]
        return float(task.weights[0] * first + task.weights[2] * 2 * sum(speeds))

    found = minimize_scalar(
        cost, bounds=(max(earliest, 0.0), _LONGEST), method='bounded', options={'xatol': 1e-6}
    )
    began = time.process_time()
    motions = [
        _motion(float(way), coasting_speed(float(way), found.x + float(lag), task.thrust), task)
        for way, lag in zip(ways, late, strict=True)
    ]
    seconds = time.process_time() - began
    return Bound(float(found.fun), seconds, _separation(task, motions, ways))


def _motion(way: float, speed: float, task: FormationTask) -> ruckig.Trajectory:
    given = ruckig.InputParameter(1)
    given.current_position, given.target_position = [0.0], [way]
    given.max_velocity, given.max_acceleration = [speed], [task.thrust]
    motion = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(given, motion)
    assert result in (ruckig.Result.Working, ruckig.Result.Finished)
    return motion


def _separation(task: FormationTask, motions: list[ruckig.Trajectory], ways: Array) -> float:
    last = max(motion.duration for motion in motions)
    places = []
    for i, motion in enumerate(motions):
        share = [
            motion.at_time(min(t, motion.duration))[0][0] / ways[i]
            for t in np.linspace(0.0, last, _SAMPLES)
        ]
        places.append(task.start[i] + np.array(share)[:, None] * (task.goal[i] - task.start[i]))
    place = np.array(places)
    one, other = np.triu_indices(task.n, 1)
    return float(np.linalg.norm(place[one] - place[other], axis=2).min())
