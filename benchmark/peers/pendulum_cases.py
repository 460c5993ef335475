# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The swing-ups of the benchmark's random states, by this package and by its peers."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
import json
from pathlib import Path
import time

from benchmark.peers.attempts import Attempt, judge_pendulum, Method
from benchmark.peers.collocation import Outcome
from benchmark.peers.pendulum_collocation import (
    energy_swing,
    GENTLE,
    HARD,
    PendulumCollocation,
    straight_line,
)
from benchmark.pendulum import problem, REGIMES, start_state
import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import TdmError
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

INTERVALS = 50
DEADLINE = 2.0
_NEAR = np.array([0.05, 0.05, 0.25, 0.25])  # rad, rad/s: how far a neighbouring state is
_BEST_KNOWN = Path(__file__).parents[1] / 'data' / 'pendulum_best_known.json'

OURS, OURS_WARM = 'tdm_planner', 'tdm_planner, warm'
LINE, SWING, PUMP = (f'collocation, {kind}' for kind in ('straight line', 'swing', 'slow swing'))
COLLOCATION_WARM = 'collocation, warm'
GUESSES: dict[str, Callable[[SwingUpTask], Trajectory]] = {
    LINE: straight_line,
    SWING: lambda task: energy_swing(task, HARD),
    PUMP: lambda task: energy_swing(task, GENTLE),
}


def best_known(regime: str) -> dict[int, float]:
    """Best known times [s] by seed."""
    known = json.loads(_BEST_KNOWN.read_text())[regime]
    return {int(seed): min(times.values()) for seed, times in known.items() if seed.isdigit()}


class PendulumCases:
    """The solvers of one torque limit; the collocation's program is built once."""

    def __init__(self, regime: str, intervals: int = INTERVALS) -> None:
        self.torque = REGIMES[regime]
        problem(self.torque, start_state('hanging')).solve(DEADLINE)  # compiles
        self.collocation = PendulumCollocation(self.task(0), intervals)
        self.neighbour = lru_cache(maxsize=1)(self._neighbour)
        self.intervals = intervals

    def task(self, seed: int) -> SwingUpTask:
        """Return the boundary conditions of a case."""
        return problem(self.torque, start_state(seed)).task

    def methods(self) -> dict[str, Method]:
        """Return every solver by name."""
        found: dict[str, Method] = {
            OURS: lambda case: self.ours(case, None),
            OURS_WARM: lambda case: self.ours(case, self.neighbour(case)),
        }
        for name, guess in GUESSES.items():
            found[name] = lambda case, guess=guess: self.collocate(  # type: ignore[misc]
                case, guess(self.task(case))
            )
        found[COLLOCATION_WARM] = self.collocate_warm
        return found

    def ours(self, case: int, earlier: Solution | None) -> Attempt:
        """Solve by this package, from an earlier plan if given."""
        stated = problem(self.torque, start_state(case))
        began = time.process_time()
        try:
            plan = stated.solve(DEADLINE, seed=0, warm_start=earlier)
        except TdmError as error:
            seconds = time.process_time() - began
            return Attempt(case, False, False, seconds, None, None, str(error))
        seconds = time.process_time() - began
        reasons = judge_pendulum(stated.task, plan.trajectory)
        return Attempt(
            case, True, not reasons, seconds, plan.evaluations, plan.cost, '; '.join(reasons)
        )

    def _neighbour(self, case: int) -> Solution | None:
        """Plan from a state nearby."""
        away = np.random.default_rng([case, 7]).uniform(-1.0, 1.0, size=4) * _NEAR
        try:
            return problem(self.torque, start_state(case) + away).solve(DEADLINE, seed=0)
        except TdmError:
            return None

    def collocate(self, case: int, guess: Trajectory | Outcome, warm: bool = False) -> Attempt:
        """Solve by collocation from a guess, aiming at the turn where the guess ends."""
        task = self.task(case)
        last = self.collocation.trajectory(guess) if isinstance(guess, Outcome) else guess
        goal = task.goal_nearest(last.states[-1])
        outcome = self.collocation.solve(task.start, goal, guess, warm)
        motion = self.collocation.trajectory(outcome)
        reasons = judge_pendulum(task, motion) if outcome.converged else (outcome.status,)
        return Attempt(
            case=case,
            converged=outcome.converged,
            solved=not reasons,
            seconds=outcome.seconds,
            iterations=outcome.iterations,
            cost=motion.duration,
            reason='; '.join(reasons),
        )

    def collocate_warm(self, case: int) -> Attempt:
        """
        Solve from the optimum, with multipliers, of collocation for the neighbouring state.

        That in turn starts from this package's plan for it: warm starts are not to suffer from
        cold ones.
        """
        earlier = self.neighbour(case)
        if earlier is None:
            return Attempt(case, False, False, 0.0, None, None, 'no neighbouring plan')
        guess = earlier.trajectory
        start, goal = guess.states[0], self.task(case).goal_nearest(guess.states[-1])
        near = self.collocation.solve(start, goal, guess)
        return self.collocate(case, near if near.converged else guess, warm=True)
