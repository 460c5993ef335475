# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Receding horizon: look at the active plan, plan anew from where it leads, decide.

A review at the instant t plans from the state predicted for t + `delay`, when a new plan would
begin: until then the old one is executed. Solving has that much time, less what publishing and
accepting a plan take.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
import time
from typing import Any, Final

from tdm_planner.exceptions import TdmError
from tdm_planner.problems.planner_parameters import ReplanParameters
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning.execution import (
    Execution,
    Observation,
    Outlook,
    Predicted,
    TimedPlan,
)
from tdm_planner.tracking.motion import ObservedPhase

LEAST_LEFT: Final = 0.25  # of the whole cost; with less to come a plan is kept if it will do
SAME_START: Final = 1e-6  # s; instants are told in nanoseconds
_SOLVING = 0.7  # of the delay; the rest is for publishing, and for the tracker to prepare
_SELDOM = 0.1  # of a plan's duration: the least time between looks for a better one
_OPTIONAL = 0.5  # of the time for solving, where the active plan would do
_TAKEN_OVER = 0.1  # s after a plan's start until its trackers must have told that they follow it
_REMEMBERED = 16  # plans before the newest, that trackers may have kept


def decide(outlook: Outlook, changed: bool, cost: float, improvement: float) -> tuple[bool, str]:
    """
    Keep the active plan unless another one is necessary, or cheaper by a margin.

    `changed` says that another goal or other limits are asked for than those of the active plan;
    `cost` is that of the new plan; `improvement` the share of the cost still to come that it must
    save where the old plan would do. Returns whether it supersedes, and why.
    """
    if changed:
        return True, 'the problem has changed'
    if outlook.failure:
        return True, outlook.failure
    saved = 1.0 - cost / outlook.cost if outlook.cost > 0.0 else 0.0
    if saved > improvement:
        return True, f'it saves {saved:.0%} of the cost still to come'
    return False, 'the active plan does'


def is_same_task(problem: Problem, other: Problem) -> bool:
    """Whether two problems differ in nothing but their start and how they are solved."""
    return type(problem) is type(other) and _asked(problem) == _asked(other)


def _asked(problem: Problem) -> dict[str, Any]:
    return {
        name: value
        for name, value in problem.to_parameters().items()
        if '.start.' not in f'.{name}' and not name.startswith('solver.')
    }


class PublishedPlans:
    """The plans published last; which of them is followed, only trackers know. Any thread."""

    def __init__(self) -> None:
        self._plans: tuple[TimedPlan, ...] = ()  # in the order of publication

    @property
    def newest(self) -> TimedPlan | None:
        """Return the plan that was published last."""
        return self._plans[-1] if self._plans else None

    def add(self, plan: TimedPlan) -> None:
        """Add a plan that is published."""
        self._plans = (*self._plans[-_REMEMBERED:], plan)

    def starting(self, start: float | None) -> TimedPlan | None:
        """Return the plan that starts at an instant [s]; None if it is none of these."""
        for plan in reversed(self._plans):
            if start is not None and abs(plan.start - start) < SAME_START:
                return plan
        return None

    def reviewed(
        self, observations: Mapping[str, Observation], now: float
    ) -> tuple[TimedPlan | None, str]:
        """
        Return the plan to review at the instant `now` [s], and what is known to be wrong with it.

        It is the newest, unless all trackers tell that they follow an earlier one: they reject
        plans that begin too far from where the plant is. None, and why, where it has not begun, or
        another planner's plan is followed.
        """
        newest = self.newest
        if newest is None or now < newest.start:
            return None, 'no plan is under way'
        told = {n: seen.followed for n, seen in observations.items() if seen.followed is not None}
        followed = {name: self.starting(start) for name, start in told.items()}
        kept = [name for name, plan in followed.items() if plan is not newest]
        if not kept:
            return newest, ''
        if now < newest.start + _TAKEN_OVER:
            return None, 'the newest plan is not followed yet'
        if foreign := [name for name in kept if followed[name] is None]:
            return None, f"'{foreign[0]}' follows the plan of another planner"
        earlier = followed[kept[0]]
        if len(kept) == len(observations) and {*followed.values()} == {earlier}:
            return earlier, ''
        return newest, f"'{kept[0]}' has kept the plan before the active one"


