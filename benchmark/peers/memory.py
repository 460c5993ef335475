# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Peak memory of a process that does nothing but plan, one process a solver.

    python -m benchmark.peers.memory SOLVER PROBLEM

prints the peak resident set in MB, with the interpreter and all libraries.
"""

from __future__ import annotations

import os
from pathlib import Path
import resource
import subprocess
import sys

ROOT = Path(__file__).parents[2]
SOLVERS = ('none', 'tdm_planner', 'collocation', 'Drake')
PROBLEMS = ('pendulum', 'robots')
_CASES = 5


def work(solver: str, problem: str) -> None:
    """Solve a few cases; imports are part of the price."""
    if solver == 'none':
        import numpy  # noqa: F401

        return
    if solver == 'tdm_planner':
        from benchmark.pendulum import problem as swing_up
        from benchmark.pendulum import start_state
        from benchmark.scenarios import crossing
        from tdm_planner.problems import RobotFormation

        for case in range(_CASES):
            if problem == 'pendulum':
                swing_up(0.02, start_state(case)).solve(2.0)
            else:
                RobotFormation.from_parameters(crossing(case).parameters()).solve(8.0)
        return
    if problem == 'robots':
        from benchmark.peers.robots_cases import RobotsCases, STRAIGHT

        solve = RobotsCases().methods()[STRAIGHT]
    else:
        from benchmark.peers.pendulum_cases import DRAKE, PendulumCases, SWING

        solve = PendulumCases('weak').methods()[DRAKE if solver == 'Drake' else SWING]
    for case in range(_CASES):
        solve(case)


def peak(solver: str, problem: str) -> float | None:
    """Peak memory [MB] of a process of its own; None if it cannot run."""
    command = [sys.executable, '-m', 'benchmark.peers.memory', solver, problem]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False
    )
    return float(done.stdout.split()[-1]) if done.returncode == 0 else None


if __name__ == '__main__':
    work(*sys.argv[1:3])
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
