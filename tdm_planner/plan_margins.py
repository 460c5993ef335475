# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""How far a plan stays from every limit, over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.base import Problem
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import dense_times

Array = NDArray[np.float64]

_INSTANTS = 1000


@dataclass(frozen=True, eq=False)
class PlanMargin:
    """Margin of a constraint at `times` (n,) s, `values` (n,): negative where it is violated."""

    name: str
    unit: str
    times: Array
    values: Array


def plan_margins(problem: Problem, trajectory: Trajectory) -> tuple[PlanMargin, ...]:
    """Return the margin of every constraint that the problem puts on one vehicle's motion."""
    times = dense_times(trajectory, trajectory.duration / _INSTANTS)
    states, controls = trajectory.sample(times)
    return tuple(
        PlanMargin(c.name, c.unit, times, np.asarray(c.margin(times, states, controls)))
        for c in problem.constraints_on(trajectory)
    )
