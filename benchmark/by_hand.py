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
The pendulum's search for switching times, written by hand: arrays, kernels, flat loops.

Method `switching` without the library's classes: no search, program, point, linearisation,
minimiser, trajectory or verification objects, but the same compiled kernels, that of the replay
among them, and the same QP solver, called directly. Random starts and decisions are the same,
deadlines are left out, so that it comes by the same plan: it is the yardstick for what the
library's structure costs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.pendulum_kernels import dormand_prince, replay_steps, roll_arcs
from tdm_planner.plants.pendulum_steering import steer_arcs, THOROUGH
from tdm_planner.plants.rotary_pendulum import Coefficients
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.switching_seeds import starts

Array = NDArray[np.float64]
Arcs = tuple[Array, Array, int]  # durations, torques, turns

STEERED, COARSE, FINE = 8, 12, 96  # RK4 steps an arc
_ROUNDS, _ROUND, _POLISHED, _CHECKED = 3, 100, 10, 4
_TIGHT = 1e-8


class Numbers(NamedTuple):
    """The problem as plain numbers."""

    k: Coefficients
    start: Array
    psi_max: float
    w0: float
    distance: float
    task: Any


def numbers(made: PendulumSwingUp) -> Numbers:
    """Return the problem as plain numbers."""
    task = made.task
    k, w0 = made.plant.coefficients, made.plant.natural_frequency
    return Numbers(k, task.start, task.planned_disk_angle, w0, task.distance, task)


def solve(made: PendulumSwingUp) -> float | None:
    """Return the time of the quickest plan that survives a replay."""
    n = numbers(made)
    best, done = math.inf, []
    for arcs in arrivals(made, np.random.default_rng(0))[:_POLISHED]:
        durations, violation = polish(n, *arcs, COARSE, 1.05 * best)
        done.append((float(durations.sum()), durations, arcs[1], arcs[2]))
        if violation < 1e-6:
            best = min(best, done[-1][0])
    done.sort(key=lambda found: found[0])
    for _, durations, torques, turns in done[:_CHECKED]:
        shorter = _without_short(n, durations, torques)
        for d, u in [shorter] if shorter[0] is durations else [shorter, (durations, torques)]:
            fine, violation = polish(n, d, u, turns, FINE, math.inf)
            if violation < 1e-6:
                break
        if _replayed(made, n, fine, u, turns):
            return float(fine.sum())
    return None


def arrivals(made: PendulumSwingUp, rng: np.random.Generator) -> list[Arcs]:
    """Steer random starts upright; all distinct arrivals, quickest first."""
    n, found = numbers(made), []
    for _ in range(_ROUNDS):
        batch = starts(n.task, rng, _ROUND, made.switching_arcs)
        durations, torques, arcs, costs = batch.durations, batch.torques, batch.arcs, batch.costs
        steer_arcs(
            n.k, np.tile(n.start, (arcs.size, 1)), durations, arcs, torques, batch.turns,
            n.psi_max, n.w0, STEERED, THOROUGH, costs,
        )  # fmt: skip
        for i in np.flatnonzero(costs < 1e-12):
            d, u = durations[i, : arcs[i]].copy(), torques[i, : arcs[i]].copy()
            end = _roll(n, d, u, STEERED)[-1]
            found.append((d, u, round(float(end[0]) / (2 * math.pi))))
    kept: list[Arcs] = []
    for d, u, turns in sorted(found, key=lambda arcs: float(arcs[0].sum())):
        if not kept or d.sum() - kept[-1][0].sum() > 2e-3 * d.sum():
            kept.append((d, u, turns))
    return kept


def _roll(n: Numbers, durations: Array, torques: Array, steps: int) -> Array:
    states, unused = np.empty((durations.size * steps + 1, 4)), np.empty((1, 4, 1))
    roll_arcs(n.k, n.start, durations, torques, steps, states, unused, False)
    return states


def _without_short(n: Numbers, durations: Array, torques: Array) -> tuple[Array, Array]:
    shortest = min(1e-5 / n.w0, 1e-4 * durations.sum())
    kept: list[list[float]] = []
    for duration, torque in zip(durations, torques, strict=True):
        if duration >= shortest:
            if kept and kept[-1][1] == torque:
                kept[-1][0] += duration
            else:
                kept.append([duration, torque])
    if len(kept) < 4 or len(kept) == durations.size:
        return durations, torques
    return np.array([d for d, _ in kept]), np.array([u for _, u in kept])


