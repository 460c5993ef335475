# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Arcs of constant torque varied until the rotary pendulum ends upright at rest.

A projected Levenberg-Marquardt method for every start on its own, `LANES` of them at a time: as
soon as one is done with, the next takes its place.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.arrays import Array, Integers
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.plants.compilation import compiled, sum_in_threads
from tdm_planner.plants.pendulum_kernels import (
    LANES,
    PSI,
    PSI_DOT,
    roll_ends,
    roll_lanes,
    STATE,
    THETA_DOT,
)
from tdm_planner.plants.rotary_pendulum import Coefficients
from tdm_planner.problems.pendulum.task import SwingUpTask

# Sum of squares at which a start has arrived, and the effort spent on one.
ARRIVED = 1e-12
_TARGET = 1e-20
_FLOOR = 1e-3  # of w0^2: least square of a duration's scale
_CHUNK = 50  # starts between two looks at the clock, with the usual steps
EARLY, LATE = 9, 16  # iterations after which `Effort` looks at the sum of squares
TRIES = 6  # ever more damped steps tried from one point


class Steps(NamedTuple):
    """RK4 steps: at most `share` of `quick_time` each, and at least `fewest` in an arc."""

    fewest: int
    share: float = math.inf


class Effort(NamedTuple):
    """
    What is spent on a start: `iterations`, none of which changes an arc by more than `reach` / w0.

    Starts whose sum of squares is still larger than `early_cost` after 9 iterations, or than
    `late_cost` after 16, hardly ever arrive and are dropped.
    """

    iterations: int = 25
    early_cost: float = 0.3
    late_cost: float = 1e-2
    reach: float = math.inf


class ArcBatch(NamedTuple):
    """Many sequences of `arcs` (B,) arcs: `durations` [s], `torques` [N m] (B, K), else zero."""

    durations: Array
    torques: Array
    arcs: Integers

    @classmethod
    def of(cls, sequences: list[tuple[Array, Array]]) -> ArcBatch:
        """Return durations and torques (n,) of sequences, one below the other."""
        arcs = np.array([durations.size for durations, _ in sequences], dtype=np.intp)
        both = np.zeros((2, arcs.size, int(arcs.max(initial=0))))
        for row, n in enumerate(arcs.tolist()):
            both[0, row, :n], both[1, row, :n] = sequences[row]
        return cls(both[0], both[1], arcs)

    def rows(self, chosen: slice | Integers) -> ArcBatch:
        """Return some of the sequences: of a slice views, of indices copies."""
        rows: list[Any] = [each[chosen] for each in self]
        return ArcBatch(*rows)


@compiled
def _residual(
    lane: int, state: Array, peaks: Array, turn: float, psi_max: float, w0: float, residual: Array
) -> float:
    """
    Distance from upright at rest and every arc's excess of |psi|; the sum of their squares.

    `turn` is the goal's number of turns, NaN for the nearest; `residual` has 4 + K elements.
    """
    theta = state[lane]
    if math.isnan(turn):
        turn = math.floor(theta / (2.0 * math.pi) + 0.5)
    residual[0], residual[1] = theta - 2.0 * math.pi * turn, state[PSI + lane]
    residual[2], residual[3] = state[THETA_DOT + lane] / w0, state[PSI_DOT + lane] / w0
    total = 0.0
    for m in range(residual.size):
        if m >= 4:
            residual[m] = max(abs(peaks[m - 4, lane]) - psi_max, 0.0)
        total += residual[m] * residual[m]
    return total


@compiled
def _linearise(
    lane: int,
    arcs: int,
    derivatives: Array,
    peaks: Array,
    peak_slopes: Array,
    durations: Array,
    w0: float,
    residual: Array,
    jacobian: Array,
    wrong: Array,
    gram: Array,
    scale: Array,
) -> int:
    """
    Fill the Jacobian of one lane, a row an arc; the number of its columns.

    Those are the four ends and the arcs that are beyond the limit, `wrong` their residuals, `gram`
    (its lower half) their products. `scale` is zero for arcs of no duration that would shrink.
    """
    count = 0
    for m in range(4 + arcs):
        if m >= 4 and not residual[m] > 0.0:
            continue
        if m < 4:
            unit = 1.0 if m < 2 else 1.0 / w0
            for p in range(arcs):
                jacobian[p, count] = unit * derivatives[p, m * LANES + lane]
        else:
            sign = 1.0 if peaks[m - 4, lane] > 0.0 else -1.0
            for p in range(arcs):  # later arcs do not matter to this one
                jacobian[p, count] = sign * peak_slopes[m - 4, p, lane] if p <= m - 4 else 0.0
        wrong[count], gram[count, : count + 1] = residual[m], 0.0
        count += 1
    for p in range(arcs):
        size, gradient, row = _FLOOR * w0 * w0, 0.0, jacobian[p]
        for m in range(count):
            size += row[m] * row[m]
            gradient += row[m] * wrong[m]
        scale[p] = 0.0 if durations[p] <= 0.0 and gradient > 0.0 else 1.0 / math.sqrt(size)
        for m in range(count):
            row[m] *= scale[p]
            for n in range(m + 1):
                gram[m, n] += row[m] * row[n]
    return count


