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
The kernels of `pendulum_kernels` and `pendulum_steering` in numpy, where there is no compiler.

The same discrete motions and derivatives, for a batch of starts in lock step: states are stepped
one after the other, the derivatives of all steps are then taken at once.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.pendulum_steering import EARLY, EARLY_COST, LATE, LATE_COST, TRIES
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

Array = NDArray[np.float64]

_STAGES = (0.0, 0.5, 0.5, 1.0)
_STRAGGLERS = 0.04  # share of the starts whose slow arrival is not waited for
_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0


def roll_batch(
    plant: RotaryPendulum, start: Array, durations: Array, torques: Array, steps: int
) -> tuple[Array, Array]:
    """
    Integrate by RK4 from `start` (4,) under arcs `durations`, `torques` (B, K).

    Returns states (B, K steps + 1, 4) and their derivatives by the durations, (.., 4, K).
    """
    h = np.repeat(durations / steps, steps, axis=1)
    held = np.repeat(torques, steps, axis=1)
    states, stages, rates = _step_states(plant, start, h, held)
    by_state, by_step = _step_derivatives(plant, h, held, stages, rates)
    batch, nodes = h.shape
    arcs = durations.shape[1]
    sensitivities = np.zeros((batch, nodes + 1, 4, arcs))
    for node in range(nodes):
        arc = node // steps
        following = sensitivities[:, node + 1]
        np.matmul(by_state[:, node], sensitivities[:, node], out=following)
        following[:, :, arc] += by_step[:, node] / steps
    return states, sensitivities


def _step_states(
    plant: RotaryPendulum, start: Array, steps: Array, held: Array
) -> tuple[Array, Array, Array]:
    """States (B, N+1, 4), stage states and stage rates (B, N, 4 stages, 4)."""
    batch, nodes = steps.shape
    one = batch == 1  # numbers are several times faster than arrays of one element
    sin, cos = (_sin, _cos) if one else (np.sin, np.cos)
    lengths: Any = steps[0].tolist() if one else steps.T
    torques: Any = held[0].tolist() if one else held.T
    x: Any = start.tolist() if one else np.broadcast_to(start, (batch, 4)).T
    theta, psi, w, v = x
    accelerations = plant.accelerations
    states: list[Any] = [(theta, psi, w, v)]
    stages: list[Any] = []
    rates: list[Any] = []
    for h, torque in zip(lengths, torques, strict=True):
        half, sixth = 0.5 * h, h / 6.0
        a1, b1 = accelerations(sin(theta), cos(theta), w, v, torque)
        theta2, w2, v2 = theta + half * w, w + half * a1, v + half * b1
        a2, b2 = accelerations(sin(theta2), cos(theta2), w2, v2, torque)
        theta3, w3, v3 = theta + half * w2, w + half * a2, v + half * b2
        a3, b3 = accelerations(sin(theta3), cos(theta3), w3, v3, torque)
        theta4, w4, v4 = theta + h * w3, w + h * a3, v + h * b3
        a4, b4 = accelerations(sin(theta4), cos(theta4), w4, v4, torque)
        stages += [(theta, psi, w, v), (theta2, psi + half * v, w2, v2)]
        stages += [(theta3, psi + half * v2, w3, v3), (theta4, psi + h * v3, w4, v4)]
        rates += [(w, v, a1, b1), (w2, v2, a2, b2), (w3, v3, a3, b3), (w4, v4, a4, b4)]
        theta = theta + sixth * (w + 2 * (w2 + w3) + w4)
        psi = psi + sixth * (v + 2 * (v2 + v3) + v4)
        w = w + sixth * (a1 + 2 * (a2 + a3) + a4)
        v = v + sixth * (b1 + 2 * (b2 + b3) + b4)
        states.append((theta, psi, w, v))
    shape = (nodes, 4, 4, batch)
    return (
        np.moveaxis(np.reshape(states, (nodes + 1, 4, batch)), 2, 0),
        np.moveaxis(np.reshape(stages, shape), 3, 0),
        np.moveaxis(np.reshape(rates, shape), 3, 0),
    )


def _sin(angle: float) -> float:
    return math.sin(angle) if math.isfinite(angle) else math.nan


def _cos(angle: float) -> float:
    return math.cos(angle) if math.isfinite(angle) else math.nan


def _step_derivatives(
    plant: RotaryPendulum, h: Array, held: Array, stages: Array, rates: Array
) -> tuple[Array, Array]:
    """Return every step's derivatives by initial state (B, N, 4, 4) and by length (B, N, 4)."""
    jacobian, _ = plant.jacobians(stages, held[:, :, None, None])
    length = h[..., None, None]
    by_state = np.broadcast_to(np.eye(4), jacobian[:, :, 0].shape)
    by_step = np.einsum('s,bnsi->bni', _WEIGHTS, rates)
    slope = np.zeros_like(by_state)
    slope_step = np.zeros_like(by_step)
    total = by_state
    for s, reach in enumerate(_STAGES):
        before = rates[:, :, s - 1] if s else 0.0 * by_step
        inner = reach * (before + h[..., None] * slope_step)
        slope_step = np.einsum('bnij,bnj->bni', jacobian[:, :, s], inner)
        slope = jacobian[:, :, s] @ (by_state + reach * length * slope)
        total = total + _WEIGHTS[s] * length * slope
        by_step = by_step + _WEIGHTS[s] * h[..., None] * slope_step
    return total, by_step


