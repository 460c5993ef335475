# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Where the search for switching times starts from: random arcs, swings that pump, earlier plans.

Torques alternate between their extremes from arc to arc; either sign may come first.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tdm_planner.plants.pendulum_rollout import ArcBatch
from tdm_planner.problems.base import Solution
from tdm_planner.problems.swing_up_task import SwingUpTask

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

FEWEST_ARCS = 4  # as many unknowns as end conditions
_MOST_RANDOM_ARCS = 8  # longer random sequences hardly ever arrive
_WEAKEST = 0.1  # smallest share of the torque tried
_FINAL_ARCS = 4  # of a pumping sequence: they bring the pendulum to rest upright


def starts(
    task: SwingUpTask, rng: np.random.Generator, count: int, most: int, weaken: bool = False
) -> ArcBatch:
    """Return `count` sequences of up to `most` arcs; half of them pump where torque is weak.

    With `weaken` half of them take a random share of the torque: within a narrow disk angle strong
    arcs leave no room.
    """
    durations, arcs = random_durations(task, rng, count, most)
    if task.drive < 1.0:
        pumped = slice(0, count, 2)
        durations[pumped], arcs[pumped] = pumping_durations(task, rng, arcs[pumped].size, most)
    first = np.where(rng.uniform(size=count) < 0.5, 1.0, -1.0)
    if weaken:
        share = np.exp(rng.uniform(math.log(_WEAKEST), 0.0, size=count))
        first *= np.where(rng.uniform(size=count) < 0.5, share, 1.0)
    torques = task.torque * first[:, None] * (-1.0) ** np.arange(most)
    turns = np.full(count, math.nan if task.turns is None else float(task.turns))
    return ArcBatch(durations, arcs, torques, turns, np.full(count, np.inf))


def random_durations(
    task: SwingUpTask, rng: np.random.Generator, count: int, most: int
) -> tuple[Array, Integers]:
    """Durations (count, most) [s], numbers of arcs: log-uniform totals split by Dirichlet(2)."""
    w0 = task.plant.natural_frequency
    quickest = max(task.quickest, 1e-3 / w0)
    shortest, longest = min(1.6 / w0, 1.5 * quickest), max(16 / w0, 8 * quickest)
    arcs = FEWEST_ARCS + np.arange(count) % (min(most, _MOST_RANDOM_ARCS) - FEWEST_ARCS + 1)
    shares = rng.gamma(2.0, size=(count, most)) * (np.arange(most) < arcs[:, None])
    totals = np.exp(rng.uniform(math.log(shortest), math.log(longest), size=count))
    return shares * (totals / shares.sum(axis=1))[:, None], arcs


def pumping_durations(
    task: SwingUpTask, rng: np.random.Generator, count: int, most: int
) -> tuple[Array, Integers]:
    """Half swings that grow slower as they grow larger, then a few random arcs to the top."""
    arcs = rng.integers(FEWEST_ARCS + 1, most + 1, size=count)
    index = np.arange(most)
    swing = math.pi / task.plant.natural_frequency * rng.uniform(0.5, 1.3, size=(count, 1))
    growth = rng.uniform(-0.05, 0.15, size=(count, 1)) * index
    durations = swing * np.exp(growth + 0.2 * rng.normal(size=(count, most)))
    durations[:, 0] *= rng.uniform(0.3, 1.0, size=count)
    left = arcs[:, None] - index
    final = 0.25 * swing * rng.gamma(2.0, size=(count, most))
    return np.where(left > _FINAL_ARCS, durations, np.where(left > 0, final, 0.0)), arcs


def previous_arcs(solution: Solution | None) -> tuple[Array, float] | None:
    """Return durations (K,) and the sign of the first arc of a plan; None if it has no arcs."""
    if solution is None or not (solution.parameters > 0).any():
        return None
    motion = solution.trajectory
    if motion.interpolation != 'zero_order_hold' or motion.control_names != ('torque',):
        return None
    lasting = int(np.argmax(solution.parameters > 0))
    return solution.parameters, float(np.sign(motion.controls[0, 0])) * (-1.0) ** lasting


def with_arcs(
    task: SwingUpTask, batch: ArcBatch, previous: tuple[Array, float] | None
) -> ArcBatch:
    """Put the arcs of an earlier plan in the place of the first start."""
    if previous is None or previous[0].size > batch.durations.shape[1]:
        return batch
    durations, sign = previous
    batch.arcs[0] = durations.size
    batch.durations[0] = 0.0
    batch.durations[0, : durations.size] = durations
    batch.torques[0] = sign * task.torque * (-1.0) ** np.arange(batch.torques.shape[1])
    return batch
