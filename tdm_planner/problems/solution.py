# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A plan and its check: the one type of a result on the way from search to files and nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from tdm_planner.arrays import Array
from tdm_planner.trajectory import joined, Trajectory
from tdm_planner.verification import Verification


@dataclass(frozen=True, eq=False)
class Solution:
    """
    A plan: one trajectory per vehicle, by name, and their check.

    On the way through a search the check may have failed; `Problem.solve` gives verified plans
    only. `cost` is the performance index J, `parameters` the varied parameters Xi (m,), `penalty`
    Delta of (10), `cost_terms` the parts of J by name, `verifications` the check of every vehicle.
    `solve` adds the name of the `problem`, the number of times the dynamics were computed along a
    candidate, `evaluations`, the wall time `solve_time` [s] and the `summary`.
    """

    trajectories: Mapping[str, Trajectory]
    verification: Verification
    cost: float
    parameters: Array
    penalty: float
    cost_terms: Mapping[str, float] = field(default_factory=dict)
    verifications: Mapping[str, Verification] = field(default_factory=dict)
    problem: str = ''
    evaluations: int = 0
    solve_time: float = 0.0
    summary: str = ''

    @property
    def duration(self) -> float:
        """Time until the last vehicle has arrived [s]."""
        return max(trajectory.duration for trajectory in self.trajectories.values())

    @cached_property
    def trajectory(self) -> Trajectory:
        """Return the trajectory; of several vehicles all, on common instants as ``name.state``."""
        return joined(self.trajectories)

    @property
    def figures(self) -> dict[str, Any]:
        """Return what is said of a plan as a whole: problem, duration, cost, its terms, effort."""
        return {
            'problem': self.problem,
            'duration': self.duration,
            'cost': self.cost,
            'cost_terms': dict(self.cost_terms),
            'penalty': self.penalty,
            'solve_time': self.solve_time,
            'evaluations': self.evaluations,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as the JSON file of ``tdm plan`` holds it."""
        head = {name: value for name, value in self.figures.items() if value != {}}
        if len(self.trajectories) == 1 and not self.verifications:
            return head | self.trajectory.to_dict() | {'verification': self.verification.to_dict()}
        vehicles = {
            name: {
                **head,
                'duration': trajectory.duration,
                **trajectory.to_dict(),
                'verification': self.verifications[name].to_dict(),
            }
            for name, trajectory in self.trajectories.items()
        }
        return head | {'robots': vehicles, 'verification': self.verification.to_dict()}
