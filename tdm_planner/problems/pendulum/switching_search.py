# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Parts of the search for switching times: arrivals, polish, trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget, Point
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.plants.pendulum_kernels import roll_ends, roll_states
from tdm_planner.problems.pendulum.shooting import ArcBatch, ARRIVED, Effort, shoot
from tdm_planner.problems.pendulum.switching_minimiser import minimise
from tdm_planner.problems.pendulum.switching_motion import arc_program, ArcProgram, evaluate_arcs
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.trajectory import NANOSECOND, to_nanoseconds, Trajectory

Array = NDArray[np.float64]

FEWEST_ARCS = 4  # as many unknowns as end conditions
COARSE_STEPS = 12  # RK4 steps an arc while searching,
FINE_STEPS = 96  # and for the final polish
_INSIDE = 0.995  # of the disk's limit, as it is looked at after every part only
# What is spent on landing: turns of so many iterations, after which those are dropped whose sum
# of squares is larger still.
_TURN = Effort(iterations=12, early_cost=math.inf, late_cost=math.inf, reach=0.5)
_GIVEN_UP = (1.5, 0.3, 0.3, 1e-2, 1e-2, 0.0)
_PENALTIES = (30.0, 1000.0)  # on violations; the second where the first is too small
_CORRECTIONS = 10  # steps that bring a polished candidate to its end again
_DISTINCT = 2e-3  # relative difference of the total times of two different candidates
_SHORTEST_ARC = 1e-5  # of 1/w0; shorter arcs are omitted
_SAMPLE_TIME = 5e-3  # [s]
_MOST_SAMPLES = 4000  # of a trajectory, where the rig is so slow that they do


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


def shot(
    task: SwingUpTask, batch: ArcBatch, steps: int, budget: Budget, until: float
) -> list[Candidate]:
    """Shoot upright, at most until `until` s of the budget; return those that arrived."""
    budget.evaluations += shoot(
        task.plant,
        task.start,
        batch,
        task.planned_disk_angle,
        steps,
        lambda: budget.elapsed > until,
    )
    found: list[Candidate] = []
    for index in np.flatnonzero(batch.costs < ARRIVED):
        n = batch.arcs[index]
        durations, torques = batch.durations[index, :n].copy(), batch.torques[index, :n].copy()
        end = roll_states(task.plant, task.start, durations, torques)[-1]
        found.append(Candidate(durations, torques, task.turns_nearest(end)))
    return found


def land(
    task: SwingUpTask,
    candidates: list[Candidate],
    steps: int,
    budget: Budget,
    late: Callable[[], bool],
    enough: float = math.inf,
) -> list[Candidate]:
    """
    Shoot upright with the arcs that are not fixed; return those that arrive.

    No further turn is begun once it is `late`, or `enough` have arrived.
    """
    limit = max(_INSIDE * task.disk_angle, abs(task.start[1]))
    ends, peaks = along_fixed(task, candidates, steps, limit)
    inside = peaks <= limit
    left, starts = [candidates[i] for i in np.flatnonzero(inside)], ends[inside]
    if not left:
        return []
    counts = np.array([each.durations.size - each.fixed for each in left], dtype=np.intp)
    shape = len(left), int(max(counts))
    turn = math.nan if task.turns is None else float(task.turns)
    batch = ArcBatch(
        np.zeros(shape), counts, np.zeros(shape), np.full(len(left), turn),
        np.full(len(left), np.inf),
    )  # fmt: skip
    for row, each in enumerate(left):
        n = counts[row]
        batch.durations[row, :n], batch.torques[row, :n] = each.tail
    rows, found = np.arange(len(left)), []
    for most in _GIVEN_UP:
        if late() or not rows.size or np.count_nonzero(batch.costs < ARRIVED) >= enough:
            break
        part = batch.rows(rows)
        budget.evaluations += shoot(
            task.plant, starts[rows], part, task.planned_disk_angle, steps, late, _TURN
        )
        batch.durations[rows], batch.costs[rows] = part.durations, part.costs
        rows = rows[(part.costs >= ARRIVED) & (part.costs < most)]
    for row in np.flatnonzero(batch.costs < ARRIVED).tolist():
        each, n = left[row], counts[row]
        varied = batch.durations[row, :n]
        end = roll_states(task.plant, starts[row], varied, each.tail[1])[-1]
        found.append(replace(each.with_tail(varied), turns=task.turns_nearest(end)))
    return found