@dataclass(frozen=True, eq=False)
class Review:
    """
    The outcome of a review; `plan` is the one to take over, None if the old one is kept.

    `necessary` says that the old one fails or answers another question; `solve_time` [s] is 0
    where nothing had to be solved.
    """

    plan: TimedPlan | None
    reason: str
    necessary: bool = False
    solve_time: float = 0.0


class Replanner:
    """Reviews a plan under way again and again: that of `execution`."""

    def __init__(self, execution: Execution, parameters: ReplanParameters) -> None:
        self.execution = execution
        self.parameters = parameters
        self._reviews = 0
        self._improved_at = -math.inf

    def review(
        self,
        problem: Problem,
        observations: Mapping[str, Observation],
        now: float,
        failure: str = '',
    ) -> Review:
        """
        Review the plan at the instant `now` [s] for the `problem` asked at present.

        `failure` says what is known to be wrong with the plan, '' if nothing is. Only the start of
        the problem is replaced. A plan returned is verified; its motion starts `delay` after
        `now`.
        """
        plan = self.execution.plan
        if not self.execution.holds_goal and now >= plan.end:
            return Review(None, 'the plan has come to its end')
        began = time.perf_counter()
        at = now + self.parameters.delay
        predicted = self.execution.predict(observations, at)
        outlook = self.execution.outlook(predicted, at)
        if failure:
            outlook = replace(outlook, failure=failure, settled=False)
        changed = not is_same_task(problem, plan.problem)
        necessary = changed or bool(outlook.failure)
        if not (necessary or self._may_improve(outlook, now)):
            return Review(None, 'the active plan does')
        allowed = _SOLVING * self.parameters.delay * (1.0 if necessary else _OPTIONAL)
        allowed -= time.perf_counter() - began
        try:
            new_problem = self.execution.problem_from(problem, predicted)
            new = self._solve(new_problem, predicted, at, allowed)
        except TdmError as error:
            spent = time.perf_counter() - began
            return Review(None, f'{error.code}: {error}', necessary, spent)
        supersedes, reason = decide(outlook, changed, new.cost, self.parameters.improvement)
        taking_over = None
        if supersedes:
            # A new swing-up after a fall, or another goal, is a new way; else it is the rest.
            whole = None if new.cost > plan.whole_cost or changed else plan.whole_cost
            taking_over = TimedPlan(new_problem, new, at, whole, plan.request_parameters)
        return Review(taking_over, reason, necessary, time.perf_counter() - began)

    def _may_improve(self, outlook: Outlook, now: float) -> bool:
        """
        Whether to look for a better plan though the old one does: not often, it costs time.

        Near the goal the little cost that is left is no reason: noise makes it more or less.
        """
        plan = self.execution.plan
        little = outlook.settled or outlook.cost <= LEAST_LEFT * plan.whole_cost
        if little or self.parameters.improvement >= 1.0:
            return False
        if now - self._improved_at < _SELDOM * plan.solution.duration:
            return False
        self._improved_at = now
        return True

    def _solve(
        self,
        problem: Problem,
        predicted: Mapping[str, Predicted],
        at: float,
        allowed: float,
    ) -> Solution:
        followed = all(vehicle.phase is ObservedPhase.FOLLOWING for vehicle in predicted.values())
        # Another seed each time: what was not found at the last review may be found now.
        self._reviews += 1
        return problem.solve(
            deadline=max(allowed, 1e-3),
            seed=problem.solver.seed + self._reviews,
            warm_start=self.execution.plan.remainder(at) if followed else None,
        )
