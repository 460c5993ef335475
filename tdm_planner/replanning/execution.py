# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
How plans are executed: the active one, and whether a new one supersedes it.

An `Execution` predicts the plant's state under the trackers at a plan's start.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
import math
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Sample, TimedTrajectory

LEAST_LEFT: Final = 0.25  # of the whole cost; with less to come a plan is kept if it will do
_SHORTEST = 1e-3  # s; a shorter rest gives no initial guess
Array = NDArray[np.float64]
_SAME_START = 1e-6  # s; instants are told in nanoseconds


@dataclass(frozen=True)
class Outlook:
    """
    Predicted outcome of the active plan if its execution continues.

    `cost` is the performance index J still to come; `failure` a sentence where the feedback will
    not keep the plant on it, or a limit is endangered, else empty; `settled` says that the
    feedback about the goal has the plant: there is nothing left to plan.
    """

    cost: float = math.inf
    failure: str = ''
    settled: bool = False


@dataclass(frozen=True)
class Decision:
    """Whether the new plan supersedes the active one, and why, or why not."""

    take_over: bool
    reason: str


def worth_improving(outlook: Outlook, whole: float, improvement: float) -> bool:
    """
    Whether a plan that would do has so much cost still to come that a better one may matter.

    `whole` is the cost of the whole way. Near the goal the little that is left is no reason for a
    plan: noise makes it more or less.
    """
    return not outlook.settled and improvement < 1.0 and outlook.cost > LEAST_LEFT * whole


def decide(outlook: Outlook, changed: bool, new: Solution | None, improvement: float) -> Decision:
    """
    Keep the active plan unless a verified one is necessary, or cheaper by a margin.

    `changed` says that another goal or other limits are asked for than those of the active plan;
    `new` is the verified plan found, if any; `improvement` the share of the cost still to come
    that it must save where the old plan would do.
    """
    if new is None:
        return Decision(False, outlook.failure or 'no better plan was found')
    if not new.verification.ok:
        return Decision(False, 'the new plan did not pass its check')
    if changed:
        return Decision(True, 'the problem has changed')
    if outlook.failure:
        return Decision(True, outlook.failure)
    saved = 1.0 - new.cost / outlook.cost if outlook.cost > 0.0 else 0.0
    if saved > improvement:
        return Decision(True, f'it saves {saved:.0%} of the cost still to come')
    return Decision(False, 'the active plan does')


@dataclass(frozen=True, eq=False)
class ActivePlan:
    """
    A verified plan and the problem it solves; its motion starts at the instant `start` [s].

    `whole` is the cost of the plan for the whole way, where this one was made on the way; its own
    by default. `own` are the parameters that were given for this plan alone, by name.
    """

    problem: Problem
    solution: Solution
    start: float
    whole: float | None = None
    own: Mapping[str, Any] = field(default_factory=dict)

    @property
    def whole_cost(self) -> float:
        """Cost of the whole way, of which this plan may be the last part."""
        return self.solution.cost if self.whole is None else self.whole

    @property
    def end(self) -> float:
        """Instant at which the last vehicle arrives [s]."""
        return self.start + self.solution.duration

    def motion(self, vehicle: str) -> TimedTrajectory:
        """Return the motion of one vehicle; of a plan for one, whatever it is called."""
        known = vehicle in self.solution.trajectories
        motion = self.solution.trajectories[vehicle] if known else self.solution.trajectory
        return TimedTrajectory(motion, self.start)

    def elapsed(self, time: float) -> float:
        """Time since the start of the motion [s] at an instant [s]."""
        return time - self.start

    def remainder(self, time: float) -> Solution | None:
        """
        Return what is left of the plan at the instant `time` [s], to start a new one from.

        Its trajectories begin at zero again; switching instants and parameters shift with them.
        None before the start and where (nearly) nothing is left.
        """
        elapsed = self.elapsed(time)
        if elapsed < 0.0 or self.solution.duration - elapsed < _SHORTEST:
            return None
        left = {
            name: trajectory.after(min(elapsed, trajectory.duration - _SHORTEST))
            for name, trajectory in self.solution.trajectories.items()
        }
        return replace(self.solution, trajectories=left)


class Mode(str, Enum):
    """What a tracker does with its plant."""

    FOLLOWING = 'following'  # the active plan, or holding its goal
    RECOVERING = 'recovering'  # the plan was aborted, the plant is brought to rest
    IDLE = 'idle'  # nothing is commanded


@dataclass(frozen=True, eq=False)
class Observation:
    """
    A vehicle's newest measured state (nx,), its instant `stamp` [s], what its tracker does.

    `followed` is the start [s] of the plan that the tracker says it follows; None where it follows
    none, or does not tell.
    """

    state: Array
    stamp: float
    mode: Mode
    followed: float | None = None


@dataclass(frozen=True, eq=False)
class Predicted:
    """
    State (nx,) of a vehicle at a later instant, and the controls (nu,) that act there.

    `arrived` is the time [s] since the plan's arrival at its goal, 0 on the way; `planned` what
    the plan has there, given where the vehicle is to be taken to be on it.
    """

    state: Array
    control: Array
    mode: Mode
    arrived: float = 0.0
    planned: Sample | None = None


class Execution(ABC):
    """
    What the trackers of one kind of problem make of a plan, by the same laws as theirs.

    `holds_goal` says that the goal is held after a plan's end, so that it is active until the
    next.
    """

    holds_goal: ClassVar[bool] = True

    @abstractmethod
    def adopt(self, plan: ActivePlan) -> None:
        """Prepare the execution of a plan (compute its gains)."""

    @abstractmethod
    def predict(
        self, plan: ActivePlan, observations: Mapping[str, Observation], at: float
    ) -> dict[str, Predicted]:
        """States at the instant `at` [s], by vehicle: measured, then moved under the feedback."""

    @abstractmethod
    def outlook(self, plan: ActivePlan, predicted: Mapping[str, Predicted], at: float) -> Outlook:
        """Return what becomes of the active plan if it is carried on from the instant `at`."""

    def keeping(
        self, earlier: ActivePlan, newer: ActivePlan, observations: Mapping[str, Observation]
    ) -> list[str]:
        """
        Return the vehicles whose trackers tell that they follow `earlier`, and not `newer`.

        Trackers reject plans that begin too far from where the plant is.
        """
        return [
            name
            for name, seen in observations.items()
            if seen.followed is not None
            and abs(seen.followed - earlier.start) < _SAME_START < newer.start - earlier.start
        ]

    @abstractmethod
    def problem_from(self, problem: Any, predicted: Mapping[str, Predicted]) -> Problem:
        """
        Return the same problem, with the predicted states as its start.

        Raises
        ------
        InvalidProblem
            If they contradict the limits.

        """

    @abstractmethod
    def same_question(self, problem: Any, other: Any) -> bool:
        """Whether two problems differ in nothing but their start (and how they are solved)."""
