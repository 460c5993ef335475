# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plans of problems that bring no model of their tracker: either they are followed, or left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning.execution import ActivePlan, Execution, Observation, Outlook, Predicted
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import replay

Array = NDArray[np.float64]

VEHICLE: Final = 'plant'  # the name of the only observation
_START = 'start.'


class GenericExecution(Execution):
    """
    A controller of which nothing is known follows the plan; after its end nothing does.

    An observation's state holds the numbers measured: those of the problem's parameters `start.X`
    for the `names` X, in their order. Where X is a state of the plan, it is compared with it:
    beyond `tolerance`, a share of the largest range that states of its unit run through, the plan
    was left and a new one is necessary.
    """

    holds_goal: ClassVar[bool] = False

    def __init__(self, names: Sequence[str], tolerance: float) -> None:
        self._names = tuple(names)
        self.tolerance = tolerance

    def adopt(self, plan: ActivePlan) -> None:
        """Nothing to be done."""

    def predict(
        self, plan: ActivePlan, observations: Mapping[str, Observation], at: float
    ) -> dict[str, Predicted]:
        """Fly on under the planned controls, or carry the deviation from the plan along."""
        seen = observations[VEHICLE]
        motion = plan.solution.trajectory
        flown = self._flown(plan, seen, at)
        if flown is None:
            flown = seen.state.copy()
            now, then = (motion.sample(plan.elapsed(t)).state for t in (seen.stamp, at))
            for number, state in self._compared(motion):
                flown[number] += then[state] - now[state]
        control = motion.sample(plan.elapsed(at)).control
        return {VEHICLE: Predicted(flown, control, seen.mode)}

    def _flown(self, plan: ActivePlan, seen: Observation, at: float) -> Array | None:
        """Measured numbers at the instant `at` by the equations of motion, where all are known."""
        motion, problem = plan.solution.trajectory, plan.problem
        since, wait = plan.elapsed(seen.stamp), at - seen.stamp
        order = [self._names.index(name) for name in motion.state_names if name in self._names]
        complete = len(order) == len(motion.state_names) == len(self._names)
        inside = since >= 0.0 and since + wait < motion.duration and wait > 0.0
        if not (complete and inside and isinstance(problem, DirectProblem)):
            return None
        rest = motion.after(since)
        states = rest.states.copy()
        states[0] = seen.state[order]
        # As smooth as the whole: a spline through the few samples left is another one.
        flight = replace(rest, states=states)
        found = np.empty_like(seen.state)
        found[order] = replay(DirectPlant(problem), flight, np.array([wait]))[-1]
        return found if np.isfinite(found).all() else None

    def outlook(self, plan: ActivePlan, predicted: Mapping[str, Predicted], at: float) -> Outlook:
        """Compare the state with the plan; its cost to go is the problem's to say."""
        motion, now = plan.solution.trajectory, predicted[VEHICLE]
        elapsed = plan.elapsed(at)
        cost = plan.problem.cost_to_go(plan.solution, elapsed)
        # Where it is not known, no plan can be said to be cheaper.
        outlook = Outlook(0.0 if cost is None else cost, settled=elapsed >= motion.duration)
        reference, ranges = motion.sample(elapsed).state, ranges_of(motion)
        for number, state in self._compared(motion):
            away = float(now.state[number] - reference[state])
            if abs(away) > self.tolerance * ranges[state] > 0.0:
                unit = motion.units.get(motion.state_names[state], '')
                size = f'{abs(away):.3g} {unit}'.rstrip()
                name = motion.state_names[state]
                return replace(outlook, failure=f"'{name}' is {size} away from the active plan")
        return outlook

    def _compared(self, motion: Trajectory) -> list[tuple[int, int]]:
        """Where a measured number is, and which state of the plan it is."""
        states = motion.state_names
        return [(i, states.index(name)) for i, name in enumerate(self._names) if name in states]

    def problem_from(self, problem: Problem, predicted: Mapping[str, Predicted]) -> Problem:
        """Return the same problem, with the predicted state as its start."""
        numbers = zip(self._names, predicted[VEHICLE].state.tolist(), strict=True)
        starts = {_START + name: value for name, value in numbers}
        return type(problem).from_parameters({**problem.to_parameters(), **starts})

    def same_question(self, problem: Problem, other: Problem) -> bool:
        """Whether two problems differ in nothing but their start and how they are solved."""
        return type(problem) is type(other) and _asked(problem) == _asked(other)


def _asked(problem: Problem) -> dict[str, Any]:
    parameters = problem.to_parameters()
    return {n: x for n, x in parameters.items() if not n.startswith((_START, 'solver.'))}


def ranges_of(motion: Trajectory) -> Array:
    """Return the largest range of a state of the same unit, for every state (nx,)."""
    ranges = np.ptp(motion.states, axis=0)
    units = [motion.units.get(name) for name in motion.state_names]
    alike = [[k for k, other in enumerate(units) if other == unit and unit] for unit in units]
    return np.array([ranges[same or [i]].max() for i, same in enumerate(alike)])
