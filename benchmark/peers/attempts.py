# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""One solver, one case: what came out, whether it holds when flown; and the figures of many."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

from benchmark.measuring import report, timed
import numpy as np
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

OURS, OURS_WARM, COLLOCATION_WARM = 'tdm_planner', 'tdm_planner, warm', 'collocation, warm'


@dataclass(frozen=True)
class Attempt:
    """
    What a solver made of a case.

    `solved`: the controls, flown through the true dynamics, reach the goal within limits;
    `converged`: the solver says it is done. `seconds` is processor time, of the solver alone for
    peers (without building expressions, guessing and judging); `cost` that of the motion flown;
    `iterations` of the solver, evaluations of the dynamics along a candidate for this package.
    """

    case: int
    converged: bool
    solved: bool
    seconds: float
    iterations: int | None = None
    cost: float | None = None
    reason: str = ''


Method = Callable[[int], Attempt]


class Cases(ABC):
    """
    The solvers of one family of problems; the `collocation`'s program is built once.

    `guesses` are where collocation starts, made from a case's task; `deadline` [s] is for solving.
    """

    deadline: float
    collocation: Any
    guesses: Mapping[str, Callable[[Any], Any]]

    def __init__(self) -> None:
        self.problem(0).solve(self.deadline)  # compiles
        self.neighbour = lru_cache(maxsize=1)(self._neighbour)

    @abstractmethod
    def problem(self, case: int, near: bool = False) -> Any:
        """Return the problem of a case, or one with a start nearby."""

    @staticmethod
    @abstractmethod
    def judge(task: Any, motions: Mapping[str, Trajectory]) -> tuple[tuple[str, ...], float]:
        """Return the reasons why motions do not solve a task, and their cost."""

    def methods(self) -> dict[str, Method]:
        """Return every solver by name."""
        return {
            OURS: self.ours,
            OURS_WARM: lambda case: self.ours(case, self.neighbour(case)),
            **{name: partial(self.collocate, name) for name in self.guesses},
            COLLOCATION_WARM: self.collocate_warm,
        }

    def ours(self, case: int, earlier: Solution | None = None) -> Attempt:
        """Solve by this package, from an earlier plan if given."""
        problem = self.problem(case)
        plan, error, _, seconds = timed(problem, self.deadline, seed=0, warm_start=earlier)
        if plan is None:
            return Attempt(case, False, False, seconds, reason=str(error))
        reasons, cost = self.judge(problem.task, plan.trajectories)
        reason = '; '.join(reasons)
        return Attempt(case, True, not reasons, seconds, plan.evaluations, cost, reason)

    def _neighbour(self, case: int) -> Solution | None:
        return timed(self.problem(case, near=True), self.deadline, seed=0).plan

    def collocate(self, name: str, case: int) -> Attempt:
        """Solve by collocation from the guess of a name."""
        return self._collocate(case, self.guesses[name](self.problem(case).task))

    def collocate_warm(self, case: int) -> Attempt:
        """
        Solve from the optimum, with multipliers, of collocation for the neighbouring case.

        That in turn starts from this package's plan for it: warm starts are not to suffer from
        cold ones.
        """
        earlier = self.neighbour(case)
        if earlier is None:
            return Attempt(case, False, False, 0.0, reason='no neighbouring plan')
        task = self.problem(case, near=True).task
        guess = self.collocation.guess_plan(task, earlier.trajectories)
        near = self.collocation.solve(task, guess)
        return self._collocate(case, near if near.converged else guess, warm=True)

    def _collocate(self, case: int, guess: Any, warm: bool = False) -> Attempt:
        task = self.problem(case).task
        outcome = self.collocation.solve(task, guess, warm)
        reasons, cost = self.judge(task, self.collocation.motions(task, outcome))
        return Attempt(
            case=case,
            converged=outcome.converged,
            solved=outcome.converged and not reasons,
            seconds=outcome.seconds,
            iterations=outcome.iterations,
            cost=cost,
            reason='; '.join(reasons) if outcome.converged else outcome.status,
        )


def best_of(attempts: Sequence[Attempt]) -> Attempt:
    """Return what trying several guesses gives: the cheapest that is solved, all their time."""
    solved = [a for a in attempts if a.solved]
    iterations = [a.iterations for a in attempts if a.iterations is not None]
    return Attempt(
        case=attempts[0].case,
        converged=any(a.converged for a in attempts),
        solved=bool(solved),
        seconds=sum(a.seconds for a in attempts),
        iterations=sum(iterations) if iterations else None,
        cost=min((a.cost for a in solved if a.cost is not None), default=None),
        reason='' if solved else attempts[0].reason,
    )


def alternate(methods: Mapping[str, Method], cases: Sequence[int]) -> dict[str, list[Attempt]]:
    """Solve every case by every method in turn, each time beginning with another one."""
    names = list(methods)
    found: dict[str, list[Attempt]] = {name: [] for name in names}
    for count, case in enumerate(cases):
        turn = count % len(names)
        for name in names[turn:] + names[:turn]:
            report(f'case {count + 1} of {len(cases)}: {name}')
            found[name].append(methods[name](case))
    return found


def summary(attempts: Sequence[Mapping[str, Any]], known: Mapping[int, float]) -> dict[str, Any]:
    """Figures of attempts (as dictionaries), costs relative to the best `known`."""
    solved = [a for a in attempts if a['solved']]
    ratios = np.array([a['cost'] / known[a['case']] for a in solved if a['case'] in known])
    seconds = np.array([a['seconds'] for a in attempts])
    iterations = [a['iterations'] for a in solved if a['iterations'] is not None]
    count = len(attempts)
    return {
        'cases': count,
        'converged': sum(a['converged'] for a in attempts) / count,
        'solved': len(solved) / count,
        'near': float((ratios <= 1.02).sum()) / count if ratios.size else None,
        'ratio_median': float(np.median(ratios)) if ratios.size else None,
        'ratio_p95': float(np.quantile(ratios, 0.95)) if ratios.size else None,
        'ms_median': 1e3 * float(np.median(seconds)),
        'ms_p95': 1e3 * float(np.quantile(seconds, 0.95)),
        'iterations': float(np.median(iterations)) if iterations else None,
    }


def against(
    ours: Sequence[Mapping[str, Any]], theirs: Sequence[Mapping[str, Any]]
) -> dict[str, float | None]:
    """Medians of their time and cost over ours: time on the same cases, cost where both solve."""
    mine = {a['case']: a for a in ours}
    times = [a['seconds'] / mine[a['case']]['seconds'] for a in theirs]
    costs = [
        a['cost'] / mine[a['case']]['cost']
        for a in theirs
        if a['solved'] and mine[a['case']]['solved']
    ]
    return {
        'time': float(np.median(times)) if times else None,
        'cost': float(np.median(costs)) if costs else None,
    }