def _replayed(made: PendulumSwingUp, n: Numbers, durations: Array, u: Array, turns: int) -> bool:
    """Whether the plant, sampled as it is written and replayed, ends upright within the limits."""
    arcs = durations > 0.0
    ends, u = np.cumsum(durations[arcs]), u[arcs]
    spacing, first, samples = min(5e-3, 0.05 / n.w0), 0.0, [np.zeros(1)]
    for last, torque in zip(ends, u, strict=True):
        count = max(1, math.ceil((last - first) / spacing))
        _roll(n, np.full(count, (last - first) / count), np.full(count, torque), 8)
        samples.append(np.linspace(first, last, count + 1)[1:])
        first = last
    grid = np.linspace(0.0, first, math.ceil(first / 1e-3) + 1)
    times = np.union1d(grid, np.concatenate(samples))
    held = u[np.minimum(np.searchsorted(ends, times[:-1], side='right'), u.size - 1)]
    _, matrix, weights = dormand_prince()
    states = np.empty((times.size, 4))
    states[0] = n.start
    stages = np.repeat(held[:, None], weights.size, axis=1)
    replay_steps(n.k, np.diff(times), stages, matrix, weights, states)
    error = np.abs(states[-1] - [2 * math.pi * turns, 0.0, 0.0, 0.0])
    near = bool((error <= [1e-4, 1e-4, 1e-3, 1e-3]).all())
    return near and float(np.abs(states[:, 1]).max()) <= made.limits.disk_angle


def polish(
    n: Numbers, durations: Array, torques: Array, turns: int, steps: int, cutoff: float
) -> tuple[Array, float]:
    """Minimise the total time: durations, largest violation."""
    first = _evaluate(n, durations * n.w0, torques, turns, steps)
    best = first
    for penalty in (30.0, 1000.0):
        found = _sqp(n, first, torques, turns, steps, penalty / n.distance, cutoff * n.w0)
        if max(found[5], found[6]) <= max(_TIGHT, best[5], best[6]):
            best = found
        if max(best[5], best[6]) <= 100 * _TIGHT or found[0].sum() > cutoff * n.w0:
            break
    return best[0] / n.w0, max(best[5], best[6])


# xi, residual (4,), its jacobian, margins (K,), their jacobian, violations of ends and limits.
Values = tuple[Array, Array, Array, Array, Array, float, float]


def _evaluate(n: Numbers, xi: Array, torques: Array, turns: int, steps: int) -> Values:
    arcs, w0 = xi.size, n.w0
    d = xi / w0
    nodes = arcs * steps + 1
    states, slopes = np.empty((nodes, 4)), np.empty((nodes, 4, arcs))
    roll_arcs(n.k, n.start, d, torques, steps, states, slopes, True)
    scale = np.array([1.0, 1.0, 1.0 / w0, 1.0 / w0])
    residual = states[-1] * scale
    residual[0] -= 2 * math.pi * turns
    slopes /= w0
    jacobian = slopes[-1] * scale[:, None]
    ends = float(np.abs(residual).max())
    height = np.abs(states[1:, 1])
    if height.max() < n.psi_max - 0.3:
        return xi, residual, jacobian, np.full(arcs, np.inf), np.zeros((arcs, arcs)), ends, 0.0
    begin = np.arange(arcs) * steps
    node = begin + 1 + height.reshape(arcs, steps).argmax(axis=1)
    sign = np.where(states[node, 1] < 0, -1.0, 1.0)
    height, slope = np.abs(states[node, 1]), sign[:, None] * slopes[node, 1]
    left = np.where(sign * states[node, 3] > 0, node, node - 1)
    right = np.minimum(left + 1, begin + steps)
    up, down = sign * states[left, 3], sign * states[right, 3]
    for a in np.flatnonzero((right > left) & (up > 0) & (down < 0)):
        h, bend = d[a] / steps, up[a] - down[a]
        height[a] = sign[a] * states[left[a], 1] + 0.5 * h * up[a] ** 2 / bend
        slope[a] = sign[a] * (
            slopes[left[a], 1]
            + 0.5 * h * (2 * up[a] * bend - up[a] ** 2) / bend**2 * slopes[left[a], 3]
            + 0.5 * h * up[a] ** 2 / bend**2 * slopes[right[a], 3]
        )
        slope[a, a] += 0.5 * up[a] ** 2 / bend / (steps * w0)
    margins = n.psi_max - height
    limits = max(float(-margins.min()), 0.0)
    if not math.isfinite(ends + limits):
        ends = limits = math.inf
    return xi, residual, jacobian, margins, -slope, ends, limits


def _hessian(
    n: Numbers, xi: Array, jacobian: Array, duals: Array, torques: Array, steps: int
) -> Array:
    _, _, basis = np.linalg.svd(jacobian)
    across, along = basis[:4], basis[4:]
    hessian: Array = 2e-2 * (across.T @ across)
    if not len(along):
        return hessian
    w0, arcs = n.w0, xi.size
    weights = duals * np.array([1.0, 1.0, 1.0 / w0, 1.0 / w0]) / w0
    change = np.empty((len(along), arcs))
    nodes = arcs * steps + 1
    states, slopes = np.empty((nodes, 4)), np.empty((nodes, 4, arcs))
    for row, direction in enumerate(along):
        moved = (xi + 1e-5 * direction) / w0
        roll_arcs(n.k, n.start, moved, torques, steps, states, slopes, True)
        change[row] = weights @ slopes[-1]
    change = (change - jacobian.T @ duals) / 1e-5
    reduced = change @ along.T
    values, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
    directions = along.T @ vectors
    hessian += (directions * np.maximum(np.abs(values), 2e-2)) @ directions.T
    return hessian


