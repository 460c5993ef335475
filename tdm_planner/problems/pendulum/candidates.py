# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Candidates of the search for switching times, and what happens to them in turn.

1. Initial guesses: `starts` at random, `warm_starts` from an earlier plan, or
   `pumping.pumped_candidates`.
2. `shoot_upright` varies their arcs, but for first ones that stay as they are, until they arrive.
3. `polish` minimises the time, `with_new_arcs` adds arcs, `corrected` integrates more finely.
4. `trajectory` writes the motion out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from tdm_planner.arrays import Array, Integers
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.plants.pendulum_kernels import LANES
from tdm_planner.plants.pendulum_replay import roll_states
from tdm_planner.problems.pendulum.shooting import (
    ArcBatch,
    ARRIVED,
    Effort,
    roll_to_ends,
    shoot,
    Steps,
)
from tdm_planner.problems.pendulum.switching_program import (
    evaluate_arcs,
    lagrangian_slopes,
    mesh_of_arcs,
    SwitchingData,
    SwitchingProgram,
)
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.trajectory import NANOSECOND, to_nanoseconds, Trajectory

FEWEST_ARCS = 4  # as many unknowns as end conditions
COARSE_STEPS = 12  # RK4 steps an arc while searching,
FINE_STEPS = 96  # and for the final polish
TAIL_STEPS = Steps(12, 1.0 / 4.0)
_FIXED_STEP = 1.0 / 24.0  # share of `quick_time` for arcs that stay as they are: thousands, maybe
_QUICK = 2.5  # a step is no longer than that share of `quick_time`, divided by the steps an arc
_MOST_RANDOM_ARCS = 8  # longer random sequences hardly ever arrive
_MOST_VARIED_ARCS = 56  # the last ones of an earlier plan, where there are more
_AT_LIMIT = 0.98  # of the disk's limit, from which on a motion is at it
_INSIDE = 0.995  # of the disk's limit, as it is looked at after every part only
# Rounds of shooting: the effort, and the sum of squares from which on a candidate is dropped then.
_TAIL_EFFORT = Effort(iterations=12, early_cost=math.inf, late_cost=math.inf, reach=0.5)
_TAIL_ROUNDS = tuple((_TAIL_EFFORT, most) for most in (1.5, 0.3, 0.3, 1e-2, 1e-2, 0.0))
ONE_ROUND = ((Effort(), 0.0),)
_POLISHED = 16  # last arcs whose time is minimised
_PENALTIES = (30.0, 1000.0)  # on violations; the second where the first is too small,
_STIFF_DRIVE = 0.25  # as it always is below that drive
_CORRECTIONS = 16  # steps that bring a polished candidate to its end again
_WORSE = 2.0  # times the violation before it, from which on a step is halved
_PARTS = 4  # of an arc, before each of which an empty arc is tried
_MOST_NEW = 2  # arcs at a time: they change the multipliers
_PAYS = -0.1  # derivative of the Lagrangian below which an arc is begun
_STATIONARY, _EMPTY = 0.1, 1e-7  # largest derivative by arcs at a minimum; w0 d of an empty one
_DISTINCT = 2e-3  # relative difference of the total times of two different candidates
_SHORTEST_ARC = 1e-5  # of 1/w0; shorter arcs are omitted
_SAMPLE_TIME = 5e-3  # [s]
_MOST_SAMPLES = 4000  # of a trajectory, where the rig is so slow that they do
_FINE_SHARES, _FINE_SAMPLES = (0.05, 0.15), 30_000  # of the time scale; the first up to so many


@dataclass(frozen=True, eq=False)
class Candidate:
    """
    Durations (K,) [s] of arcs of torque (K,) [N m] that end at theta = 2 pi `turns`.

    The first `fixed` of them stay as they are.
    """

    durations: Array
    torques: Array
    turns: int
    fixed: int = 0

    @property
    def total(self) -> float:
        """Time of the transfer [s]."""
        return float(self.durations.sum())

    @property
    def head(self) -> tuple[Array, Array]:
        """Durations and torques of the arcs that stay as they are."""
        n = self.fixed
        return self.durations[:n], self.torques[:n]

    @property
    def tail(self) -> tuple[Array, Array]:
        """Durations and torques of the arcs that are varied."""
        n = self.fixed
        return self.durations[n:], self.torques[n:]

    def with_tail(self, durations: Array) -> Candidate:
        """Return the arcs with other durations of those that are varied."""
        return replace(self, durations=np.append(self.head[0], durations))


