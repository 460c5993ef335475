# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels of the rotary pendulum under arcs of constant torque.

`roll_arcs` integrates, `steer_arcs` varies the arcs' durations until the motion ends upright at
rest. They stand in one module because numba's cache on disk notices changes in this file only.
`coefficients` are those of `rotary_pendulum.Coefficients`, in order. States are
(theta, psi, theta', psi').
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled

Array = NDArray[np.float64]

# Starts whose sum of squares is still this large after so many iterations hardly ever arrive.
EARLY, EARLY_COST = 9, 0.3
LATE, LATE_COST = 16, 1e-2
TRIES = 6  # ever more damped steps tried from one point


@compiled
def _accelerate(
    k: Array,
    theta: float,
    theta_dot: float,
    psi_dot: float,
    torque: float,
    slopes: Array,
    stage: int,
    with_slopes: bool,
) -> tuple[float, float]:
    """Accelerations theta'', psi''; their slopes by theta, theta', psi' go to slopes[stage]."""
    sine, cosine = math.sin(theta), math.cos(theta)
    double_sine = 2.0 * sine * cosine
    b = k[5] * cosine
    j = k[2] + k[3] * sine * sine + k[4] * cosine * cosine
    inverse = 1.0 / (k[1] * j - b * b)
    r1 = 0.5 * k[0] * double_sine * psi_dot * psi_dot + k[6] * sine
    r2 = torque - k[0] * double_sine * theta_dot * psi_dot + k[5] * sine * theta_dot * theta_dot
    theta_ddot = (j * r1 - b * r2) * inverse
    psi_ddot = (k[1] * r2 - b * r1) * inverse
    if with_slopes:
        double_cosine = cosine * cosine - sine * sine
        b_theta = -k[5] * sine
        j_theta = (k[3] - k[4]) * double_sine
        d1 = k[0] * double_cosine * psi_dot * psi_dot + k[6] * cosine - b_theta * psi_ddot
        d2 = (
            (k[5] * cosine * theta_dot - 2.0 * k[0] * double_cosine * psi_dot) * theta_dot
            - b_theta * theta_ddot
            - j_theta * psi_ddot
        )
        slopes[stage, 0] = (j * d1 - b * d2) * inverse
        slopes[stage, 1] = (k[1] * d2 - b * d1) * inverse
        d2 = -k[0] * double_sine * psi_dot + 2.0 * k[5] * sine * theta_dot
        slopes[stage, 2] = -b * d2 * inverse
        slopes[stage, 3] = k[1] * d2 * inverse
        d1 = k[0] * double_sine * psi_dot
        d2 = -k[0] * double_sine * theta_dot
        slopes[stage, 4] = (j * d1 - b * d2) * inverse
        slopes[stage, 5] = (k[1] * d2 - b * d1) * inverse
    return theta_ddot, psi_ddot


@compiled
def roll_arcs(
    k: Array,
    start: Array,
    durations: Array,
    torques: Array,
    steps: int,
    states: Array,
    sensitivities: Array,
    with_sensitivities: bool,
) -> None:
    """Integrate by RK4, `steps` steps an arc; fill states (n, 4) and sensitivities (n, 4, K).

    n = K steps + 1. The sensitivities are the exact derivatives of the discrete states by the K
    durations.
    """
    arcs = durations.size
    rates, slopes = np.empty((4, 4)), np.empty((4, 6))
    dx = np.empty((4, 4))
    for m in range(4):
        states[0, m] = start[m]
    if with_sensitivities:
        sensitivities[0] = 0.0
    node = 0
    for arc in range(arcs):
        h, torque = durations[arc] / steps, torques[arc]
        for _ in range(steps):
            theta, theta_dot, psi_dot = states[node, 0], states[node, 2], states[node, 3]
            for s in range(4):
                reach = 0.0 if s == 0 else (0.5 * h if s < 3 else h)
                before = max(s - 1, 0)
                w, v = theta_dot, psi_dot
                angle = theta
                if s > 0:
                    angle += reach * rates[before, 0]
                    w += reach * rates[before, 2]
                    v += reach * rates[before, 3]
                rates[s, 0], rates[s, 1] = w, v
                rates[s, 2], rates[s, 3] = _accelerate(
                    k, angle, w, v, torque, slopes, s, with_sensitivities
                )
            for m in range(4):
                states[node + 1, m] = states[node, m] + h / 6.0 * (
                    rates[0, m] + 2.0 * rates[1, m] + 2.0 * rates[2, m] + rates[3, m]
                )
            if with_sensitivities:
                _roll_sensitivities(sensitivities, node, arc, arcs, h, steps, rates, slopes, dx)
            node += 1


