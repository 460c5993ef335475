# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
How plans are executed: what is known of the active one, and what becomes of it.

An `Execution` predicts the plant's state under the trackers at a plan's start. That of a problem
which brings no model of its tracker knows plans that are followed, and plans that were left.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
import math
from typing import Any, ClassVar, Final

import numpy as np
from tdm_planner.arrays import Array, largest_of_unit
from tdm_planner.exceptions import NotFinite, VerificationFailed
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.tracking.motion import ObservedPhase
from tdm_planner.trajectory import Sample, TimedTrajectory, Trajectory

PLANT_NAME: Final = 'plant'  # the name of the only observation
START: Final = 'start.'
_SHORTEST = 1e-3  # s; a shorter rest gives no initial guess


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


@dataclass(frozen=True, eq=False)
class TimedPlan:
    """
    A verified plan and the problem it solves; its motion starts at the instant `start` [s].

    It may be active, pending, or not published yet.

    `earlier_cost` is that of the plan for the whole way, where this one was made on it; its own
    by default. `request_parameters` are those given for this plan alone, by name.

    Raise VerificationFailed where a user's problem returns a plan that did not pass its check.
    """

    problem: Problem
    solution: Solution
    start: float
    earlier_cost: float | None = None
    request_parameters: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that it is verified: what is published is made of this."""
        if not self.solution.verification.ok:
            why = '; '.join(self.solution.verification.reasons) or 'it gives no reasons'
            raise VerificationFailed(f'the plan is not verified: {why}')

    @property
    def whole_cost(self) -> float:
        """Cost of the whole way, of which this plan may be the last part."""
        return self.solution.cost if self.earlier_cost is None else self.earlier_cost

    @property
    def end(self) -> float:
        """Instant at which the last vehicle arrives [s]."""
        return self.start + self.solution.duration

    def motion(self, vehicle: str) -> TimedTrajectory:
        """Return this vehicle's motion; a plan for a single vehicle ignores the name."""
        known = vehicle in self.solution.trajectories
        motion = self.solution.trajectories[vehicle] if known else self.solution.trajectory
        return TimedTrajectory(motion, self.start)

    def elapsed(self, time: float) -> float:
        """Time since the start of the motion [s] at an instant [s]."""
        return time - self.start

    def remainder(self, time: float) -> Solution | None:
        """
        Return what is left of the plan at the instant `time` [s], to start a new one from.

        Its trajectories begin at zero again; `parameters` stay those of the whole plan.
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


@dataclass(frozen=True, eq=False)
class Observation:
    """
    A vehicle's newest measured state (nx,), its instant `stamp` [s], its tracker's `phase`.

    `followed` is the start [s] of the plan that the tracker says it follows; None where it follows
    none, or does not tell.
    """

    state: Array
    stamp: float
    phase: ObservedPhase
    followed: float | None = None


@dataclass(frozen=True, eq=False)
class Predicted:
    """
    State (nx,) of a vehicle at a later instant, and the controls (nu,) that act there.

    `arrived` is the time [s] since the plan's arrival at its goal, 0 on the way. `planned` is what
    the plan has at that instant, where a new plan is to start from there instead of from `state`.
    """

    state: Array
    control: Array
    phase: ObservedPhase
    arrived: float = 0.0
    planned: Sample | None = None


class Execution(ABC):
    """
    What the trackers of one kind of problem make of a `plan`, by the same laws as theirs.

    `holds_goal` says that the goal is held after a plan's end, so that it is active until the
    next.
    """

    holds_goal: ClassVar[bool] = True

    def __init__(self, plan: TimedPlan) -> None:
        self.plan = plan

    @abstractmethod
    def predict(self, observations: Mapping[str, Observation], at: float) -> dict[str, Predicted]:
        """States at the instant `at` [s], by vehicle: measured, then moved under the feedback."""

    @abstractmethod
    def outlook(self, predicted: Mapping[str, Predicted], at: float) -> Outlook:
        """Return what becomes of the plan if it is carried on from the instant `at`."""

    @abstractmethod
    def problem_from(self, problem: Any, predicted: Mapping[str, Predicted]) -> Problem:
        """
        Return the same problem, with the predicted states as its start.

        Raise InvalidProblem if they contradict the limits.
        """


class GenericExecution(Execution):
    """
    A controller of which nothing is known follows the plan; after its end nothing does.

    An observation's state holds the numbers measured: those of the problem's parameters `start.X`
    for the `names` X, in their order. Where X is a state of the plan, it is compared with it:
    beyond `tolerance`, a share of the largest range that states of its unit run through, the plan
    was left and a new one is necessary.
    """

    holds_goal: ClassVar[bool] = False

    def __init__(self, plan: TimedPlan, names: Sequence[str], tolerance: float) -> None:
        super().__init__(plan)
        self._names, self._tolerance = tuple(names), tolerance
        self._motion = motion = plan.solution.trajectory
        states = motion.state_names
        # Where a measured number is, and which state of the plan it is.
        self._compared = [(i, states.index(n)) for i, n in enumerate(self._names) if n in states]

    def predict(self, observations: Mapping[str, Observation], at: float) -> dict[str, Predicted]:
        """Fly on under the planned controls, or carry the deviation from the plan along."""
        seen, motion, elapsed = observations[PLANT_NAME], self._motion, self.plan.elapsed
        flown = self._flown(seen, at)
        if flown is None:
            flown = seen.state.copy()
            now, then = (motion.sample(elapsed(t)).state for t in (seen.stamp, at))
            for number, state in self._compared:
                flown[number] += then[state] - now[state]
        control = motion.sample(elapsed(at)).control
        return {PLANT_NAME: Predicted(flown, control, seen.phase)}

    def _flown(self, seen: Observation, at: float) -> Array | None:
        """Measured numbers at the instant `at` by the equations of motion, where all are known."""
        motion, problem = self._motion, self.plan.problem
        since, wait = self.plan.elapsed(seen.stamp), at - seen.stamp
        order = [self._names.index(name) for name in motion.state_names if name in self._names]
        complete = len(order) == len(motion.state_names) == len(self._names)
        inside = since >= 0.0 and since + wait < motion.duration and wait > 0.0
        if not (complete and inside and isinstance(problem, DirectProblem)):
            return None
        rest = motion.after(since)
        states = rest.states.copy()
        states[0] = seen.state[order]
        followed = seen.phase is ObservedPhase.FOLLOWING  # else nothing is commanded
        # As smooth as the whole: a spline through the few samples left is another one.
        moved = replace(rest, states=states, controls=followed * rest.controls)
        found = np.empty_like(seen.state)
        with suppress(NotFinite):
            found[order] = DirectPlant(problem).replay(moved).states(np.array([wait]))[-1]
            return found
        return None

    def outlook(self, predicted: Mapping[str, Predicted], at: float) -> Outlook:
        """Compare the state with the plan; its cost to go is the problem's to say."""
        plan, motion, now = self.plan, self._motion, predicted[PLANT_NAME]
        elapsed = plan.elapsed(at)
        cost = plan.problem.cost_to_go(plan.solution, elapsed)
        # Where it is not known, no plan can be said to be cheaper.
        outlook = Outlook(0.0 if cost is None else cost, settled=elapsed >= motion.duration)
        if now.phase is not ObservedPhase.FOLLOWING:
            return replace(outlook, failure='the active plan is not followed any more')
        reference, ranges = motion.sample(elapsed).state, ranges_of(motion)
        for number, state in self._compared:
            away = float(now.state[number] - reference[state])
            if abs(away) > self._tolerance * ranges[state] > 0.0:
                name = motion.state_names[state]
                size = f'{abs(away):.3g} {motion.units.get(name, "")}'.rstrip()
                return replace(outlook, failure=f"'{name}' is {size} away from the active plan")
        return outlook

    def problem_from(self, problem: Problem, predicted: Mapping[str, Predicted]) -> Problem:
        """Return the same problem, with the predicted state as its start."""
        numbers = zip(self._names, predicted[PLANT_NAME].state.tolist(), strict=True)
        starts = {START + name: value for name, value in numbers}
        return type(problem).from_parameters({**problem.to_parameters(), **starts})


def ranges_of(motion: Trajectory) -> Array:
    """Return the largest range of a state of the same unit, for every state (nx,)."""
    units = [motion.units.get(name) or name for name in motion.state_names]
    return largest_of_unit(np.ptp(motion.states, axis=0), units)