def along_fixed(
    task: SwingUpTask, candidates: Sequence[Candidate], steps: int, limit: float
) -> tuple[Array, Array]:
    """
    Integrate the arcs that stay as they are, as finely as `steps` integrate those that do not.

    Returns the states after them (B, 4) and the largest |psi| on the way (B,), which ends where
    that is beyond `limit`.
    """
    arcs = np.array([each.fixed for each in candidates], dtype=np.intp)
    durations, torques = np.zeros((2, arcs.size, int(arcs.max(initial=0))))
    for row, each in enumerate(candidates):
        durations[row, : each.fixed], torques[row, : each.fixed] = each.head
    k, share = task.plant.coefficients, task.plant.quickness / steps
    found: tuple[Array, Array] = roll_ends(k, task.start, durations, torques, arcs, share, limit)
    return found


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
    program = program_of(task, candidate, steps)
    feasibility, cutoff = max(tolerance, 1e-11), cutoff - candidate.head[0].sum()
    first = evaluate_arcs(program, candidate.tail[0] * w0)
    budget.evaluations += 1
    best = Point(first.xi, first.cost, np.array([first.ends, first.beyond]))
    for penalty in _PENALTIES:
        options = TrustRegionOptions(
            penalties=(penalty / task.distance, penalty / task.distance),
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
        if best.violation <= 100 * feasibility or found.cost > cutoff * w0 or budget.spent:
            break
    return candidate.with_tail(best.xi / w0), best.violation


def corrected(
    task: SwingUpTask, candidate: Candidate, steps: int, budget: Budget
) -> tuple[Candidate, float]:
    """
    Return a polished candidate, integrated in more steps; and its largest violation.

    What is fixed switches at whole nanoseconds, as trajectories do: many swings magnify the rest.
    """
    switches = to_nanoseconds(np.concatenate([[0.0], np.cumsum(candidate.head[0])]))
    candidate = replace(candidate, durations=np.append(np.diff(switches), candidate.tail[0]))
    w0, program = task.plant.natural_frequency, program_of(task, candidate, steps)
    xi, violation = candidate.tail[0] * w0, math.inf
    for left in reversed(range(_CORRECTIONS)):
        point = evaluate_arcs(program, xi)
        budget.evaluations += 1
        violation = max(point.ends, point.beyond)
        if not 1e-10 < violation < 1.0 or left == 0 or budget.spent:
            break
        beyond = point.margins < 0.0
        rows = np.concatenate([point.jacobian, point.slopes[beyond]])
        rows[:, xi <= 0.0] = 0.0
        wrong = np.concatenate([point.residual, point.margins[beyond]])
        xi = np.maximum(xi - np.linalg.lstsq(rows, wrong, rcond=1e-6)[0], 0.0)
    return candidate.with_tail(xi / w0), violation


def program_of(task: SwingUpTask, candidate: Candidate, steps: int) -> ArcProgram:
    """Return the program over the arcs that are not fixed."""
    start = roll_states(task.plant, task.start, *candidate.head)[-1]
    torques, disk_angle = candidate.tail[1], task.planned_disk_angle
    return arc_program(task.plant, start, torques, candidate.turns, disk_angle, steps)


def without_short_arcs(task: SwingUpTask, candidate: Candidate) -> Candidate:
    """
    Leave out arcs too short to matter, as long as there remain enough to vary.

    Neighbours that then have the same torque are joined.
    """
    shortest = min(_SHORTEST_ARC / task.plant.natural_frequency, 1e-4 * candidate.total)
    durations: list[float] = []
    torques: list[float] = []
    fixed = 0
    for arc, (duration, torque) in enumerate(
        zip(candidate.durations, candidate.torques, strict=True)
    ):
        if arc == candidate.fixed:
            fixed = len(durations)
        if duration < shortest:
            continue
        if torques and torques[-1] == torque:
            durations[-1] += duration
        else:
            durations.append(float(duration))
            torques.append(float(torque))
    if len(durations) < fixed + FEWEST_ARCS:
        return candidate
    return Candidate(np.array(durations), np.array(torques), candidate.turns, fixed)


def trajectory(task: SwingUpTask, candidate: Candidate) -> Trajectory:
    """Return the motion under the arcs; every switch is a sample, all on whole nanoseconds."""
    slow = candidate.total / _MOST_SAMPLES
    spacing = min(max(_SAMPLE_TIME, slow), task.fine_time(0.05))
    switches = to_nanoseconds(np.concatenate([[0.0], np.cumsum(candidate.durations)]))
    times, torques = [np.zeros(1)], []
    for start, end, torque in _arcs(switches, candidate.torques):
        count = max(1, math.ceil((end - start) / spacing))
        inside = to_nanoseconds(np.linspace(start, end, count + 1)[1:])
        times.append(inside)
        torques.append(np.full(count, torque))
    instants, held = np.concatenate(times), np.concatenate(torques)
    states = roll_states(task.plant, task.start, np.diff(instants), held)
    controls = np.append(held, held[-1])[:, None]
    return task.trajectory(instants, states, controls)


def _arcs(switches: Array, torques: Array) -> Iterator[tuple[float, float, float]]:
    for start, end, torque in zip(switches[:-1], switches[1:], torques, strict=True):
        if end - start > 1.5 * NANOSECOND:  # the rest of a plan could not tell its ends apart
            yield float(start), float(end), float(torque)
