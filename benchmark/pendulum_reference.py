# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Best known times of the benchmark's swing-ups: a long search, then collocation from its result.

    python -m benchmark.pendulum_reference [--states N] [--first SEED]

writes benchmark/data/pendulum_best_known.json, keeping whatever is better of the file and the new
run. Collocation, that of `benchmark.peers` on more intervals, knows singular arcs, which a plan of
extreme torques can only approach.
"""

from __future__ import annotations

import argparse
import json
import math

from benchmark.peers.pendulum import PendulumCollocation
from benchmark.pendulum import BEST_KNOWN, problem, REGIMES, start_state
import numpy as np
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.problems.pendulum.candidates import (
    Candidate,
    COARSE_STEPS,
    distinct,
    FINE_STEPS,
    ONE_ROUND,
    polish,
    shoot_upright,
    starts,
    trajectory,
    without_short_arcs,
)
from tdm_planner.problems.pendulum.shooting import Steps
from tdm_planner.problems.pendulum.task import PENDULUM_NAME, SwingUpTask

STARTS = 3000
POLISHED = 40
INTERVALS = 200
IPOPT = {'max_iter': 400, 'max_cpu_time': 12.0}


def long_search(task: SwingUpTask, seed: int) -> Candidate | None:
    """Return the quickest of many polished candidates."""
    budget = Budget(math.inf)
    guesses = starts(task, np.random.default_rng([seed, 1]), STARTS, 10)
    arrived = shoot_upright(task, guesses, Steps(COARSE_STEPS), budget, rounds=ONE_ROUND)
    best: Candidate | None = None
    for candidate in distinct(arrived)[:POLISHED]:
        better, violation = polish(task, candidate, COARSE_STEPS, 1e-8, budget)
        if violation < 1e-6 and (best is None or better.total < best.total):
            fine, violation = polish(
                task, without_short_arcs(task, better), FINE_STEPS, 1e-8, budget
            )
            motion = trajectory(task, fine)
            if violation < 1e-6 and task.plan(motion, fine.durations, 0.0).verification.ok:
                best = fine
    return best


def main() -> None:
    """Improve the file for a range of states."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--states', type=int, default=100)
    parser.add_argument('--first', type=int, default=0)
    arguments = parser.parse_args()
    known = json.loads(BEST_KNOWN.read_text())
    for regime, torque in REGIMES.items():
        hanging = problem(torque, start_state('hanging')).task
        collocation = PendulumCollocation(hanging, INTERVALS, **IPOPT)
        seeds = ['hanging', *range(arguments.first, arguments.first + arguments.states)]
        for seed in seeds:
            task = problem(torque, start_state(seed)).task
            best = long_search(task, 0 if seed == 'hanging' else int(seed))
            entry = known.setdefault(regime, {}).setdefault(str(seed), {})
            if best is None:
                print(f'{regime} {seed}: nothing found', flush=True)
                continue
            entry['switching'] = min(best.total, entry.get('switching', math.inf))
            outcome = collocation.solve(task, trajectory(task, best))
            if outcome.converged:
                smooth = collocation.motions(task, outcome)[PENDULUM_NAME].duration
                entry['collocation'] = min(smooth, entry.get('collocation', math.inf))
            print(regime, seed, entry, flush=True)
            BEST_KNOWN.write_text(json.dumps(known, indent=1, sort_keys=True) + '\n')


if __name__ == '__main__':
    main()
