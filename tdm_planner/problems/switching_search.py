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

"""Parts of the search for switching times: arrivals, polish, trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget, Point
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.plants.pendulum_kernels import roll_states
from tdm_planner.plants.pendulum_steering import ArcBatch, ARRIVED, steer
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_minimiser import minimise
from tdm_planner.problems.switching_motion import arc_program, evaluate_arcs
from tdm_planner.problems.switching_seeds import FEWEST_ARCS
from tdm_planner.trajectory import to_nanoseconds, Trajectory

Array = NDArray[np.float64]

COARSE_STEPS = 12  # RK4 steps an arc while searching,
FINE_STEPS = 96  # and for the final polish
_PENALTIES = (30.0, 1000.0)  # on violations; the second where the first is too small
_DISTINCT = 2e-3  # relative difference of the total times of two different candidates
_SHORTEST_ARC = 1e-5  # of 1/w0; shorter arcs are left out
_SAMPLE_TIME = 5e-3  # [s]
_SUBSTEPS = 8  # RK4 steps between two samples of a trajectory


@dataclass(frozen=True, eq=False)
class Candidate:
    """Durations (K,) [s] of arcs of torque (K,) [N m] that end at theta = 2 pi `turns`."""

    durations: Array
    torques: Array
    turns: int

    @property
    def total(self) -> float:
        """Time of the transfer [s]."""
        return float(self.durations.sum())


def steered(
    task: SwingUpTask, batch: ArcBatch, steps: int, budget: Budget, until: float
) -> list[Candidate]:
    """Steer the batch upright, at most until `until` s of the budget; those that arrived."""
    budget.evaluations += steer(
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
        end = roll_states(task.plant, task.start, durations, torques, steps)[-1]
        found.append(Candidate(durations, torques, task.turns_nearest(end)))
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
    program = arc_program(
        task.plant, task.start, candidate.torques, candidate.turns, task.planned_disk_angle, steps
    )
    feasibility = max(tolerance, 1e-11)
    first = evaluate_arcs(program, candidate.durations * w0)
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
            cutoff=cutoff * w0 if math.isfinite(cutoff) else None,
        )
        with np.errstate(all='ignore'):
            found = minimise(program, first.xi, options, budget).point
        if found.violation <= max(feasibility, best.violation):
            best = found
        if best.violation <= 100 * feasibility or found.cost > cutoff * w0 or budget.spent:
            break
    return Candidate(best.xi / w0, candidate.torques, candidate.turns), best.violation


def without_short_arcs(task: SwingUpTask, candidate: Candidate) -> Candidate:
    """
    Leave out arcs too short to matter, as long as there remain enough to vary.

    Neighbours that then have the same torque are joined.
    """
    shortest = min(_SHORTEST_ARC / task.plant.natural_frequency, 1e-4 * candidate.total)
    durations: list[float] = []
    torques: list[float] = []
    for duration, torque in zip(candidate.durations, candidate.torques, strict=True):
        if duration < shortest:
            continue
        if torques and torques[-1] == torque:
            durations[-1] += duration
        else:
            durations.append(float(duration))
            torques.append(float(torque))
    if len(durations) < FEWEST_ARCS:
        return candidate
    return Candidate(np.array(durations), np.array(torques), candidate.turns)


def trajectory(task: SwingUpTask, candidate: Candidate) -> Trajectory:
    """Return the motion under the arcs; every switch is a sample, all on whole nanoseconds."""
    spacing = min(_SAMPLE_TIME, 0.05 / task.plant.natural_frequency)
    switches = to_nanoseconds(np.concatenate([[0.0], np.cumsum(candidate.durations)]))
    times, torques = [np.zeros(1)], []
    for start, end, torque in _arcs(switches, candidate.torques):
        count = max(1, math.ceil((end - start) / spacing))
        inside = to_nanoseconds(np.linspace(start, end, count + 1)[1:])
        times.append(inside)
        torques.append(np.full(count, torque))
    instants, held = np.concatenate(times), np.concatenate(torques)
    states = roll_states(task.plant, task.start, np.diff(instants), held, _SUBSTEPS)
    controls = np.append(held, held[-1])[:, None]
    return task.trajectory(instants, states, controls)


def _arcs(switches: Array, torques: Array) -> Iterator[tuple[float, float, float]]:
    for start, end, torque in zip(switches[:-1], switches[1:], torques, strict=True):
        if end > start:
            yield float(start), float(end), float(torque)
