# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Where the search for switching times starts from: random arcs, a few swings, earlier plans.

Torques alternate between their extremes from arc to arc; either sign may come first.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.pendulum_steering import ArcBatch
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

FEWEST_ARCS = 4  # as many unknowns as end conditions
_MOST_RANDOM_ARCS = 8  # longer random sequences hardly ever arrive
_WEAKEST = 0.1  # smallest share of the torque tried
_FINAL_ARCS = 4  # of a pumping sequence: they bring the pendulum to rest upright


class Arcs(NamedTuple):
    """Durations (K,) [s] of arcs of constant torque, and their torques (K,) [N m]."""

    durations: Array
    torques: Array


def starts(
    task: SwingUpTask, rng: np.random.Generator, count: int, most: int, weaken: bool = False
) -> ArcBatch:
    """
    Return `count` sequences of up to `most` arcs; half of them pump where torque is weak.

    With `weaken` half of them take a random share of the torque: within a narrow disk angle strong
    arcs leave no room.
    """
    most = min(most, _MOST_RANDOM_ARCS)
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
    arcs = FEWEST_ARCS + np.arange(count) % (most - FEWEST_ARCS + 1)
    shares = rng.gamma(2.0, size=(count, most)) * (np.arange(most) < arcs[:, None])
    totals = np.exp(rng.uniform(math.log(shortest), math.log(longest), size=count))
    return shares * (totals / shares.sum(axis=1))[:, None], arcs


def pumping_durations(
    task: SwingUpTask, rng: np.random.Generator, count: int, most: int
) -> tuple[Array, Integers]:
    """Half swings that grow slower as they grow larger, then a few random arcs to the top."""
    arcs = rng.integers(min(FEWEST_ARCS + 1, most), most + 1, size=count)
    index = np.arange(most)
    swing = math.pi / task.plant.natural_frequency * rng.uniform(0.5, 1.3, size=(count, 1))
    growth = rng.uniform(-0.05, 0.15, size=(count, 1)) * index
    durations = swing * np.exp(growth + 0.2 * rng.normal(size=(count, most)))
    durations[:, 0] *= rng.uniform(0.3, 1.0, size=count)
    left = arcs[:, None] - index
    final = 0.25 * swing * rng.gamma(2.0, size=(count, most))
    return np.where(left > _FINAL_ARCS, durations, np.where(left > 0, final, 0.0)), arcs


def arcs_of(motion: Trajectory) -> Arcs | None:
    """
    Return the arcs of constant torque of a motion, read from its controls; None if it has none.

    The rest of a plan that is under way begins in the middle of an arc.
    """
    if motion.interpolation != 'zero_order_hold' or motion.control_names != ('torque',):
        return None
    torques = motion.controls[:-1, 0]
    edges = np.flatnonzero(np.diff(torques) != 0.0) + 1
    firsts = np.concatenate([[0], edges])
    if not torques[firsts].all():
        return None
    instants = motion.times[np.concatenate([firsts, [motion.times.size - 1]])]
    return Arcs(np.diff(instants), torques[firsts])
