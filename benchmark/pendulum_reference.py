# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Best known times of the benchmark's swing-ups: a long search, then collocation from its result.

    python -m benchmark.pendulum_reference [--states N] [--first SEED]

writes benchmark/data/pendulum_best_known.json, keeping whatever is better of the file and the new
run. Collocation (Hermite-Simpson on equal intervals, CasADi and Ipopt) knows singular arcs, which
a plan of extreme torques can only approach.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from benchmark.pendulum import problem, REGIMES, start_state
import casadi
import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.rotary_pendulum import accelerations
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_search import (
    Candidate,
    COARSE_STEPS,
    distinct,
    FINE_STEPS,
    polish,
    steered,
    trajectory,
    without_short_arcs,
)
from tdm_planner.problems.switching_seeds import starts
from tdm_planner.trajectory import Trajectory

casadi.GlobalOptions.setNumpyMode(-1)  # numpy's functions of symbols give symbols

Array = NDArray[np.float64]

FILE = Path(__file__).parent / 'data' / 'pendulum_best_known.json'
STARTS = 3000
POLISHED = 40
INTERVALS = 100


def long_search(task: SwingUpTask, seed: int) -> Candidate | None:
    """Return the quickest of many polished candidates."""
    budget = Budget(math.inf)
    batch = starts(task, np.random.default_rng([seed, 1]), STARTS, 10)
    best: Candidate | None = None
    for candidate in distinct(steered(task, batch, COARSE_STEPS, budget, math.inf))[:POLISHED]:
        better, violation = polish(task, candidate, COARSE_STEPS, 1e-8, budget)
        if violation < 1e-6 and (best is None or better.total < best.total):
            fine, violation = polish(
                task, without_short_arcs(task, better), FINE_STEPS, 1e-8, budget
            )
            if violation < 1e-6 and task.verify(trajectory(task, fine)).ok:
                best = fine
    return best


def collocate(task: SwingUpTask, guess: Trajectory) -> float | None:
    """Return the minimum time by collocation started from a trajectory, None if it fails."""
    plant, n = task.plant, INTERVALS
    w0 = plant.natural_frequency
    unit = np.array([1.0, 1.0, w0, w0])

    x, u = casadi.MX.sym('x', 4), casadi.MX.sym('u')
    rates = casadi.vertcat(x[2], x[3], *_accelerations(plant, x, u * task.torque, w0))
    f = casadi.Function('f', [x, u], [rates])
    states, controls = casadi.MX.sym('X', 4, n + 1), casadi.MX.sym('U', 1, n + 1)
    middle = casadi.MX.sym('M', 1, n)
    total = casadi.MX.sym('T')
    h = total / n
    at_nodes = f.map(n + 1)(states, controls)
    left, right = states[:, :-1], states[:, 1:]
    centre = (left + right) / 2 + h / 8 * (at_nodes[:, :-1] - at_nodes[:, 1:])
    defects = (
        right - left - h / 6 * (at_nodes[:, :-1] + 4 * f.map(n)(centre, middle) + at_nodes[:, 1:])
    )
    lower, upper = np.full((4, n + 1), -np.inf), np.full((4, n + 1), np.inf)
    lower[1], upper[1] = -task.disk_angle, task.disk_angle
    lower[:, 0] = upper[:, 0] = task.start / unit
    lower[:, -1] = upper[:, -1] = task.goal_nearest(guess.states[-1]) / unit
    nodes = np.linspace(0.0, guess.duration, n + 1)
    sample = guess.sample(nodes)
    between = guess.sample((nodes[1:] + nodes[:-1]) / 2)
    first = np.concatenate(
        [
            (sample.state / unit).ravel(),
            0.9 * sample.control[:, 0] / task.torque,
            0.9 * between.control[:, 0] / task.torque,
            [guess.duration * w0],
        ]
    )
    torques = np.ones(2 * n + 1)
    options: dict[str, Any] = {
        'print_time': False,
        'ipopt': {'print_level': 0, 'sb': 'yes', 'max_iter': 400, 'max_cpu_time': 12.0},
    }
    variables = casadi.veccat(states, controls, middle, total)
    program = {'x': variables, 'f': total, 'g': casadi.vec(defects)}
    solver = casadi.nlpsol('solver', 'ipopt', program, options)
    result = solver(
        x0=first,
        lbx=np.concatenate([lower.T.ravel(), -torques, [1e-3]]),
        ubx=np.concatenate([upper.T.ravel(), torques, [np.inf]]),
        lbg=0,
        ubg=0,
    )
    return float(result['f']) / w0 if solver.stats()['success'] else None


def _accelerations(
    plant: RotaryPendulum, x: casadi.MX, torque: casadi.MX, w0: float
) -> tuple[casadi.MX, casadi.MX]:
    """Accelerations in units of w0^2, rates in units of w0."""
    theta, psi = accelerations(plant.coefficients, x[0], x[2] * w0, x[3] * w0, torque)
    return theta / w0**2, psi / w0**2


def main() -> None:
    """Improve the file for a range of states."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--states', type=int, default=100)
    parser.add_argument('--first', type=int, default=0)
    arguments = parser.parse_args()
    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    for regime, torque in REGIMES.items():
        seeds = ['hanging', *range(arguments.first, arguments.first + arguments.states)]
        for seed in seeds:
            task = problem(torque, start_state(seed)).task
            best = long_search(task, 0 if seed == 'hanging' else int(seed))
            entry = known.setdefault(regime, {}).setdefault(str(seed), {})
            if best is None:
                print(f'{regime} {seed}: nothing found', flush=True)
                continue
            entry['switching'] = min(best.total, entry.get('switching', math.inf))
            smooth = collocate(task, trajectory(task, best))
            if smooth is not None:
                entry['collocation'] = min(smooth, entry.get('collocation', math.inf))
            print(regime, seed, entry, flush=True)
            FILE.parent.mkdir(exist_ok=True)
            FILE.write_text(json.dumps(known, indent=1, sort_keys=True) + '\n')


if __name__ == '__main__':
    main()
