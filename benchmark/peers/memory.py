# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Peak memory of a process that does nothing but plan, one process a solver.

    python -m benchmark.peers.memory SOLVER PROBLEM

prints the peak resident set in MB, with the interpreter and all libraries.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

ROOT = Path(__file__).parents[2]
SOLVERS = ('none', 'tdm_planner', 'collocation', 'Drake')
PROBLEMS = ('pendulum', 'robots')
_CASES = 5


def work(solver: str, problem: str) -> None:
    """Solve a few cases; imports are part of the price."""
    if solver == 'none':
        importlib.import_module('benchmark.pendulum')  # the problems can be stated
    elif solver == 'tdm_planner':
        _plan(problem)
    elif problem == 'robots':
        _collocate_robots()
    else:
        _collocate_pendulum(solver)


def _plan(problem: str) -> None:
    from benchmark.pendulum import problem as swing_up
    from benchmark.pendulum import start_state
    from benchmark.scenarios import crossing
    from tdm_planner.problems import RobotFormation

    for case in range(_CASES):
        if problem == 'pendulum':
            swing_up(0.02, start_state(case)).solve(2.0)
        else:
            RobotFormation.from_parameters(crossing(case).parameters()).solve(8.0)


def _collocate_pendulum(solver: str) -> None:
    from benchmark.peers.pendulum_collocation import PendulumCollocation
    from benchmark.peers.pendulum_guesses import energy_swing, HARD
    from benchmark.pendulum import problem, start_state

    first = problem(0.02, start_state(0)).task
    peer: Any
    if solver == 'Drake':
        from benchmark.peers.drake_pendulum import DrakeSwingUp

        peer = DrakeSwingUp(first, 50)
    else:
        peer = PendulumCollocation(first, 50)
    for case in range(_CASES):
        task = problem(0.02, start_state(case)).task
        guess = energy_swing(task, HARD)
        peer.solve(task.start, task.goal_nearest(guess.states[-1]), guess)


def _collocate_robots() -> None:
    from benchmark.peers.robots_collocation import FormationCollocation
    from benchmark.scenarios import crossing
    from tdm_planner.problems import RobotFormation

    tasks = [RobotFormation.from_parameters(crossing(k).parameters()).task for k in range(_CASES)]
    peer = FormationCollocation(tasks[0], 30, 4, tol=1e-6, acceptable_tol=1e-4)
    for task in tasks:
        peer.solve(task, peer.guess_ways(task, 0.0))


def peak(solver: str, problem: str) -> float | None:
    """Peak memory [MB] of a process of its own; None if it cannot run."""
    command = [sys.executable, '-m', 'benchmark.peers.memory', solver, problem]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False
    )
    return float(done.stdout.split()[-1]) if done.returncode == 0 else None


def high_water_mark() -> float:
    """Return the peak resident set of this process [MB]; getrusage inherits the parent's."""
    status = Path('/proc/self/status').read_text()
    lines = [line for line in status.splitlines() if line.startswith('VmHWM')]
    return float(lines[0].split()[1]) / 1024


if __name__ == '__main__':
    work(*sys.argv[1:3])
    print(high_water_mark())
