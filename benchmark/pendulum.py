# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Figures of the problem `pendulum_swing_up` on random states, strong and weak torque.

Success rate, times relative to the best known (`pendulum_reference.py`) and solve times, of the
default method and of the smooth one.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmark.measuring import counted, timed
import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.problems import PendulumLimits, PendulumStart, PendulumSwingUp

REGIMES = {'strong': 0.09, 'weak': 0.02}  # limits.torque [N m]
DEADLINE = 2.0  # s
BEST_KNOWN = Path(__file__).parent / 'data' / 'pendulum_best_known.json'


def best_known(regime: str) -> dict[int, float]:
    """Best known times [s] by seed."""
    known = json.loads(BEST_KNOWN.read_text())[regime]
    return {int(seed): min(times.values()) for seed, times in known.items() if seed.isdigit()}


def start_state(seed: int | str) -> Array:
    """Return the state of a seed: theta any, psi +-1 rad, rates +-5 rad/s; or 'hanging'."""
    if seed == 'hanging':
        return np.array([np.pi, 0.0, 0.0, 0.0])
    rng = np.random.default_rng(int(seed))
    state: Array = rng.uniform(-1.0, 1.0, size=4) * np.array([np.pi, 1.0, 5.0, 5.0])
    return state


def problem(torque: float, state: Array, method: str = 'switching') -> PendulumSwingUp:
    """Return the swing-up from a state with all the torque."""
    return PendulumSwingUp(
        limits=PendulumLimits(torque=torque),
        torque_reserve=0.0,
        start=PendulumStart(*map(float, state)),
        method=method,
    )


def measure(regime: str, states: int, method: str = 'switching') -> dict[str, Any]:
    """Solve the swing-up from the states of seeds 0 to `states` - 1 and summarise."""
    torque = REGIMES[regime]
    known = best_known(regime)
    hanging = problem(torque, start_state('hanging'), method)
    hanging.prepare()
    runs = [
        timed(problem(torque, start_state(seed), method), DEADLINE, seed=0)
        for seed in counted(range(states), f'{method}, {regime}')
    ]
    ratios = [run.plan.cost / known[seed] for seed, run in enumerate(runs) if run.plan]
    seconds = [run.wall for run in runs]
    from_hanging = timed(hanging, DEADLINE, seed=0).plan
    near = np.array(ratios) <= 1.02
    return {
        'states': states,
        'verified': len(ratios) / states,
        'within_1.02_of_best_known': float(near.sum()) / states,
        'median_ratio': float(np.median(ratios)) if ratios else None,
        'worst_ratio': float(np.max(ratios)) if ratios else None,
        'median_ms': 1e3 * float(np.median(seconds)),
        'p95_ms': 1e3 * float(np.quantile(seconds, 0.95)),
        'slowest_ms': 1e3 * float(np.max(seconds)),
        'from_hanging_s': from_hanging.cost if from_hanging else float('nan'),
        'failures': [f'{seed}: {run.error}' for seed, run in enumerate(runs) if run.error],
    }


def run(states: int = 100) -> dict[str, Any]:
    """Measure everything."""
    figures = {f'switching {regime}': measure(regime, states) for regime in REGIMES}
    return figures | {'smooth strong': measure('strong', states, method='smooth')}


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    head = f'{"":32}{"verified":>9}{"<= 1.02":>9}{"median":>8}{"worst":>8}'
    lines = [head + f'{"ms med":>8}{"ms p95":>8}{"ms max":>8}{"hanging":>9}']
    for name, f in figures.items():
        lines.append(
            f'{name:32}{f["verified"]:9.1%}{f["within_1.02_of_best_known"]:9.1%}'
            f'{f["median_ratio"] or float("nan"):8.3f}{f["worst_ratio"] or float("nan"):8.3f}'
            f'{f["median_ms"]:8.0f}{f["p95_ms"]:8.0f}{f["slowest_ms"]:8.0f}'
            f'{f["from_hanging_s"]:8.4f}s'
        )
        lines += [f'    seed {failure}' for failure in f['failures']]
    return '\n'.join(lines)
