# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Other arcs for a swing-up, read from a collocation that begins with it.

Shooting keeps the sequence of arcs that it starts from, and a law that pumps takes more swings
than the optimum. Collocation (see `direct_method.collocation`) moves torque and states freely:
from the pumped motion it often comes to one of half the time. Its torque is read as arcs, their
durations are then minimised like those of any other candidate. Where the disk moves along its
limit the torque lies between its extremes, and so do those of arcs.
"""

from __future__ import annotations

from collections.abc import Iterator
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
from tdm_planner.problems.pendulum.switching_search import Candidate, trajectory
from tdm_planner.problems.pendulum.task import SwingUpTask

Array = NDArray[np.float64]

_INTERVALS = 60
_SWITCH = 0.8  # of the torque, by which it changes within an interval that a switch divides
_EXTREME = 0.97  # of the torque, from which it counts as all of it
_ALIKE = 0.1, 0.3  # of the torque, by which that of one arc may vary: finely and coarsely read


def prepare_collocation(stated: StatedSwingUp) -> None:
    """Make the program, so that the first plan does not wait."""
    Collocation.of(Trace.of(CheckedFormulation(stated)), _INTERVALS, WARM)


def collocated(task: SwingUpTask, candidate: Candidate, until: Budget) -> Iterator[Candidate]:
    """Yield arcs of what collocation makes of a candidate in time: finely and coarsely read."""
    stated = StatedSwingUp.of(task, candidate.turns)
    checked = CheckedFormulation(stated)
    trace = Trace.of(checked)
    motion = trajectory(task, candidate)
    sample = motion.sample(motion.duration * np.linspace(0.0, 1.0, 2 * _INTERVALS + 1))
    states, torques = sample.state, sample.control[::2]
    guess = Motion(states[::2], states[1::2], torques, motion.duration)
    refinement = Refinement(checked, trace, DirectPlant(stated, trace), until)
    found = refinement.solve(_INTERVALS, guess, WARM)
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