@compiled
def _roll_sensitivities(
    sensitivities: Array,
    node: int,
    arc: int,
    arcs: int,
    h: float,
    steps: int,
    rates: Array,
    slopes: Array,
    dx: Array,
) -> None:
    """One RK4 step of the sensitivities; the present arc's duration stretches the step itself."""
    for p in range(arcs):
        if p > arc:
            for m in range(4):
                sensitivities[node + 1, m, p] = 0.0
            continue
        stretch = 1.0 / steps if p == arc else 0.0
        x0, x2, x3 = (
            sensitivities[node, 0, p],
            sensitivities[node, 2, p],
            sensitivities[node, 3, p],
        )
        for s in range(4):
            y0, y2, y3 = x0, x2, x3
            if s > 0:
                e = 0.5 if s < 3 else 1.0
                y0 += e * (h * dx[s - 1, 0] + stretch * rates[s - 1, 0])
                y2 += e * (h * dx[s - 1, 2] + stretch * rates[s - 1, 2])
                y3 += e * (h * dx[s - 1, 3] + stretch * rates[s - 1, 3])
            dx[s, 0], dx[s, 1] = y2, y3
            dx[s, 2] = slopes[s, 0] * y0 + slopes[s, 2] * y2 + slopes[s, 4] * y3
            dx[s, 3] = slopes[s, 1] * y0 + slopes[s, 3] * y2 + slopes[s, 5] * y3
        for m in range(4):
            sensitivities[node + 1, m, p] = (
                sensitivities[node, m, p]
                + h / 6.0 * (dx[0, m] + 2.0 * dx[1, m] + 2.0 * dx[2, m] + dx[3, m])
                + stretch
                / 6.0
                * (rates[0, m] + 2.0 * rates[1, m] + 2.0 * rates[2, m] + rates[3, m])
            )


@compiled
def _residual(
    states: Array,
    steps: int,
    turn: float,
    psi_max: float,
    w0: float,
    residual: Array,
    peaks: NDArray[np.intp],
) -> float:
    """Distance from upright at rest and every arc's excess of |psi|; the sum of their squares.

    `turn` is the goal's number of turns, NaN for the nearest; `peaks` (K,) receives the nodes of
    the arcs' largest |psi|, `residual` has 4 + K elements.
    """
    arcs = peaks.size
    last = arcs * steps
    if math.isnan(turn):
        turn = math.floor(states[last, 0] / (2.0 * math.pi) + 0.5)
    residual[0] = states[last, 0] - 2.0 * math.pi * turn
    residual[1] = states[last, 1]
    residual[2] = states[last, 2] / w0
    residual[3] = states[last, 3] / w0
    total = 0.0
    for m in range(4):
        total += residual[m] * residual[m]
    for arc in range(arcs):
        height = 0.0
        for node in range(arc * steps + 1, (arc + 1) * steps + 1):
            if abs(states[node, 1]) > height:
                height = abs(states[node, 1])
                peaks[arc] = node
        residual[4 + arc] = max(height - psi_max, 0.0)
        total += residual[4 + arc] * residual[4 + arc]
    return total


@compiled
def _normal_equations(
    states: Array,
    sensitivities: Array,
    w0: float,
    residual: Array,
    peaks: NDArray[np.intp],
    row: Array,
    normal: Array,
    gradient: Array,
) -> None:
    """Fill J'J (its lower half) and J'r from the sensitivities; `row` is a scratch array."""
    arcs = peaks.size
    last = states.shape[0] - 1
    normal[:, :] = 0.0
    gradient[:] = 0.0
    for m in range(residual.size):
        if m >= 4 and not residual[m] > 0.0:
            continue
        node, scale, component = last, 1.0, m
        if m >= 4:
            node, component = peaks[m - 4], 1
            scale = 1.0 if states[node, 1] > 0.0 else -1.0
        elif m >= 2:
            scale = 1.0 / w0
        for p in range(arcs):
            row[p] = scale * sensitivities[node, component, p]
            gradient[p] += row[p] * residual[m]
            for q in range(p + 1):
                normal[p, q] += row[p] * row[q]