def starts(task: SwingUpTask, rng: np.random.Generator, count: int, most: int) -> list[Candidate]:
    """Return `count` sequences of up to `most` arcs: log-uniform totals split by Dirichlet(2)."""
    most = min(most, _MOST_RANDOM_ARCS)
    w0 = task.plant.natural_frequency
    quickest = max(task.transfer_time, 1e-3 / w0)
    shortest, longest = min(1.6 / w0, 1.5 * quickest), max(16 / w0, 8 * quickest)
    arcs = FEWEST_ARCS + np.arange(count) % (most - FEWEST_ARCS + 1)
    shares = rng.gamma(2.0, size=(count, most)) * (np.arange(most) < arcs[:, None])
    totals = np.exp(rng.uniform(math.log(shortest), math.log(longest), size=count))
    durations = shares * (totals / shares.sum(axis=1))[:, None]
    first = np.where(rng.uniform(size=count) < 0.5, 1.0, -1.0)
    torques = task.planned_torque * first[:, None] * (-1.0) ** np.arange(most)
    return [Candidate(durations[i, :n], torques[i, :n], 0) for i, n in enumerate(arcs)]


def arcs_of(motion: Trajectory) -> Candidate | None:
    """
    Return the arcs of constant torque of a motion, read from its controls; None if it has none.

    The rest of a plan that is under way begins in the middle of an arc.
    """
    if motion.interpolation != 'zero_order_hold' or motion.control_names != ('torque',):
        return None
    pieces = motion.control_pieces
    torques = pieces.c[0, :, 0]
    return Candidate(np.diff(pieces.x), torques, 0) if torques.all() else None


def warm_starts(
    task: SwingUpTask, rng: np.random.Generator, previous: Candidate, most: int, change: float
) -> list[Candidate]:
    """
    Return the arcs of an earlier plan, their durations changed at random.

    Extreme torques become those planned now, others are clipped to them. `change` is the standard
    deviation of the logarithms of the durations. An arc of no duration is put before or after
    them, or both, where a new switch may grow; there are at most `most`.
    """
    sizes, found = np.abs(previous.torques), list[Candidate]()
    held = np.clip(previous.torques, -task.planned_torque, task.planned_torque)
    if np.ptp(sizes) <= 1e-9 * sizes[0]:  # extreme torques, they may be others now
        held = np.copysign(task.planned_torque, held)
    for before, after in ((0, 1), (0, 0), (1, 0), (1, 1)):
        after = max(after, min(FEWEST_ARCS + 1, most) - before - held.size)
        count = before + held.size + after
        if count > most:
            continue
        end = -math.copysign(task.planned_torque, held[-1]) * (-1.0) ** np.arange(after)
        first = np.full(before, -math.copysign(task.planned_torque, held[0]))
        durations = previous.durations * np.exp(change * rng.normal(size=held.size))
        durations = np.concatenate([np.zeros(before), durations, np.zeros(after)])
        torques = np.concatenate([first, held, end])
        found.append(Candidate(durations, torques, 0, max(count - _MOST_VARIED_ARCS, 0)))
    return found


def shoot_upright(
    task: SwingUpTask,
    candidates: list[Candidate],
    steps: Steps,
    until: Budget,
    enough: float = math.inf,
    rounds: Sequence[tuple[Effort, float]] = _TAIL_ROUNDS,
) -> list[Candidate]:
    """Vary the arcs that are not fixed, in time, until `enough` arrive; those that do."""
    if until.spent:  # of very many arcs even the roll below takes long
        return []
    left, begins = candidates, np.tile(task.start, (len(candidates), 1))
    if any(each.fixed for each in candidates):  # as finely as the arcs that do not stay
        limit = max(_INSIDE * task.disk_angle_limit, abs(task.start[1]))
        heads = ArcBatch.of([each.head for each in candidates])
        ends, peaks = roll_to_ends(task, heads, _FIXED_STEP, limit)
        inside = peaks <= limit
        left, begins = [candidates[i] for i in np.flatnonzero(inside)], ends[inside]
    tails, costs = ArcBatch.of([each.tail for each in left]), np.full(len(left), np.inf)
    rows, found = np.arange(len(left)), []
    for effort, most in rounds:
        if until.spent or not rows.size or np.count_nonzero(costs < ARRIVED) >= enough:
            break
        part = tails.rows(rows)
        costs[rows] = shoot(task, begins[rows], part, steps, until, effort)
        tails.durations[rows] = part.durations
        rows = rows[(costs[rows] >= ARRIVED) & (costs[rows] < most)]
    for row in np.flatnonzero(costs < ARRIVED).tolist():
        each, varied = left[row], tails.durations[row, : tails.arcs[row]]
        end = roll_states(task.plant, begins[row], varied, each.tail[1])[-1]
        found.append(replace(each.with_tail(varied), turns=task.turns_nearest(end)))
    return found