def _sqp(
    n: Numbers, first: Values, torques: Array, turns: int, steps: int, rho: float, cutoff: float
) -> Values:
    """Trust-region SQP with elastic constraints, in one loop."""
    point = _evaluate(n, np.maximum(first[0], 0.0), torques, turns, steps)
    size = point[0].size
    rho_ends = rho_limits = rho
    radius, stalled, duals, linear = 0.5, 0, None, None
    for iteration in range(1, 26):
        xi, residual, jacobian, margins, margins_jacobian, v_ends, v_limits = point
        if linear is None:
            near = np.flatnonzero((margins < 0.3) & (xi > 0))
            if duals is None:
                varied = xi > 1e-7
                duals = np.linalg.lstsq(
                    jacobian[:, varied].T, -np.ones(int(varied.sum())), rcond=1e-6
                )[0]
            linear = near, _hessian(n, xi, jacobian, duals, torques, steps)
        near, hessian = linear
        # Variables: step, slack of the ends, slack of the limits.
        matrix = np.zeros((size + 2, size + 2))
        matrix[:size, :size] = hessian
        matrix[size, size] = matrix[size + 1, size + 1] = 1e-4
        gradient = np.ones(size + 2)
        gradient[size:] = rho_ends, rho_limits
        count = 8 + near.size
        rows = np.zeros((count, size + 2))
        rows[:4, :size], rows[4:8, :size] = jacobian, -jacobian
        rows[:8, size] = rows[8:, size + 1] = 1.0
        rows[8:, :size] = margins_jacobian[near]
        lower = np.zeros(size + 2 + count)
        lower[:size] = np.maximum(-radius, -xi)
        variables = size + 2
        lower[variables:] = np.concatenate([-residual, residual, -margins[near]])
        upper = np.full(size + 2 + count, 1e30)
        upper[:size], upper[size:variables] = radius, 1e12
        solution, _, flag, info = daqp.solve(
            matrix, gradient, rows, upper, lower, np.zeros(lower.size, dtype=np.int32)
        )
        v_now = rho_ends * v_ends + rho_limits * v_limits
        feasible = v_ends <= _TIGHT and v_limits <= _TIGHT
        shrink = None
        if flag < 1:
            shrink = radius
        else:
            change, slacks = solution[:size], np.maximum(solution[size:], 0.0)
            model = change.sum() + 0.5 * change @ hessian @ change
            model += rho_ends * slacks[0] + rho_limits * slacks[1]
            predicted = v_now - model
            multipliers = np.abs(info['lam'][variables:])
            if predicted < 1e-4 * max(xi.sum(), 1e-6):
                if feasible:
                    break
                stalled += 1
                if stalled >= 2 and max(rho_ends, rho_limits) < 200.0:
                    rho_ends *= 5.0 if v_ends > _TIGHT else 1.0
                    rho_limits *= 5.0 if v_limits > _TIGHT else 1.0
                    radius, stalled = max(radius, 0.25), 0
                    continue
            else:
                stalled = 0
            trial = _evaluate(n, np.maximum(xi + change, 0.0), torques, turns, steps)
            if slacks.max() < 1e-4:
                active = near[multipliers[8:] > 1e-9]
                inverse = None
                for _ in range(4):
                    worst = max(trial[5], trial[6])
                    if not 1e-9 < worst < 2.0:
                        break
                    wrong = np.concatenate([trial[1], np.minimum(trial[3][active], 0.0)])
                    if inverse is None:
                        free = trial[0] > 1e-9
                        both = np.concatenate([jacobian, margins_jacobian[active]])
                        inverse = np.linalg.pinv(both[:, free], rcond=1e-4)
                    back = np.zeros(size)
                    back[free] = inverse @ wrong
                    if np.abs(back).max() > 2.0 * radius:
                        break
                    better = _evaluate(n, np.maximum(trial[0] - back, 0.0), torques, turns, steps)
                    if not max(better[5], better[6]) < 0.8 * worst:
                        break
                    trial = better
            gained = xi.sum() + v_now - trial[0].sum()
            gained -= rho_ends * trial[5] + rho_limits * trial[6]
            length = float(np.abs(change).max())
            ratio = gained / max(predicted, 1e-12) if math.isfinite(gained) else -math.inf
            if not (ratio > 0.05 or (predicted < 1e-7 and gained > -1e-9)):
                shrink = length
            else:
                point, duals, linear = trial, multipliers[4:8] - multipliers[:4], None
                if ratio > 0.75 and length > 0.9 * radius:
                    radius = min(2.0 * radius, 4.0)
                elif ratio < 0.25:
                    radius *= 0.5
                total, wrong_by = trial[0].sum(), max(trial[5], trial[6])
                if iteration >= 5 and total > cutoff and wrong_by < 1e-3:
                    break
        if shrink is not None:
            radius = 0.35 * min(radius, shrink)
            if radius < 1e-6:
                if feasible or max(rho_ends, rho_limits) >= 200.0:
                    break
                rho_ends *= 5.0 if v_ends > _TIGHT else 1.0
                rho_limits *= 5.0 if v_limits > _TIGHT else 1.0
                radius, linear = 0.25, None
    return point
