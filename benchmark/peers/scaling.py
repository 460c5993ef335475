# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""How time and cost grow with nodes, varied parameters and robots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import time
from typing import Any

from benchmark.peers.attempts import Attempt, summary
from benchmark.peers.judge import judge_pendulum
from benchmark.peers.pendulum_cases import best_known, DEADLINE, PendulumCases, SWING
from benchmark.peers.robots_cases import RobotsCases, STRAIGHT
from benchmark.pendulum import problem, REGIMES, start_state
from benchmark.robots import references
from tdm_planner.exceptions import TdmError

Report = Callable[[str], None]
Rows = list[dict[str, Any]]

_CASES, _PARAMETER_CASES = 10, 20
_PENDULUM_NODES = (25, 50, 100, 200)
_ROBOT_NODES = ((15, 2), (30, 4), (60, 8))
_QUADRATURE_NODES = (13, 21, 31, 41)
_SHAPES = (('given', 7), ('varied', 7), ('varied', 9), ('varied', 11), ('varied', 13))
_ARCS = (4, 5, 6, 7, 8, 10, 12)
_TEAMS = {2: 10, 3: 10, 5: 5, 8: 5, 12: 3, 20: 2}
# Collocation of more robots does not end within the time allowed.
_COLLOCATION_TEAMS = {2: 3, 3: 3, 5: 2, 8: 1}
_LONGEST = 60.0  # s


def _row(
    section: str, solver: str, value: int, variables: int | None, known: dict[int, float],
    attempts: Sequence[Attempt],
) -> dict[str, Any]:  # fmt: skip
    figures = summary([a.to_dict() for a in attempts], known)
    return {'section': section, 'solver': solver, 'value': value, 'variables': variables} | figures


def nodes(cases: int, report: Report) -> Rows:
    """Collocation on more and more intervals; this package's quadrature nodes for the robots."""
    rows: Rows = []
    cases = min(cases, _CASES)
    for regime in REGIMES:
        for count in _PENDULUM_NODES:
            report(f'pendulum {regime}, {count} intervals')
            pendulum = PendulumCases(regime, count)
            solve = pendulum.methods()[SWING]
            attempts = [solve(case) for case in range(cases)]
            row = _row(
                f'pendulum, {regime} torque', 'collocation', count,
                pendulum.collocation.solver.variables, best_known(regime), attempts,
            )  # fmt: skip
            rows.append(row | {'build_s': pendulum.collocation.build_seconds})
    known = references()
    for intervals in _ROBOT_NODES:
        report(f'3 robots, {intervals[0]} intervals')
        robots = RobotsCases(3, intervals)
        attempts = [robots.collocate(case, 0.0) for case in range(cases)]
        row = _row(
            '3 robots', 'collocation', intervals[0], robots.collocation.solver.variables,
            known, attempts,
        )  # fmt: skip
        rows.append(row | {'build_s': robots.collocation.build_seconds})
    for count in _QUADRATURE_NODES:
        report(f'3 robots, {count} nodes of the quadrature')
        attempts = [robots.ours(case, None, nodes=count) for case in range(cases)]
        rows.append(_row('3 robots', 'tdm_planner', count, None, known, attempts))
    return rows


def parameters(cases: int, report: Report) -> Rows:
    """More and more varied parameters of this package's two problems."""
    rows: Rows = []
    cases = min(cases, _PARAMETER_CASES)
    robots, known = RobotsCases(3), references()
    for ends, order in _SHAPES:
        report(f'3 robots, order {order}, end accelerations {ends}')
        changes = {'end_accelerations': ends, 'polynomial_order': order}
        size = robots.problem(0, **changes).solve(DEADLINE).parameters.size
        attempts = [robots.ours(case, None, **changes) for case in range(cases)]
        rows.append(_row('3 robots', 'tdm_planner', order, size, known, attempts))
    for regime in REGIMES:
        for arcs in _ARCS:
            report(f'pendulum {regime}, at most {arcs} arcs')
            attempts = [_arcs(regime, arcs, case) for case in range(cases)]
            rows.append(
                _row(
                    f'pendulum, {regime} torque', 'tdm_planner', arcs, arcs,
                    best_known(regime), attempts,
                )
            )  # fmt: skip
    return rows


def _arcs(regime: str, arcs: int, case: int) -> Attempt:
    stated = replace(problem(REGIMES[regime], start_state(case)), switching_arcs=arcs)
    began = time.process_time()
    try:
        plan = stated.solve(DEADLINE, seed=0)
    except TdmError as error:
        return Attempt(case, False, False, time.process_time() - began, None, None, str(error))
    seconds = time.process_time() - began
    solved = not judge_pendulum(stated.task, plan.trajectory)
    return Attempt(case, True, solved, seconds, plan.evaluations, plan.cost)


def teams(cases: int, report: Report) -> Rows:
    """More and more robots, costs relative to this package's."""
    rows: Rows = []
    for n, count in _TEAMS.items():
        report(f'{n} robots')
        tried = min(_COLLOCATION_TEAMS.get(n, 0), cases)
        intervals = (30, 4) if n <= 3 else (30, 2)
        robots = RobotsCases(n, intervals if tried else (3, 1), _LONGEST)
        ours = [robots.ours(case, None) for case in range(min(count, cases))]
        known = {a.case: a.cost for a in ours if a.cost is not None}
        size = robots.problem(0).solve(DEADLINE).parameters.size
        rows.append(_row('robots', 'tdm_planner', n, size, known, ours))
        if tried:
            report(f'{n} robots by collocation')
            solve = robots.methods()[STRAIGHT]
            theirs = [solve(case) for case in range(tried)]
            row = _row(
                'robots', 'collocation', n, robots.collocation.solver.variables, known, theirs
            )
            rows.append(row | {'build_s': robots.collocation.build_seconds})
    return rows
