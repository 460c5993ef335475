# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Measures this package and its peers side by side, on one core."""

from __future__ import annotations

import os
from typing import Any

from benchmark.peers.attempts import alternate, Attempt, best_of
from benchmark.peers.pendulum_cases import best_known, GUESSES, PendulumCases
from benchmark.peers.robots_cases import BOWS, RobotsCases
from benchmark.pendulum import REGIMES
from benchmark.progress import report
from benchmark.robots import references

BEST = 'collocation, best of 3 guesses'


def run(cases: int = 100) -> dict[str, Any]:
    """Return everything as JSON holds it: `cases` random cases of every problem."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    problems: dict[str, Any] = {}
    for regime in REGIMES:
        pendulum = PendulumCases(regime)
        found = alternate(pendulum.methods(), range(cases), report)
        problems[f'pendulum, {regime} torque'] = _problem(found, list(GUESSES), best_known(regime))
        problems[f'pendulum, {regime} torque']['build_s'] = pendulum.collocation.build_seconds
        problems[f'pendulum, {regime} torque']['variables'] = pendulum.collocation.solver.variables
    robots = RobotsCases()
    found = alternate(robots.methods(), range(cases), report)
    problems['3 robots'] = _problem(found, list(BOWS), references())
    problems['3 robots']['build_s'] = robots.collocation.build_seconds
    problems['3 robots']['variables'] = robots.collocation.solver.variables
    return {'cases': cases, 'problems': problems}


def _problem(
    found: dict[str, list[Attempt]], guesses: list[str], known: dict[int, float]
) -> dict[str, Any]:
    several = [
        best_of(attempts) for attempts in zip(*(found[name] for name in guesses), strict=True)
    ]
    found = {**found, BEST: several}
    return {
        'attempts': {name: [a.to_dict() for a in attempts] for name, attempts in found.items()},
        'known': {str(case): known[case] for case in known if case < len(several)},
    }
