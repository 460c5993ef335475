# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The swing-ups of the benchmark's random states, by this package and by its peers."""

from __future__ import annotations

from collections.abc import Mapping

from benchmark.peers.attempts import Cases, judge_pendulum
from benchmark.peers.pendulum_collocation import (
    energy_swing,
    GENTLE,
    HARD,
    PendulumCollocation,
    straight_line,
)
from benchmark.pendulum import problem, REGIMES, start_state
import numpy as np
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.pendulum.task import PENDULUM_NAME, SwingUpTask
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

INTERVALS = 50
_NEAR = np.array([0.05, 0.05, 0.25, 0.25])  # rad, rad/s: how far a neighbouring state is


class PendulumCases(Cases):
    """The solvers of one torque limit."""

    deadline = 2.0

    def __init__(self, regime: str) -> None:
        self.torque = REGIMES[regime]
        super().__init__()
        self.collocation = PendulumCollocation(self.problem(0).task, INTERVALS)
        self.guesses = {
            'collocation, straight line': straight_line,
            'collocation, swing': lambda task: energy_swing(task, HARD),
            'collocation, slow swing': lambda task: energy_swing(task, GENTLE),
        }

    def problem(self, case: int, near: bool = False) -> PendulumSwingUp:
        """Return the swing-up of a case, or one from a state nearby."""
        away = np.random.default_rng([case, 7]).uniform(-1.0, 1.0, size=4) * _NEAR
        return problem(self.torque, start_state(case) + near * away)

    def guess_plan(self, task: SwingUpTask, plan: Solution) -> Trajectory:
        """Return a plan as a guess."""
        return plan.trajectory

    def judge(
        self, task: SwingUpTask, motions: Mapping[str, Trajectory]
    ) -> tuple[tuple[str, ...], float]:
        """Return the reasons why a motion is no swing-up, and how long it takes [s]."""
        return judge_pendulum(task, motions[PENDULUM_NAME]), motions[PENDULUM_NAME].duration