@compiled
def _solve_damped(
    count: int, gram: Array, wrong: Array, damping: float, factor: Array, duals: Array
) -> bool:
    """Fill the duals, (gram + damping)^-1 wrong, by Cholesky; False where that breaks down."""
    for i in range(count):
        for j in range(i + 1):
            total = gram[i, j] + (damping if i == j else 0.0)
            for m in range(j):
                total -= factor[i, m] * factor[j, m]
            if i == j:
                if not total > 0.0:
                    return False
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
        total = wrong[i]
        for m in range(i):
            total -= factor[i, m] * duals[m]
        duals[i] = total / factor[i, i]
    for i in range(count - 1, -1, -1):
        total = duals[i]
        for m in range(i + 1, count):
            total -= factor[m, i] * duals[m]
        duals[i] = total / factor[i, i]
    return True


@compiled
def _propose(
    count: int,
    jacobian: Array,
    wrong: Array,
    gram: Array,
    scale: Array,
    durations: Array,
    longest: float,
    damping: float,
    rejected: int,
    trial: Array,
) -> tuple[float, int]:
    """
    Fill `trial` (K,); return the damping used and the number of steps rejected so far.

    The step is scale z, z = -jacobian' (gram + damping)^-1 wrong: there are few rows.
    """
    factor, duals, step = np.empty((count, count)), np.empty(count), np.empty(trial.size)
    while rejected < TRIES:
        if _solve_damped(count, gram, wrong, damping, factor, duals):
            for p in range(trial.size):
                step[p] = 0.0
                for m in range(count):
                    step[p] -= jacobian[p, m] * duals[m]
                step[p] *= scale[p]
            size = np.abs(step).max()
            if size < 1e9:
                share = min(1.0, longest / size) if size > 0.0 else 1.0
                for p in range(trial.size):
                    trial[p] = max(durations[p] + share * step[p], 0.0)
                break
        rejected += 1
        damping *= 6.0
    return damping, rejected