@compiled
def _damped_step(
    normal: Array,
    gradient: Array,
    damping: float,
    floor: float,
    fixed: NDArray[np.bool_],
    factor: Array,
    step: Array,
) -> bool:
    """Solve (normal + damping diag) step = -gradient by Cholesky, `fixed` variables left out."""
    n = gradient.size
    for i in range(n):
        for j in range(i + 1):
            if fixed[i] or fixed[j]:
                total = 1.0 if i == j else 0.0
            else:
                total = normal[i, j]
                if i == j:
                    total += damping * (normal[i, i] + floor)
            for m in range(j):
                total -= factor[i, m] * factor[j, m]
            if i == j:
                if not total > 0.0:
                    return False
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(n):
        total = 0.0 if fixed[i] else -gradient[i]
        for m in range(i):
            total -= factor[i, m] * step[m]
        step[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = step[i]
        for m in range(i + 1, n):
            total -= factor[m, i] * step[m]
        step[i] = total / factor[i, i]
    return True


@compiled
def _steer_one(
    k: Array,
    start: Array,
    durations: Array,
    torques: Array,
    turn: float,
    psi_max: float,
    w0: float,
    steps: int,
    iterations: int,
    target: float,
) -> tuple[float, int]:
    """Projected Levenberg-Marquardt on one vector of durations, in place; see `steer_arcs`."""
    arcs = durations.size
    last = arcs * steps
    states, sensitivities = np.empty((last + 1, 4)), np.empty((last + 1, 4, arcs))
    trial_states, trial = np.empty((last + 1, 4)), np.empty(arcs)
    residual, peaks, row = np.empty(4 + arcs), np.ones(arcs, np.intp), np.empty(arcs)
    normal, factor = np.empty((arcs, arcs)), np.empty((arcs, arcs))
    gradient, step, fixed = np.empty(arcs), np.empty(arcs), np.zeros(arcs, np.bool_)
    longest = 0.2 * durations.sum() + 0.2 / w0
    floor = 1e-3 * w0 * w0
    damping, cost, rollouts = 1e-3, np.inf, 0
    for iteration in range(iterations):
        roll_arcs(k, start, durations, torques, steps, states, sensitivities, True)
        rollouts += 1
        cost = _residual(states, steps, turn, psi_max, w0, residual, peaks)
        if not cost < 1e12 or cost < target:
            break
        if (iteration >= EARLY and cost > EARLY_COST) or (iteration >= LATE and cost > LATE_COST):
            break
        _normal_equations(states, sensitivities, w0, residual, peaks, row, normal, gradient)
        for p in range(arcs):
            fixed[p] = durations[p] <= 0.0 and gradient[p] > 0.0
        accepted = False
        for _ in range(TRIES):
            if _damped_step(normal, gradient, damping, floor, fixed, factor, step):
                size = np.abs(step).max()
                if size < 1e9:
                    scale = min(1.0, longest / size) if size > 0.0 else 1.0
                    for p in range(arcs):
                        trial[p] = max(durations[p] + scale * step[p], 0.0)
                    roll_arcs(k, start, trial, torques, steps, trial_states, sensitivities, False)
                    rollouts += 1
                    accepted = (
                        _residual(trial_states, steps, turn, psi_max, w0, residual, peaks) < cost
                    )
                    if accepted:
                        break
            damping *= 6.0
        if not accepted:
            break
        damping = max(0.1 * damping, 1e-9)
        durations[:] = trial
    return cost, rollouts


@compiled
def steer_arcs(
    k: Array,
    start: Array,
    durations: Array,
    arcs: NDArray[np.intp],
    torques: Array,
    turns: Array,
    psi_max: float,
    w0: float,
    steps: int,
    iterations: int,
    target: float,
    costs: Array,
) -> int:
    """Vary the durations of many starts until each ends upright at rest within +-psi_max.

    Every row of `durations` (B, K) [s], of which the first `arcs` (B,) count, is changed in place
    under `torques` (B, K) [N m]; `turns` (B,) is the goal's number of turns, NaN for the nearest
    one. `costs` (B,) receives the sum of squares of (theta - 2 pi n, psi, theta'/w0, psi'/w0,
    excess of |psi| in every arc); below `target` a start has arrived. Returns the number of
    integrations.
    """
    rollouts = 0
    for b in range(durations.shape[0]):
        n = arcs[b]
        varied = durations[b, :n].copy()
        costs[b], count = _steer_one(
            k,
            start,
            varied,
            torques[b, :n].copy(),
            turns[b],
            psi_max,
            w0,
            steps,
            iterations,
            target,
        )
        durations[b, :n] = varied
        rollouts += count
    return rollouts
