# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Where the search for switching times starts from: random arcs, a law that pumps, earlier plans.

Torques of random sequences alternate between their extremes from arc to arc; either sign may come
first. The law of `pumping` brings the pendulum near the top: of many variants the
most promising are kept but for their last arcs, which shooting adjusts until they end upright.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.plants.pendulum_kernels import LANES
from tdm_planner.problems.pendulum.pumping import Laws, NEAR, pump, Pumping
from tdm_planner.problems.pendulum.shooting import ArcBatch
from tdm_planner.problems.pendulum.switching_search import (
    Candidate,
    COARSE_STEPS,
    FEWEST_ARCS,
    land,
)
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

_MOST_RANDOM_ARCS = 8  # longer random sequences hardly ever arrive
_WEAKEST = 0.1  # smallest share of the torque tried
_FINAL_ARCS = 4  # of a pumping sequence: they bring the pendulum to rest upright
Late = Callable[[], bool]

VARIANTS, _AT_ONCE = 128, 32  # simulated, and so many between two looks at the clock, or fewer
_MOST_VARIANTS = 12 * VARIANTS  # where hardly any comes near
# Of 1/w0, what a pump may take: times drive, but so much at least and at most.
_LONGEST_WORK, _LEAST_LONGEST, _MOST_LONGEST = 10.0, 400.0, 12000.0
_PUMPED = 0.3  # share of the time after which a lane each that came near will do
_MANY, _AT_LEISURE = 3, 0.2  # a lane that are gathered first, up to that share of the time
_LANDED, _ENOUGH = 48, 5  # variants, the most promising, that are landed; arrivals that do
_WEIGHT, _WORK = 8.0, 2.5  # of the root of the distance beside the time: at least; times drive
_PATIENCE, _RANK = 30.0, 6.0  # times that weight: at most, and where variants are compared
_TAIL, _TAIL_WORK = (14, 56), 1.8  # arcs varied to land: at least and at most; times drive
_EVALUATION = 1500.0  # steps, that take as long as to compute the dynamics along one candidate
_EXTRA, _SHORT = 2, 0.1  # arcs put at the end, of so many 1/w0
_POLISHED = 16  # last arcs whose time is minimised
_STEERED_ARCS = 56  # the last ones of an earlier plan, where there are more
_STEPS = 32  # RK4 steps an arc once a sequence has landed


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
    pieces = motion.smooth_pieces
    torques = motion.controls[pieces[:-1], 0]
    return Arcs(np.diff(motion.times[pieces]), torques) if torques.all() else None


def laws(task: SwingUpTask, rng: np.random.Generator, count: int) -> Laws:
    """Return variants of the law at random."""
    crossing = task.disk_acceleration / task.plant.natural_frequency**2 / task.disk_angle
    weakest = 0.3 / max(crossing, 2.0)
    weight = _times_drive(task, _WORK, _WEIGHT)

    def spread(least: float, most: float) -> Array:
        return np.exp(rng.uniform(math.log(least), math.log(most), count))

    def mostly(share: float, usual: float | Array, others: Array) -> Array:
        return np.where(rng.uniform(size=count) < share, usual, others)

    # The torque that takes half a swing to move the disk through its range, about.
    in_a_swing = np.minimum(spread(0.5, 1.5) / crossing, 1.0)
    lead = mostly(0.5, 0.0, rng.uniform(-0.4, 0.4, count))
    if crossing > 1.0:
        # It crosses its range in less than half a swing. A stroke from where a large swing turns
        # would be slow, as the pendulum is horizontal there, and end in the wrong half.
        lead = mostly(0.25, lead, rng.uniform(-3.0, -0.5, count))
    return Laws(
        first=np.where(np.arange(count) % 2, 1.0, -1.0),
        share=mostly(0.5, 1.0, mostly(0.3, spread(weakest, 1.0), in_a_swing)),
        on_place=spread(0.003, 0.6),
        on_momentum=spread(0.003, 1.0),
        band=spread(0.05, 1.0),
        brake=rng.uniform(0.6, 1.0, count),
        lead=lead,
        hold=mostly(0.25, 0.0, rng.uniform(0.2, 1.2, count)),
        weight=weight * spread(1.0, _PATIENCE),
    )


def pumped(
    task: SwingUpTask, rng: np.random.Generator, most: int, budget: Budget, until: float
) -> tuple[list[Candidate], int]:
    """
    Pump by many variants and land the most promising.

    Returns those that arrived, the quickest first, and how many variants were tried. A plan has at
    most `most` arcs; nothing new is begun after `until` s of the budget.
    """

    def late() -> bool:
        return budget.elapsed > until

    def enough(near: int) -> bool:
        return late() or near >= 4 * LANES or (near >= LANES and budget.elapsed > _PUMPED * until)

    def few(near: int) -> bool:
        return near < LANES or (near < _MANY * LANES and budget.elapsed < _AT_LEISURE * until)

    swings: list[Candidate] = []
    tried = 0
    while tried < _MOST_VARIANTS and not late() and few(len(swings)):
        tried += VARIANTS
        swings += _swings(task, laws(task, rng, VARIANTS), most, budget, enough)
    steps = min(task.steps(COARSE_STEPS), _STEPS)
    landed: list[Candidate] = []
    for first in range(0, len(swings), LANES):
        if late() or len(landed) >= _ENOUGH:
            break
        some = slice(first, first + LANES)
        landed += land(task, swings[some], steps, budget, late)
    return landed_finely(task, landed, budget, late), tried


