# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Measures this package and its peers side by side, on one core."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import os
from typing import Any

from benchmark.peers.attempts import alternate, best_of, Cases
from benchmark.peers.pendulum import PendulumCases
from benchmark.peers.robots import RobotsCases
from benchmark.pendulum import best_known, REGIMES
from benchmark.robots import references


def run(cases: int = 100) -> dict[str, Any]:
    """Return everything as JSON holds it: `cases` random cases of every problem."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    problems = {
        f'pendulum, {regime} torque': _problem(PendulumCases(regime), cases, best_known(regime))
        for regime in REGIMES
    }
    problems['3 robots'] = _problem(RobotsCases(), cases, references())
    return {'cases': cases, 'problems': problems}


def _problem(solvers: Cases, count: int, known: Mapping[int, float]) -> dict[str, Any]:
    found = alternate(solvers.methods(), range(count))
    several = zip(*(found[name] for name in solvers.guesses), strict=True)
    found['collocation, best of 3 guesses'] = [best_of(attempts) for attempts in several]
    return {
        'attempts': {name: [asdict(a) for a in attempts] for name, attempts in found.items()},
        'known': {str(case): known[case] for case in known if case < count},
        'build_s': solvers.collocation.build_seconds,
        'variables': solvers.collocation.solver.variables,
    }