def to_polish(landed: list[Candidate]) -> list[Candidate]:
    """Return the quickest, of which only the last arcs are to be varied."""
    return [
        replace(each, fixed=max(each.fixed, each.durations.size - _POLISHED))
        for each in sorted(landed, key=lambda candidate: candidate.total)[:LANES]
    ]


def distinct(candidates: list[Candidate]) -> list[Candidate]:
    """Candidates by their total time, one of those whose times are the same."""
    kept: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: c.total):
        if not kept or candidate.total - kept[-1].total > _DISTINCT * candidate.total:
            kept.append(candidate)
    return kept


def polish(
    task: SwingUpTask,
    candidate: Candidate,
    steps: int,
    tolerance: float,
    budget: Budget,
    cutoff: float = math.inf,
) -> tuple[Candidate, float]:
    """
    Minimise the total time from a candidate; the result and its largest violation.

    A search that ends less feasible than it began gives the candidate back.
    """
    w0 = task.plant.natural_frequency
    program = SwitchingProgram(program_of(task, candidate, steps))
    feasibility, cutoff = max(tolerance, 1e-11), cutoff - candidate.head[0].sum()
    first = best = program.evaluate(candidate.tail[0] * w0)
    for penalty in _PENALTIES[1:] if task.swing_drive < _STIFF_DRIVE else _PENALTIES:
        options = TrustRegionOptions(
            penalties=(penalty, penalty),
            radius=0.5,
            iterations=25,
            cost_tolerance=1e-4,
            feasibility=(feasibility, feasibility),
            corrections=4,
            cutoff=cutoff * w0,
        )
        with np.errstate(all='ignore'):
            found = minimise(program, first.xi, options, budget).point
        if found.violation <= max(feasibility, best.violation):
            best = found
        if found.violation <= 100 * feasibility or found.cost > cutoff * w0 or budget.spent:
            break
    return candidate.with_tail(best.xi / w0), best.violation


def corrected(
    task: SwingUpTask, candidate: Candidate, steps: int, budget: Budget
) -> tuple[Candidate, float]:
    """
    Return a polished candidate, integrated in more steps; and its largest violation.

    Fixed arcs are rounded to whole nanoseconds first, as `trajectory` rounds them: over many
    swings the rounding would otherwise grow to an error at the end.
    """
    switches = to_nanoseconds(np.concatenate([[0.0], np.cumsum(candidate.head[0])]))
    candidate = replace(candidate, durations=np.append(np.diff(switches), candidate.tail[0]))
    w0, program = task.plant.natural_frequency, program_of(task, candidate, steps)
    xi = at = best = candidate.tail[0] * w0
    step, before, violation = np.zeros_like(xi), math.inf, math.inf
    for _ in range(_CORRECTIONS):
        point = evaluate_arcs(program, xi)
        budget.evaluations += 1
        now = max(point.ends, point.beyond)
        if now < violation:
            best, violation = xi, now
        if not 1e-10 < violation < 1.0 or budget.spent:
            break
        if now < _WORSE * before:
            at, before = xi, now
            beyond = point.margins < 0.0
            rows = np.concatenate([point.jacobian, point.slopes[beyond]])
            rows[:, xi <= 0.0] = 0.0
            wrong = np.concatenate([point.residual, point.margins[beyond]])
            step = -np.linalg.lstsq(rows, wrong, rcond=1e-6)[0]
        else:  # over many arcs a step may lead too far
            step = 0.5 * step
        xi = np.maximum(at + step, 0.0)
    return candidate.with_tail(best / w0), violation


