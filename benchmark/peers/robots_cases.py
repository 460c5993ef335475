# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The benchmark's random crossings of robots, by this package and by its peers.

    python -m benchmark.peers.robots_cases [--scenarios 100]

writes the costs that plans are compared with to data/robots_reference.json.
"""

from __future__ import annotations

import argparse
from functools import lru_cache
import json
import time
from typing import Any

from benchmark.peers.attempts import Attempt, best_of, formation_cost, judge_formation, Method
from benchmark.peers.collocation import Outcome
from benchmark.peers.robots_collocation import FormationCollocation, FormationGuess
from benchmark.robots import DATA, MARGIN
from benchmark.scenarios import crossing
import numpy as np
from tdm_planner.exceptions import TdmError
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.solution import Solution

INTERVALS = 30, 4  # to the first arrival, between two arrivals
DEADLINE = 20.0
_NEAR = 0.05  # m: how far the starts of a neighbouring crossing are, along either axis
# The cost is flat at its optimum: a tighter tolerance only costs time.
_IPOPT: dict[str, Any] = {'tol': 1e-6, 'acceptable_tol': 1e-4}

OURS, OURS_WARM = 'tdm_planner', 'tdm_planner, warm'
STRAIGHT, LEFT, RIGHT = (
    f'collocation, {kind}' for kind in ('straight ways', 'roundabout', 'other roundabout')
)
COLLOCATION_WARM = 'collocation, warm'
BOWS = {STRAIGHT: 0.0, LEFT: 0.15, RIGHT: -0.15}


class RobotsCases:
    """The solvers of crossings of `n` robots; the collocation's program is built once."""

    def __init__(
        self, n: int = 3, intervals: tuple[int, int] = INTERVALS, longest: float | None = None
    ) -> None:
        self.n = n
        self.problem(0).solve(DEADLINE)
        limit = {} if longest is None else {'max_cpu_time': longest}
        task = self.problem(0).task
        self.collocation = FormationCollocation(task, *intervals, **_IPOPT | limit)
        self.neighbour = lru_cache(maxsize=1)(self._neighbour)

    def problem(self, case: int, near: bool = False, **changes: Any) -> RobotFormation:
        """Return the crossing of a case, or one with starts nearby."""
        scenario = crossing(case, self.n)
        # Collocation keeps no reserve of the thrust either.
        kept = {'arena.tracking_margin': MARGIN, 'thrust_reserve': 0.0}
        values = scenario.parameters(**kept | changes)
        if near:
            rng = np.random.default_rng([case, 7])
            for name in scenario.names:
                for axis in 'xy':
                    values[f'{name}.start.{axis}'] += float(rng.uniform(-_NEAR, _NEAR))
        return RobotFormation.from_parameters(values)

    def methods(self) -> dict[str, Method]:
        """Return every solver by name."""
        found: dict[str, Method] = {
            OURS: lambda case: self.ours(case, None),
            OURS_WARM: lambda case: self.ours(case, self.neighbour(case)),
        }
        for name, bow in BOWS.items():
            found[name] = lambda case, bow=bow: self.collocate(case, bow)  # type: ignore[misc]
        found[COLLOCATION_WARM] = self.collocate_warm
        return found

    def ours(self, case: int, earlier: Solution | None, **changes: Any) -> Attempt:
        """Solve by this package, from an earlier plan if given."""
        stated = self.problem(case, **changes)
        began = time.process_time()
        try:
            plan = stated.solve(DEADLINE, warm_start=earlier)
        except TdmError as error:
            seconds = time.process_time() - began
            return Attempt(case, False, False, seconds, None, None, str(error))
        seconds = time.process_time() - began
        task, motions = stated.task, plan.trajectories
        reasons = judge_formation(task, motions)
        cost = formation_cost(task, motions)
        return Attempt(
            case, True, not reasons, seconds, plan.evaluations, cost, '; '.join(reasons)
        )

    def _neighbour(self, case: int) -> Solution | None:
        try:
            return self.problem(case, near=True).solve(DEADLINE)
        except TdmError:
            return None

    def collocate(self, case: int, bow: float) -> Attempt:
        """Solve by collocation from ways bowed sideways by a share of their length."""
        return self._collocate(case, self.collocation.guess_ways(self.problem(case).task, bow))

    def collocate_warm(self, case: int) -> Attempt:
        """
        Solve from the optimum, with multipliers, of collocation for the neighbouring crossing.

        That in turn starts from this package's plan for it.
        """
        earlier = self.neighbour(case)
        if earlier is None:
            return Attempt(case, False, False, 0.0, None, None, 'no neighbouring plan')
        task = self.problem(case, near=True).task
        guess = self.collocation.guess_plan(task, earlier.trajectories)
        near = self.collocation.solve(task, guess)
        return self._collocate(case, near if near.converged else guess, warm=True)

    def _collocate(
        self, case: int, guess: FormationGuess | Outcome, warm: bool = False
    ) -> Attempt:
        task = self.problem(case).task
        outcome = self.collocation.solve(task, guess, warm)
        motions = self.collocation.trajectories(task, outcome)
        reasons = judge_formation(task, motions) if outcome.converged else (outcome.status,)
        return Attempt(
            case=case,
            converged=outcome.converged,
            solved=not reasons,
            seconds=outcome.seconds,
            iterations=outcome.iterations,
            cost=formation_cost(task, motions),
            reason='; '.join(reasons),
        )


def main() -> None:
    """Write the best cost that collocation finds from three guesses, for every crossing."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument('--scenarios', type=int, default=100)
    cases = RobotsCases()
    costs = {
        str(case): best_of([cases.collocate(case, bow) for bow in BOWS.values()]).cost
        for case in range(arguments.parse_args().scenarios)
    }
    DATA.write_text(json.dumps({'robots': 3, 'costs': costs}, indent=1) + '\n')


if __name__ == '__main__':
    main()
