# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Other arcs for a swing-up: where the minimum principle asks for them, and from a collocation.

Of a polished candidate multipliers lambda of the ends and mu >= 0 of the disk's limit make the
Lagrangian of (10) stationary in the arcs there are. An empty arc of the opposite torque then has
the derivative

    dL/dxi = 1 + lambda d(ends)/dxi - mu d(margins)/dxi,

the Hamiltonian of the minimum principle under that torque. Where it is negative the torque has the
wrong sign, and an arc begun there shortens the swing-up.

Shooting keeps the sequence of arcs that it starts from, and a law that pumps takes more swings
than the optimum. Collocation (see `direct_method.collocation`) moves torque and states freely:
from the pumped motion it often comes to one of half the time. Its torque is read as arcs, their
durations are then minimised like those of any other candidate. Where the disk moves along its
limit the torque lies between its extremes, and so do those of arcs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Collocation, Motion, WARM
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import Refinement
from tdm_planner.problems.pendulum.smooth import StatedSwingUp
from tdm_planner.problems.pendulum.switching_motion import ArcPoint, evaluate_arcs
from tdm_planner.problems.pendulum.switching_search import (
    Candidate,
    joined,
    program_of,
    trajectory,
)
from tdm_planner.problems.pendulum.task import SwingUpTask

Array = NDArray[np.float64]

_PARTS = 4  # of an arc, before each of which an empty arc is tried
_MOST = 2  # new arcs at a time: they change the multipliers
_PAYS = -0.1  # derivative of the Lagrangian below which an arc is begun
_STATIONARY = 0.1  # largest derivative by an arc that is there, at a minimum
_ACTIVE = 2e-3  # [rad] from the disk's limit, of a peak that counts as at it
_EMPTY = 1e-7  # w0 d of an arc that may only grow
_INTERVALS, _SETTINGS = 60, replace(WARM, barrier=1e-2)  # of the collocation; the optimum is far
_SWITCH = 0.8  # of the torque, by which it changes within an interval that a switch divides
_EXTREME = 0.97  # of the torque, from which it counts as all of it
_ALIKE = 0.1, 0.3  # of the torque, by which that of one arc may vary: finely and coarsely read


def with_new_arcs(
    task: SwingUpTask, candidate: Candidate, steps: int, most: int
) -> Candidate | None:
    """
    Return a candidate, all of whose arcs are varied, with empty arcs where they pay.

    There are at most `most` arcs. Where none pays it comes back as it is to be minimised further,
    or None at a minimum, and where the motion runs away.
    """
    durations = np.zeros(2 * _PARTS * candidate.durations.size + 1)
    durations[1::2] = np.repeat(candidate.durations / _PARTS, _PARTS)
    torques = np.empty(durations.size)
    torques[1::2] = np.repeat(candidate.torques, _PARTS)
    torques[:-1:2], torques[-1] = -torques[1::2], -candidate.torques[-1]
    split = replace(candidate, durations=durations, torques=torques)
    xi = task.plant.natural_frequency * durations
    point = evaluate_arcs(program_of(task, split, -(-steps // _PARTS)), xi)
    if not point.ends < np.inf:  # the motion runs away, integrated so coarsely
        return None
    there = xi > _EMPTY
    slopes = _lagrangian_slopes(point, there)
    pays = np.flatnonzero(~there & (slopes < _PAYS))
    room = max(0, min(_MOST, (most - candidate.durations.size) // 2))
    begun = pays[np.argsort(slopes[pays])][:room]
    if not begun.size:
        return candidate if np.abs(slopes[there]).max() > _STATIONARY else None
    kept = there.copy()
    kept[begun] = True
    return joined(candidate, durations[kept], torques[kept])[0]


def _lagrangian_slopes(point: ArcPoint, there: NDArray[np.bool_]) -> Array:
    """Return dL/dxi (K,), by multipliers with which it is nearest to zero for the arcs `there`."""
    active = np.flatnonzero(point.margins < _ACTIVE)
    while True:
        rows = np.concatenate([point.jacobian, -point.slopes[active]])
        multipliers = np.linalg.lstsq(rows[:, there].T, -np.ones(there.sum()), rcond=1e-6)[0]
        pushed = multipliers[4:] >= 0.0
        if pushed.all():
            slopes: Array = 1.0 + multipliers @ rows
            return slopes
        active = active[pushed]


def prepare_collocation(stated: StatedSwingUp) -> None:
    """Make the program, so that the first plan does not wait."""
    Collocation.of(Trace.of(CheckedFormulation(stated)), _INTERVALS, _SETTINGS)


def collocated(task: SwingUpTask, candidate: Candidate, until: Budget) -> Iterator[Candidate]:
    """Yield arcs of what collocation makes of a candidate in time: finely and coarsely read."""
    stated = StatedSwingUp.of(replace(task, start_torque=None), candidate.turns)
    motion = trajectory(task, candidate)
    sample = motion.sample(motion.duration * np.linspace(0.0, 1.0, 2 * _INTERVALS + 1))
    states, torques = sample.state, sample.control[::2]
    guess = Motion(states[::2], states[1::2], torques, motion.duration)
    refinement = Refinement(DirectPlant(stated), until)
    found = refinement.solve(_INTERVALS, guess, _SETTINGS)
    if found is not None:
        shares = np.clip(found.controls[:, 0] / task.torque, -1.0, 1.0)
        for alike in _ALIKE:
            durations, levels = _arcs(shares, found.duration / _INTERVALS, alike)
            yield Candidate(durations, task.torque * levels, candidate.turns)


def _arcs(torques: Array, interval: float, alike: float) -> tuple[Array, Array]:
    """Return durations [s] and torques, as shares, of arcs; given `torques` (n + 1,) at nodes."""
    arcs: list[tuple[float, float]] = []
    for first, last in zip(torques[:-1].tolist(), torques[1:].tolist(), strict=True):
        mean = 0.5 * (first + last)
        parts = [(interval, mean if abs(mean) < _EXTREME else math.copysign(1.0, mean))]
        if abs(last - first) > _SWITCH:
            sign = math.copysign(1.0, first - last)
            before = 0.5 * (1.0 + sign * mean) * interval
            parts = [(before, sign), (interval - before, -sign)]
        for duration, torque in parts:
            if arcs and abs(arcs[-1][1] - torque) < alike:
                length, other = arcs.pop()
                torque = (length * other + duration * torque) / (length + duration)
                duration += length
            arcs.append((duration, torque))
    durations, shares = np.array(arcs).T
    return durations, shares
