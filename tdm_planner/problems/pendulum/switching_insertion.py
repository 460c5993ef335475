# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
New arcs where they shorten a swing-up.

With multipliers lambda of the ends and mu >= 0 of the disk's limit that make the Lagrangian of
(10) stationary in the arcs there are, an empty arc of the opposite torque has the derivative

    dL/dxi = 1 + lambda d(ends)/dxi - mu d(margins)/dxi,

the Hamiltonian of the minimum principle under that torque. Where it is negative the torque has the
wrong sign, and an arc begun there pays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.pendulum.switching_motion import ArcPoint, evaluate_arcs
from tdm_planner.problems.pendulum.switching_search import Candidate, program_of
from tdm_planner.problems.pendulum.task import SwingUpTask

Array = NDArray[np.float64]

_PARTS = 4  # of an arc, before each of which an empty arc is tried
_MOST = 2  # new arcs at a time: they change the multipliers
_PAYS = -0.1  # derivative of the Lagrangian below which an arc is begun
_STATIONARY = 0.1  # largest derivative by an arc that is there, at a minimum
_ACTIVE = 2e-3  # [rad] from the disk's limit, of a peak that counts as at it
_EMPTY = 1e-7  # w0 d of an arc that may only grow


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
    durations, torques = durations[kept], torques[kept]
    firsts = np.flatnonzero(np.append(True, torques[1:] != torques[:-1]))
    joined = np.add.reduceat(durations, firsts)
    return replace(candidate, durations=joined, torques=torques[firsts])


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
