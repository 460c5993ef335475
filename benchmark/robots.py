# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
How fast and how good plans of robot formations are, on random crossings.

Times are process CPU times on one core. J_ref is the best of three local solutions of collocation.
"""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
import resource
from typing import Any

from benchmark.measuring import counted, timed
from benchmark.scenarios import crossing
import numpy as np
from tdm_planner.problems import RobotFormation

DATA = Path(__file__).parent / 'data' / 'robots_reference.json'
MARGIN = 0.004  # arena.tracking_margin: as much as the reference leaves out
TEAMS = {2: 50, 5: 30, 8: 20, 12: 15, 20: 10}
VARIANTS: dict[str, dict[str, Any]] = {
    'order 7, ends varied': {},
    'order 7, ends given, yaw varied: the 21 parameters of the paper': {
        'end_accelerations': 'given',
        'yaw_order': 7,
    },
    'order 9, ends given': {'end_accelerations': 'given', 'polynomial_order': 9},
    'order 11, ends given': {'end_accelerations': 'given', 'polynomial_order': 11},
    'order 9, ends varied': {'polynomial_order': 9},
    'order 7, ends given, speed factor of degree 2': {
        'end_accelerations': 'given',
        'speed_factor_order': 2,
    },
    'order 7, ends varied, speed factor of degree 2': {'speed_factor_order': 2},
}


def references() -> dict[int, float]:
    """Costs J_ref of the three-robot crossings by seed, see `peers.robots`."""
    costs = json.loads(DATA.read_text())['costs']
    return {int(seed): cost for seed, cost in costs.items() if cost is not None}


def measure(seeds: Sequence[int], n: int = 3, **changes: Any) -> dict[str, Any]:
    """Plan the crossings `seeds` of `n` robots with changed parameters; returns the figures."""
    known = references() if n == 3 else {}
    times, ratios, ends, turns, failures = [], [], [], [], []
    settings = {'solver.deadline': 8.0, 'arena.tracking_margin': MARGIN, **changes}
    for seed in counted(seeds, f'{n} robots'):
        problem = RobotFormation.from_parameters(crossing(seed, n).parameters(**settings))
        run = timed(problem)
        if run.plan is None:
            failures.append(f'{seed}: {run.error}')
            continue
        times.append(1e3 * run.processor)
        if seed in known:
            ratios.append(run.plan.cost / known[seed])
        missed = run.plan.verification.terminal_error.reshape(n, 7)
        ends.append(float(np.hypot(missed[:, 0], missed[:, 1]).max()))
        turns.append(float(np.abs(missed[:, 4]).max()))
    return {
        'robots': n,
        'scenarios': len(seeds),
        'verified': len(times),
        'time_median_ms': _quantile(times, 0.5),
        'time_p95_ms': _quantile(times, 0.95),
        'ratio_median': _quantile(ratios, 0.5),
        'ratio_p95': _quantile(ratios, 0.95),
        'ratio_max': _quantile(ratios, 1.0),
        'end_error_max_m': _quantile(ends, 1.0),
        'end_error_max_rad': _quantile(turns, 1.0),
        'failures': failures,
    }


def _quantile(values: list[float], share: float) -> float:
    return float(np.quantile(values, share)) if values else float('nan')


def _row(label: str, figures: dict[str, Any]) -> str:
    return (
        f'{label:64s} {figures["verified"]:4d}/{figures["scenarios"]:<4d}'
        f' {figures["time_median_ms"]:7.1f} {figures["time_p95_ms"]:7.1f}'
        f' {figures["ratio_median"]:7.3f} {figures["ratio_p95"]:7.3f} {figures["ratio_max"]:7.3f}'
        f' {1e3 * figures["end_error_max_m"]:7.2f} {figures["end_error_max_rad"]:8.1e}'
    )


def run(scenarios: int = 100, teams: bool = True, variants: bool = True) -> dict[str, Any]:
    """Measure everything: both methods, and variants of the polynomials."""
    found: dict[str, Any] = {}
    for n, count in {3: scenarios, **(TEAMS if teams else {})}.items():
        seeds = range(min(count, scenarios))
        found[f'{n} robots'] = measure(seeds, n, method='polynomials')
        found[f'{n} robots, thrust arcs'] = measure(seeds, n, method='thrust_arcs')
    # The references use all of the thrust.
    without = measure(range(scenarios), method='thrust_arcs', thrust_reserve=0.0)
    found['3 robots, thrust arcs without a reserve'] = without
    for label, changes in VARIANTS.items() if variants else ():
        seeds = range(min(30, scenarios))
        found[label] = measure(seeds, method='polynomials', **changes)
    found['memory_MB'] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return found


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    columns = 'verified   ms med     p95   J/Jref     p95     max  end mm  end rad'
    rows = {name: f for name, f in figures.items() if isinstance(f, dict) and 'verified' in f}
    lines = [f'{"":64s} {columns}', *(_row(name, f) for name, f in rows.items())]
    lines.append(f'memory: {figures["memory_MB"]:.0f} MB')
    lines += [f'{name}: {failure}' for name, f in rows.items() for failure in f['failures']]
    return '\n'.join(lines)
