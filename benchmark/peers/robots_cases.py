# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The benchmark's random crossings of robots, by this package and by its peers.

    python -m benchmark.peers.robots_cases [--scenarios 100]

writes the costs that plans are compared with to data/robots_reference.json.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from functools import partial
import json

from benchmark.peers.attempts import best_of, Cases, formation_cost, judge_formation
from benchmark.peers.robots_collocation import FormationCollocation, FormationGuess
from benchmark.robots import DATA, MARGIN
from benchmark.scenarios import crossing
import numpy as np
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

INTERVALS = 30, 4  # to the first arrival, between two arrivals
_NEAR = 0.05  # m: how far the starts of a neighbouring crossing are, along either axis
BOWS = {'straight ways': 0.0, 'roundabout': 0.15, 'other roundabout': -0.15}


class RobotsCases(Cases):
    """The solvers of crossings of three robots."""

    deadline = 20.0
    collocation: FormationCollocation

    def __init__(self) -> None:
        super().__init__()
        # The cost is flat at its optimum: a tighter tolerance only costs time.
        self.collocation = FormationCollocation(
            self.problem(0).task, *INTERVALS, tol=1e-6, acceptable_tol=1e-4
        )
        self.guesses = {
            f'collocation, {name}': partial(self.collocation.guess_ways, bow=bow)
            for name, bow in BOWS.items()
        }

    def problem(self, case: int, near: bool = False) -> RobotFormation:
        """Return the crossing of a case, or one with starts nearby."""
        scenario = crossing(case)
        # Collocation keeps no reserve of the thrust either.
        values = scenario.parameters(**{'arena.tracking_margin': MARGIN, 'thrust_reserve': 0.0})
        if near:
            rng = np.random.default_rng([case, 7])
            for name in scenario.names:
                for axis in 'xy':
                    values[f'{name}.start.{axis}'] += float(rng.uniform(-_NEAR, _NEAR))
        return RobotFormation.from_parameters(values)

    def guess_plan(self, task: FormationTask, plan: Solution) -> FormationGuess:
        """Return a plan as a guess."""
        return self.collocation.guess_plan(task, plan.trajectories)

    def judge(
        self, task: FormationTask, motions: Mapping[str, Trajectory]
    ) -> tuple[tuple[str, ...], float]:
        """Return the reasons why motions are no manoeuvre, and their J."""
        return judge_formation(task, motions), formation_cost(task, motions)


def main() -> None:
    """Write the best cost that collocation finds from three guesses, for every crossing."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument('--scenarios', type=int, default=100)
    cases = RobotsCases()
    costs = {
        str(case): best_of([cases.collocate(name, case) for name in cases.guesses]).cost
        for case in range(arguments.parse_args().scenarios)
    }
    DATA.write_text(json.dumps({'robots': 3, 'costs': costs}, indent=1) + '\n')


if __name__ == '__main__':
    main()