def steer_batch(
    plant: RotaryPendulum,
    start: Array,
    durations: Array,
    arcs: NDArray[np.intp],
    torques: Array,
    turns: Array,
    psi_max: float,
    steps: int,
    iterations: int,
    target: float,
    stop: Callable[[], bool],
) -> tuple[Array, int]:
    """
    Levenberg-Marquardt as `pendulum_steering.steer_arcs`; `durations` (B, K) change in place.

    Returns the costs (B,) and the number of integrations. `stop` ends it early.
    """
    w0 = plant.natural_frequency
    batch, most = durations.shape
    varied: NDArray[np.bool_] = np.arange(most)[None, :] < arcs[:, None]
    longest = 0.2 * durations.sum(axis=1) + 0.2 / w0
    damping, costs = np.full(batch, 1e-3), np.full(batch, np.inf)
    accepted, refused = np.zeros(batch, dtype=int), np.zeros(batch, dtype=int)
    live = np.arange(batch)
    with np.errstate(all='ignore'):
        residual, jacobian = _residuals(plant, start, durations, torques, turns, psi_max, steps)
        costs = _squares(residual)
        rollouts = batch
        while True:
            live = live[_promising(costs[live], accepted[live], refused[live], iterations, target)]
            if live.size <= _STRAGGLERS * batch or stop():
                break
            change = _damped_steps(
                residual[live], jacobian[live], durations[live], varied[live], damping[live], w0
            )
            size = np.abs(change).max(axis=1)
            change *= np.minimum(1.0, longest[live] / np.maximum(size, 1e-300))[:, None]
            trial = np.where(varied[live], np.maximum(durations[live] + change, 0.0), 0.0)
            new_residual, new_jacobian = _residuals(
                plant, start, trial, torques[live], turns[live], psi_max, steps
            )
            rollouts += live.size
            cost = _squares(new_residual)
            better = cost < costs[live]
            good, bad = live[better], live[~better]
            durations[good], costs[good] = trial[better], cost[better]
            residual[good], jacobian[good] = new_residual[better], new_jacobian[better]
            damping[good] = np.maximum(0.1 * damping[good], 1e-9)
            damping[bad] *= 6.0
            accepted[good] += 1
            refused[good] = 0
            refused[bad] += 1
    return costs, rollouts


def _promising(
    costs: Array,
    accepted: NDArray[np.intp],
    refused: NDArray[np.intp],
    iterations: int,
    target: float,
) -> NDArray[np.bool_]:
    """Which starts are worth another step, by the same rules as the compiled kernel."""
    worth = (costs >= target) & (costs < 1e12) & (refused < TRIES) & (accepted < iterations - 1)
    worth &= (accepted < EARLY) | (costs <= EARLY_COST)
    worth &= (accepted < LATE) | (costs <= LATE_COST)
    return worth


def _squares(residual: Array) -> Array:
    total = np.einsum('bi,bi->b', residual, residual)
    return np.where(np.isfinite(total), total, np.inf)


def _residuals(
    plant: RotaryPendulum,
    start: Array,
    durations: Array,
    torques: Array,
    turns: Array,
    psi_max: float,
    steps: int,
) -> tuple[Array, Array]:
    """Distance from upright at rest, excess of |psi| in the arcs: (B, 4 + K), (B, 4 + K, K)."""
    w0 = plant.natural_frequency
    states, sensitivities = roll_batch(plant, start, durations, torques, steps)
    scale = np.array([1.0, 1.0, 1.0 / w0, 1.0 / w0])
    nearest = np.round(states[:, -1, 0] / (2 * np.pi))
    turn = np.where(np.isnan(turns), nearest, turns)
    residual = np.zeros((len(states), 4 + durations.shape[1]))
    residual[:, :4] = states[:, -1] * scale
    residual[:, 0] -= 2 * np.pi * turn
    # Every arc's largest |psi|, its first node left to the arc before.
    batch, arcs = durations.shape
    rows = np.arange(batch)[:, None]
    heights = np.abs(states[:, 1:, 1]).reshape(batch, arcs, steps)
    peaks = 1 + steps * np.arange(arcs) + heights.argmax(axis=2)
    psi = states[rows, peaks, 1]
    residual[:, 4:] = np.maximum(np.abs(psi) - psi_max, 0.0)
    jacobian = np.zeros((batch, 4 + arcs, arcs))
    jacobian[:, :4] = sensitivities[:, -1] * scale[:, None]
    excess = np.where(residual[:, 4:] > 0, np.sign(psi), 0.0)
    jacobian[:, 4:] = excess[:, :, None] * sensitivities[rows, peaks, 1]
    return residual, jacobian


def _damped_steps(
    residual: Array,
    jacobian: Array,
    durations: Array,
    varied: NDArray[np.bool_],
    damping: Array,
    w0: float,
) -> Array:
    """Projected, damped Gauss-Newton steps (B, K); zero where the system is singular."""
    gradient = np.einsum('bmk,bm->bk', jacobian, residual)
    free = varied & ~((durations <= 0) & (gradient > 0))
    usable = np.isfinite(np.abs(jacobian).sum(axis=(1, 2)))
    free &= usable[:, None]
    masked = np.where(free[:, None], jacobian, 0.0)
    normal = np.einsum('bmk,bml->bkl', masked, masked)
    diagonal = np.einsum('bkk->bk', normal)
    ridge = np.where(free, damping[:, None] * (diagonal + 1e-3 * w0**2), 1.0)
    normal += ridge[:, :, None] * np.eye(normal.shape[1])
    right = np.where(free, -gradient, 0.0)
    try:
        steps: Array = np.linalg.solve(normal, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.zeros_like(right)
    return np.where(np.isfinite(steps), steps, 0.0)