@compiled
def shoot_arcs(
    k: Coefficients,
    starts: Array,
    batch: ArcBatch,
    costs: Array,
    turn: float,
    psi_max: float,
    w0: float,
    steps: Steps,
    effort: Effort,
) -> int:
    """
    Vary the durations of many motions from `starts` (B, 4) until each ends upright at rest.

    The durations change in place. Filled are the `costs` (B,), the sums of squares of
    (theta - 2 pi turn, psi, theta'/w0, psi'/w0, excess of |psi| over psi_max in every arc).
    Returns the number of integrations. What becomes of a start does not depend on the others.
    """
    durations, torques, arcs = batch
    most = durations.shape[1]
    state, derivatives = np.empty(STATE), np.empty((most, STATE))
    peaks, peak_slopes = np.empty((most, LANES)), np.empty((most, most, LANES))
    trials, held, begins = np.zeros((most, LANES)), np.zeros((most, LANES)), np.zeros(STATE)
    jacobian = np.empty((LANES, most, 4 + most))
    gram = np.empty((LANES, 4 + most, 4 + most))
    wrong, scale = np.empty((LANES, 4 + most)), np.empty((LANES, most))
    count, damping, longest = np.zeros(LANES, np.intp), np.empty(LANES), np.empty(LANES)
    accepted, rejected = np.zeros(LANES, np.intp), np.zeros(LANES, np.intp)
    residual, trial = np.empty(4 + most), np.empty(most)
    counts, mesh = np.full(most, steps.fewest), np.full(most * steps.fewest, 1.0 / steps.fewest)
    queue = np.argsort(arcs, kind='mergesort')  # so that lanes have similar numbers of arcs
    in_lane = np.full(LANES, -1, np.intp)
    taken, rollouts = 0, 0
    while True:
        busy, rolled = 0, 0
        for lane in range(LANES):
            if in_lane[lane] < 0 and taken < arcs.size:
                b = queue[taken]
                taken += 1
                in_lane[lane], costs[b] = b, np.inf
                damping[lane], accepted[lane], rejected[lane] = 1e-3, -1, 0
                longest[lane] = min(0.2 * durations[b].sum() + 0.2 / w0, effort.reach / w0)
                trials[:, lane], held[:, lane] = durations[b], torques[b]
                begins[lane::LANES] = starts[b]
            if in_lane[lane] >= 0:
                busy += 1
                rolled = max(rolled, arcs[in_lane[lane]])
        if busy == 0:
            return rollouts
        rollouts += busy
        state[:] = begins
        roll_lanes(
            k, trials, held, rolled, counts, mesh, steps.share, state, derivatives, peaks,
            peak_slopes,
        )  # fmt: skip
        for lane in range(LANES):
            b = in_lane[lane]
            if b < 0:
                continue
            n = arcs[b]
            cost = _residual(lane, state, peaks, turn, psi_max, w0, residual[: 4 + n])
            if cost < costs[b]:
                costs[b] = cost
                for p in range(n):
                    durations[b, p] = trials[p, lane]
                accepted[lane] += 1
                rejected[lane] = 0
                if accepted[lane] > 0:
                    damping[lane] = max(0.1 * damping[lane], 1e-9)
                count[lane] = _linearise(
                    lane, n, derivatives, peaks, peak_slopes, durations[b], w0, residual,
                    jacobian[lane], wrong[lane], gram[lane], scale[lane],
                )  # fmt: skip
            else:
                rejected[lane] += 1
                damping[lane] *= 6.0
            best, done = costs[b], accepted[lane]
            hopeless = (done >= EARLY and best > effort.early_cost) or (
                done >= LATE and best > effort.late_cost
            )
            enough = done >= effort.iterations - 1 or best < _TARGET
            if hopeless or enough or not best < 1e12:
                in_lane[lane] = -1
                continue
            damping[lane], rejected[lane] = _propose(
                count[lane], jacobian[lane], wrong[lane], gram[lane], scale[lane], durations[b],
                longest[lane], damping[lane], rejected[lane], trial[:n],
            )  # fmt: skip
            for p in range(n):
                trials[p, lane] = trial[p]
            if rejected[lane] >= TRIES:
                in_lane[lane] = -1


def shoot(
    task: SwingUpTask,
    starts: Array,
    batch: ArcBatch,
    steps: Steps,
    until: Budget,
    effort: Effort,
) -> Array:
    """
    Vary all durations, in place, until the motions from `starts` (B, 4) end upright at rest.

    Returns the sum of squares (B,) of what each is off by, infinite where the time was up. Chunks
    of sequences are shared out among threads on all cores, none after `until`. The result does not
    depend on the number of cores.
    """
    plant, costs = task.plant, np.full(batch.arcs.size, np.inf)
    size = max(LANES, min(round(_CHUNK / plant.quickness), batch.arcs.size // 2))
    turn = math.nan if task.turns is None else float(task.turns)
    scales = turn, task.planned_disk_angle, plant.natural_frequency

    def work(first: int) -> int:
        if until.spent:
            return 0
        rows = slice(first, first + size)
        some = starts[rows], batch.rows(rows), costs[rows]
        return shoot_arcs(plant.coefficients, *some, *scales, steps, effort)

    until.evaluations += sum_in_threads(work, range(0, batch.arcs.size, size))
    return costs


def roll_to_ends(
    task: SwingUpTask, batch: ArcBatch, share: float, limit: float
) -> tuple[Array, Array]:
    """Return the same as `roll_ends` from the start of a task, on all cores."""
    k, start, count = task.plant.coefficients, task.start, batch.arcs.size
    ends, peaks = np.empty((count, 4)), np.empty(count)

    def work(first: int) -> int:
        rows = slice(first, first + LANES)
        ends[rows], peaks[rows] = roll_ends(k, start, *batch.rows(rows), share, limit)
        return 0

    sum_in_threads(work, range(0, count, LANES))
    return ends, peaks
