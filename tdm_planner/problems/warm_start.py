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

"""First guess from a plan in force: its remaining motion, projected on new reference functions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.base import Solution
from tdm_planner.problems.formation_seeds import BowSeeds
from tdm_planner.problems.reference_motion import ReferenceMotion
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_INSTANTS = 41
_LEAST_REMAINDER = 0.02  # of the plan's duration


def warm_parameters(model: ReferenceMotion, seeds: BowSeeds, solution: Solution) -> Array | None:
    """
    Scaled varied parameters (n, P) of the rest of a plan; None if its robots are others.

    How far the plan has been followed is read from the robots' states: the instant at which, all
    robots together, the plan is nearest to where they are.
    """
    task = model.task
    if set(solution.trajectories) != set(task.names):
        return None
    plans = [solution.trajectories[name] for name in task.names]
    now = elapsed_on(plans, np.concatenate([task.start, task.velocity], axis=1))
    b = np.repeat(seeds.durations[:, None], model.nb, axis=1)
    shape = np.zeros((task.n, 2, model.nf))
    for i, plan in enumerate(plans):
        rest = plan.duration - now
        if rest < _LEAST_REMAINDER * plan.duration:
            continue
        b[i] = rest
        shape[i] = _project(model, plan, now, rest, i)
    return model.pack(b, shape)


def elapsed_on(plans: list[Trajectory], now: Array) -> float:
    """Instant of the plans nearest to positions and velocities `now` (n, 4)."""
    last = max(plan.duration for plan in plans)
    times = np.linspace(0.0, last, 400)
    distance = np.zeros(times.size)
    for plan, state in zip(plans, now, strict=True):
        planned = plan.sample(times).state[:, :4]
        scale = np.array([1.0, 1.0, last / 4, last / 4])
        distance += np.square((planned - state) * scale).sum(axis=1)
    return float(times[np.argmin(distance)])


def _project(
    model: ReferenceMotion, plan: Trajectory, now: float, rest: float, robot: int
) -> Array:
    """Shapes (2, nf) whose second derivatives fit the planned accelerations best."""
    s = np.linspace(0.0, 1.0, _INSTANTS)
    state, control = plan.sample(now + rest * s)
    heading = state[:, 4] + state[:, 6]
    push = control[:, 0] / model.task.plant.mass * rest**2
    wanted = push * np.stack([np.cos(heading), np.sin(heading)])
    zero = model.pack(
        np.full((model.task.n, model.nb), rest), np.zeros((model.task.n, 2, model.nf))
    )
    curvature = model.values(s, 2)
    base = model.unpack(zero).position[robot] @ curvature.T
    fit, *_ = np.linalg.lstsq(curvature @ model.basis.free, (wanted - base).T, rcond=None)
    return np.asarray(fit.T)
