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

"""How time and cost grow with nodes, varied parameters and robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import time
from typing import Any

from benchmark.peers.attempts import Attempt, summary
from benchmark.peers.judge import judge_pendulum
from benchmark.peers.pendulum_cases import best_known, DEADLINE, PendulumCases, SWING
from benchmark.peers.robots_cases import RobotsCases, STRAIGHT
from benchmark.pendulum import problem, REGIMES, start_state
from benchmark.progress import report
from benchmark.robots import references
from tdm_planner.exceptions import TdmError

Rows = list[dict[str, Any]]

_COLLOCATION_LONGEST = 20.0  # s a case


@dataclass(frozen=True)
class Extent:
    """
    What is varied, and for how many cases.

    `pendulum_nodes`, `robot_nodes` are intervals of the collocation, `quadrature_nodes` those of
    this package; `arcs` the most arcs of constant torque, `shapes` end accelerations and order of
    the polynomials; `teams` numbers of robots with the cases of this package and of collocation.
    """

    cases: int = 10
    dense_cases: int = 3  # of the largest program of `robot_nodes`
    pendulum_nodes: tuple[int, ...] = (25, 50, 100, 200)
    robot_nodes: tuple[tuple[int, int], ...] = ((15, 2), (30, 4), (60, 8))
    quadrature_nodes: tuple[int, ...] = (13, 21, 31, 41)
    shapes: tuple[tuple[str, int], ...] = (
        ('given', 7),
        ('varied', 7),
        ('varied', 9),
        ('varied', 11),
        ('varied', 13),
    )
    arcs: tuple[int, ...] = (4, 5, 6, 7, 8, 10, 12)
    # Collocation of more than 8 robots does not end within the time allowed.
    teams: tuple[tuple[int, int, int], ...] = (
        (2, 10, 3),
        (3, 10, 3),
        (5, 5, 2),
        (8, 5, 1),
        (12, 3, 0),
        (20, 2, 0),
    )


FULL = Extent()
QUICK = Extent(
    cases=1,
    dense_cases=1,
    pendulum_nodes=(25,),
    robot_nodes=((15, 2),),
    quadrature_nodes=(21,),
    shapes=(('varied', 7),),
    arcs=(8,),
    teams=((2, 1, 1), (5, 1, 0)),
)


def _row(
    section: str, solver: str, value: int, variables: int | None, known: dict[int, float],
    attempts: Sequence[Attempt],
) -> dict[str, Any]:  # fmt: skip
    figures = summary([a.to_dict() for a in attempts], known)
    return {'section': section, 'solver': solver, 'value': value, 'variables': variables} | figures


def nodes(extent: Extent) -> Rows:
    """Collocation on more and more intervals; this package's quadrature nodes for the robots."""
    rows: Rows = []
    for regime in REGIMES:
        for count in extent.pendulum_nodes:
            report(f'pendulum {regime}, {count} intervals')
            pendulum = PendulumCases(regime, count)
            solve = pendulum.methods()[SWING]
            attempts = [solve(case) for case in range(extent.cases)]
            row = _row(
                f'pendulum, {regime} torque', 'collocation', count,
                pendulum.collocation.solver.variables, best_known(regime), attempts,
            )  # fmt: skip
            rows.append(row | {'build_s': pendulum.collocation.build_seconds})
    known = references()
    for intervals in extent.robot_nodes:
        report(f'3 robots, {intervals[0]} intervals')
        robots = RobotsCases(3, intervals)
        count = extent.dense_cases if intervals[0] > 30 else extent.cases
        attempts = [robots.collocate(case, 0.0) for case in range(count)]
        row = _row(
            '3 robots', 'collocation', intervals[0], robots.collocation.solver.variables,
            known, attempts,
        )  # fmt: skip
        rows.append(row | {'build_s': robots.collocation.build_seconds})
    for count in extent.quadrature_nodes:
        report(f'3 robots, {count} nodes of the quadrature')
        attempts = [robots.ours(case, None, nodes=count) for case in range(extent.cases)]
        rows.append(_row('3 robots', 'tdm_planner', count, None, known, attempts))
    return rows


def parameters(extent: Extent) -> Rows:
    """More and more varied parameters of this package's two problems."""
    rows: Rows = []
    robots, known = RobotsCases(3), references()
    for ends, order in extent.shapes:
        report(f'3 robots, order {order}, end accelerations {ends}')
        changes: dict[str, Any] = {'end_accelerations': ends, 'polynomial_order': order}
        size = robots.problem(0, **changes).solve(DEADLINE).parameters.size
        attempts = [robots.ours(case, None, **changes) for case in range(extent.cases)]
        rows.append(_row('3 robots', 'tdm_planner', order, size, known, attempts))
    for regime in REGIMES:
        for arcs in extent.arcs:
            report(f'pendulum {regime}, at most {arcs} arcs')
            attempts = [_arcs(regime, arcs, case) for case in range(extent.cases)]
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


def teams(extent: Extent) -> Rows:
    """More and more robots, costs relative to this package's."""
    rows: Rows = []
    for n, count, tried in extent.teams:
        report(f'{n} robots')
        intervals = (30, 4) if n <= 3 else (30, 2)
        robots = RobotsCases(n, intervals if tried else (3, 1), _COLLOCATION_LONGEST)
        ours = [robots.ours(case, None) for case in range(count)]
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