def program_of(
    task: SwingUpTask, candidate: Candidate, steps: int, parts: int = 1
) -> SwitchingData:
    """Return the program over the arcs that are not fixed, each one of `parts` of an arc."""
    plant, (durations, torques) = task.plant, candidate.tail
    start = roll_states(plant, task.start, *candidate.head)[-1]
    fewest, share = -(-steps // parts), _QUICK / steps
    return SwitchingData(
        plant.coefficients,
        start,
        torques,
        2.0 * math.pi * candidate.turns,
        task.planned_disk_angle,
        plant.natural_frequency,
        *mesh_of_arcs(plant.coefficients, start, durations, torques, fewest, share),
    )


def reaches_limit(task: SwingUpTask, candidate: Candidate) -> bool:
    """Whether the disk comes to its limit."""
    arcs = ArcBatch.of([(candidate.durations, candidate.torques)])
    _, peaks = roll_to_ends(task, arcs, _FIXED_STEP, math.inf)
    return bool(peaks[0] > _AT_LIMIT * task.planned_disk_angle)


def joined(candidate: Candidate, durations: Array, torques: Array) -> tuple[Candidate, Integers]:
    """Join arcs that follow one another with the same torque; the first of those each is of."""
    firsts = np.flatnonzero(np.append(True, torques[1:] != torques[:-1]))
    together = np.add.reduceat(durations, firsts)
    return replace(candidate, durations=together, torques=torques[firsts]), firsts


def with_new_arcs(
    task: SwingUpTask, candidate: Candidate, steps: int, most: int
) -> Candidate | None:
    """
    Insert empty arcs of the opposite torque where longer ones promise a lower cost.

    All arcs of `candidate` must be varied; the longer one has at most `most`. Where no new arc
    pays, return the candidate as it is; None where it is a minimum, too, or its motion diverges.
    """
    durations = np.zeros(2 * _PARTS * candidate.durations.size + 1)
    durations[1::2] = np.repeat(candidate.durations / _PARTS, _PARTS)
    torques = np.empty(durations.size)
    torques[1::2] = np.repeat(candidate.torques, _PARTS)
    torques[:-1:2], torques[-1] = -torques[1::2], -candidate.torques[-1]
    split = replace(candidate, durations=durations, torques=torques)
    xi = task.plant.natural_frequency * durations
    point = evaluate_arcs(program_of(task, split, steps, _PARTS), xi)
    if not point.ends < np.inf:  # the motion runs away, integrated so coarsely
        return None
    there = xi > _EMPTY
    slopes = lagrangian_slopes(point, there)
    pays = np.flatnonzero(~there & (slopes < _PAYS))
    room = max(0, min(_MOST_NEW, (most - candidate.durations.size) // 2))
    begun = pays[np.argsort(slopes[pays])][:room]
    if not begun.size:
        return candidate if np.abs(slopes[there]).max() > _STATIONARY else None
    kept = there.copy()
    kept[begun] = True
    return joined(candidate, durations[kept], torques[kept])[0]


def without_short_arcs(task: SwingUpTask, candidate: Candidate) -> Candidate:
    """
    Leave out arcs too short to matter, as long as there remain enough to vary.

    Neighbours that then have the same torque are joined.
    """
    shortest = min(_SHORTEST_ARC / task.plant.natural_frequency, 1e-4 * candidate.total)
    kept = np.flatnonzero(candidate.durations >= shortest)
    fewer, firsts = joined(candidate, candidate.durations[kept], candidate.torques[kept])
    fixed = int(np.count_nonzero(kept[firsts] < candidate.fixed))
    return candidate if firsts.size < fixed + FEWEST_ARCS else replace(fewer, fixed=fixed)


def trajectory(task: SwingUpTask, candidate: Candidate) -> Trajectory:
    """Return the motion under the arcs; every switch is a sample, all on whole nanoseconds."""
    usual = max(_SAMPLE_TIME, candidate.total / _MOST_SAMPLES)
    bounds = np.array(_FINE_SHARES) / task.plant.natural_frequency / task.plant.quickness
    fine = np.clip(candidate.total / _FINE_SAMPLES, *bounds)
    spacing = min(usual, float(fine))
    switches = to_nanoseconds(np.concatenate([[0.0], np.cumsum(candidate.durations)]))
    # The rest of a plan could not tell the ends of a shorter arc apart.
    there = np.diff(switches) > 1.5 * NANOSECOND
    begins, lengths = switches[:-1][there], np.diff(switches)[there]
    counts = np.maximum(np.ceil(lengths / spacing), 1.0).astype(np.intp)
    part = np.arange(1, counts.sum() + 1) - np.repeat(np.cumsum(counts) - counts, counts)
    begun, steps = (np.repeat(each, counts) for each in (begins, lengths / counts))
    instants = np.append(0.0, to_nanoseconds(begun + part * steps))
    held = np.repeat(candidate.torques[there], counts)
    states = roll_states(task.plant, task.start, np.diff(instants), held)
    controls = np.append(held, held[-1])[:, None]
    motion = Trajectory.of(task.plant, instants, states, controls)
    return motion.with_rates(task.plant.derivative)
