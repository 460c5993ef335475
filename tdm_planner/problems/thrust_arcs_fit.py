# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""First guesses of rounded polylines from earlier plans: fitted to them, or what is left."""

from __future__ import annotations

from collections.abc import Collection, Mapping
import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.thrust_arcs_approaches import positions
from tdm_planner.problems.thrust_arcs_kernels import add_slope, round_off
from tdm_planner.problems.thrust_arcs_program import ArcProgram
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_INSTANTS = 40
_EVALUATIONS = 8
_CORRECTED = 0.6  # half-turns of the thruster before a burn that leave time for another one


@compiled
def _path_slopes(times: Array, burns: Array, slopes: Array) -> Array:
    """Slopes (K, 2, v) of the positions at `times` (K,)."""
    found, along = np.zeros((times.size, 2, slopes.shape[2])), np.zeros(2)
    for a in range(2):
        along[a], along[1 - a] = 1.0, 0.0
        for k in range(times.size):
            add_slope(times[k], burns, slopes, along, found[k, a])
    return found


def fitted(program: ArcProgram, plans: Mapping[str, Trajectory]) -> Array:
    """Parameters (n, v) whose motions are nearest to planned ones at equal times, as long."""
    task, size = program.task, program.size
    lower, upper = program.full(program.lower), program.full(program.upper)
    found = np.zeros((task.n, size))
    for i, name in enumerate(task.names):
        plan = plans[name]
        found[i, -1] = duration = float(np.clip(plan.duration, lower[i, -1], upper[i, -1]))
        if not program.varied[i]:
            continue
        corners = np.arange(1, size - 1, 3)
        share = np.arange(1, corners.size + 1) / (corners.size + 1)
        low, high = lower[i, :-1].copy(), upper[i, :-1].copy()
        high[0] = 0.2 * duration
        low[corners + 2] = (share - 0.65 / (corners.size + 1)) * duration
        high[corners + 2] = (share + 0.65 / (corners.size + 1)) * duration
        start = plan.sample(share * plan.duration).state
        first = np.zeros(size - 1)
        first[corners], first[corners + 1] = start[:, 0], start[:, 1]
        first[corners + 2] = share * duration
        found[i, :-1] = _nearest(program, i, plan, duration, first, low, high)
    return found


def remaining(plan: Trajectory) -> Array:
    """Burns (k, 4) of a plan whose thrust is on or off, as `thrust_arcs_kernels` has them."""
    on = plan.control('thrust')[:-1] > 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
    begin, end = plan.times[edges[::2]], plan.times[edges[1::2]]
    velocity = np.stack([plan.state('u'), plan.state('v')], axis=1)
    change = velocity[edges[1::2]] - velocity[edges[::2]]
    return np.column_stack([change, 0.5 * (begin + end), 0.5 * (end - begin)])


def resumed(task: FormationTask, plans: Mapping[str, Trajectory], held: Collection[str]) -> Array:
    """
    Parameters (n, v) that go on with the rest of plans, with as many burns as they have.

    Goals are reached from where the rest of a plan turns last; the start may be off it. Robots
    whose motion is `held` need none.
    """
    leg = math.pi / task.thruster_rate
    rests = {
        i: remaining(plans[name])
        for i, name in enumerate(task.names)
        if not task.staying[i] and name not in held
    }
    corners = max([1, *(len(rest) - 2 for rest in rests.values())])
    found = np.zeros((task.n, 3 * corners + 2))
    for i, name in enumerate(task.names):
        found[i, -1] = plans[name].duration
        if i not in rests or not len(rests[i]):
            continue
        rest = rests[i]
        begin, end = rest[:, 2] - rest[:, 3], rest[:, 2] + rest[:, 3]
        turns = rest[1:-1, 2].tolist()
        found[i, 0], after = begin[0], end[0]
        if len(rest) == 1:
            found[i, 0] = after = min(leg, 0.45 * begin[0])
        elif begin[0] > _CORRECTED * leg and len(turns) < corners:  # time to correct before
            found[i, 0] = after = min(leg, 0.45 * begin[0])
            turns.insert(0, rest[0, 2])
        while len(turns) < corners:
            turns.append(0.5 * ((turns[-1] if turns else after) + begin[-1]))
        for k, instant in enumerate(turns):
            left = np.maximum(rest[:, 2] - instant, 0.0)
            place = task.goal[i] + left @ rest[:, :2]
            found[i, np.arange(3) + 1 + 3 * k] = [*place, instant]
    return found


def _nearest(
    program: ArcProgram,
    i: int,
    plan: Trajectory,
    duration: float,
    first: Array,
    low: Array,
    high: Array,
) -> Array:
    """Parameters (v - 1,) of robot i but for the arrival, within bounds, that fit its plan."""
    times = np.linspace(0.0, duration, _INSTANTS)
    wanted = plan.sample(times).state[:, :2]
    burns, slopes = np.zeros((1, program.count, 4)), np.zeros((program.count, 4, program.size))
    both = slice(i, i + 1)

    def missed(z: Array) -> Array:
        round_off(np.append(z, duration), program.fleet, i, burns[0], slopes)
        path = positions(times, program.fleet.start[both], program.fleet.velocity[both], burns)
        return np.asarray((path[0] - wanted).ravel())

    def by(z: Array) -> Array:
        round_off(np.append(z, duration), program.fleet, i, burns[0], slopes)
        return np.asarray(_path_slopes(times, burns[0], slopes).reshape(wanted.size, -1)[:, :-1])

    room = 1e-6 * (high - low)
    first = np.clip(first, low + room, high - room)
    return np.asarray(
        least_squares(missed, first, by, bounds=(low, high), max_nfev=_EVALUATIONS).x
    )