def landed_finely(
    task: SwingUpTask, landed: list[Candidate], budget: Budget, late: Late
) -> list[Candidate]:
    """Shoot the last arcs of the quickest again, integrated more finely; those that arrive."""
    quickest = sorted(landed, key=lambda candidate: candidate.total)[:LANES]
    last, steps = list(map(_with_last_varied, quickest)), task.steps(_STEPS)
    found = land(task, last, steps, budget, late)
    return found or list(map(_with_last_varied, land(task, quickest, steps, budget, late)))


def _with_last_varied(candidate: Candidate) -> Candidate:
    return replace(candidate, fixed=max(candidate.fixed, candidate.durations.size - _POLISHED))


def _swings(
    task: SwingUpTask,
    variants: Laws,
    most: int,
    budget: Budget,
    enough: Callable[[int], bool],
) -> list[Candidate]:
    """
    Return the promising variants, the best first, with a tail to land by.

    No more are simulated once so many that came near are `enough`.
    """
    w0, room = task.plant.natural_frequency, max(most - _EXTRA, FEWEST_ARCS - _EXTRA)
    durations, torques = np.zeros((VARIANTS, room)), np.zeros((VARIANTS, room))
    arcs, distances = np.zeros(VARIANTS, np.intp), np.full(VARIANTS, np.inf)
    weight = _RANK * _times_drive(task, _WORK, _WEIGHT)
    turn = math.nan if task.turns is None else float(task.turns)
    longest = min(_times_drive(task, _LONGEST_WORK, _LEAST_LONGEST), _MOST_LONGEST)
    common = Pumping(task.torque, task.planned_disk_angle, w0, turn, longest)
    some = max(1, round(_AT_ONCE / task.plant.quickness))
    for first in range(0, VARIANTS, some):
        if enough(int(np.count_nonzero(distances < NEAR))):
            break
        rows = slice(first, first + some)
        steps = pump(
            task.plant.coefficients, task.start, common, Laws(*(each[rows] for each in variants)),
            durations[rows], torques[rows], arcs[rows], distances[rows],
        )  # fmt: skip
        budget.evaluations += math.ceil(steps / _EVALUATION)
    total = np.where(np.arange(room) < arcs[:, None], durations, 0.0).sum(axis=1)
    promise = np.where(distances < NEAR, w0 * total + weight * np.sqrt(distances), np.inf)
    best = np.argsort(promise)[:_LANDED]
    return [
        _with_tail(task, durations[i, : arcs[i]], torques[i, : arcs[i]])
        for i in best[np.isfinite(promise[best])]
    ]


def _with_tail(task: SwingUpTask, durations: Array, torques: Array) -> Candidate:
    """Return arcs that pump and a few more; all but the last ones are to stay as they are."""
    extra = max(_EXTRA, FEWEST_ARCS - durations.size)
    signs = -math.copysign(task.torque, torques[-1]) * (-1.0) ** np.arange(extra)
    tail = round(min(_times_drive(task, _TAIL_WORK, _TAIL[0]), _TAIL[1]))
    return Candidate(
        np.append(durations, np.full(extra, _SHORT / task.plant.natural_frequency)),
        np.append(torques, signs),
        0,
        max(durations.size + extra - tail, 0),
    )


def _times_drive(task: SwingUpTask, work: float, least: float) -> float:
    """Return what takes so much, times drive; as if the drive were at least 1e-6."""
    return max(work / max(task.swing_drive, 1e-6), least)


def warm_starts(
    task: SwingUpTask, rng: np.random.Generator, previous: Arcs, most: int, change: float
) -> list[Candidate]:
    """
    Return the arcs of an earlier plan, their durations changed at random.

    `change` is the standard deviation of the logarithms of the durations. An arc of no duration is
    put before or after them, or both, where a new switch may grow; there are at most `most`.
    """
    sizes, found = np.abs(previous.torques), list[Candidate]()
    held = np.clip(previous.torques, -task.torque, task.torque)
    if np.ptp(sizes) <= 1e-9 * sizes[0]:  # extreme torques, they may be others now
        held = np.copysign(task.torque, held)
    for before, after in ((0, 1), (0, 0), (1, 0), (1, 1)):
        after = max(after, FEWEST_ARCS + 1 - before - held.size)
        count = before + held.size + after
        if count > max(most, FEWEST_ARCS + 1):
            continue
        end = -math.copysign(task.torque, held[-1]) * (-1.0) ** np.arange(after)
        first = np.full(before, -math.copysign(task.torque, held[0]))
        durations = previous.durations * np.exp(change * rng.normal(size=held.size))
        found.append(
            Candidate(
                np.concatenate([np.zeros(before), durations, np.zeros(after)]),
                np.concatenate([first, held, end]),
                0,
                max(count - _STEERED_ARCS, 0),
            )
        )
    return found
