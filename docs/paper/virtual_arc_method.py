# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Method `virtual_arc`: the paper's scheme (9)-(16) in a form that works, for monotone transfers.

Random switches along the virtual arc are minimised at ever lower floors of the speed, then with
more nodes. What comes out is a list of switching times, exact up to the scheme's second order; the
Levenberg-Marquardt iteration of method `switching` takes off that rest, without minimising
anything, and the plan counts only if theta is monotone still.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, VerificationFailed
from tdm_planner.problems import Solution
from tdm_planner.problems.pendulum.candidates import (
    Candidate,
    FINE_STEPS,
    ONE_ROUND,
    shoot_upright,
    trajectory,
)
from tdm_planner.problems.pendulum.shooting import Steps
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.problems.problem import Search
from tdm_planner.trajectory import Trajectory
from virtual_arc_program import VirtualArcProgram

Array = NDArray[np.float64]

_STARTS = 60  # random starts at most,
_CONVINCING = 12  # and so many of them without a result count as a reason to give up
_ENOUGH = 3  # results, of which the quickest is taken
_SEARCH_SHARE, _ENOUGH_SHARE = 0.85, 0.5  # of the deadline: no more starts; none if one led on
_FLOORS = (1.0, 0.1)  # of the speed in units of w0, before the least
_HOPELESS = 0.3  # violation at a floor that the next one does not mend
_PROMISING = 1e-2  # violation that more time might have brought to nothing
_COARSE_STEPS = 10  # nodes an arc while searching,
_REFINED_STEPS = (20, 40, 80)  # and of the refinement
_FEWEST_ARCS, _MOST_RANDOM_ARCS = 4, 6
_FEASIBLE, _CORRECTABLE = 1e-6, 1e-2  # violation of a result, and of one with more nodes
_BACKWARDS = 1e-3  # [rad/s] that theta' may have the wrong sign by where it vanishes


@dataclass(frozen=True, eq=False)
class ArcCandidate:
    """A feasible point of a program: switches along the virtual arc."""

    program: VirtualArcProgram
    point: Array
    cost: float


class VirtualArcMethod(Search[ArcCandidate]):
    """The search for switches along a monotone virtual arc; `arcs` is the most arcs of a plan."""

    def __init__(
        self,
        task: SwingUpTask,
        budget: Budget,
        rng: np.random.Generator,
        arcs: int,
        tolerance: float,
    ) -> None:
        super().__init__(budget)
        self._task = task
        self._rng = rng
        self._most_arcs = min(arcs, _MOST_RANDOM_ARCS)
        self._feasibility = max(tolerance, 1e-9)
        self._starts = 0
        self._closest = math.inf

    def candidates(self) -> list[ArcCandidate]:
        """Minimise from random starts; the feasible results, quickest first."""
        found: list[ArcCandidate] = []
        budget, goals = self.budget, self.goals()
        while goals and self._starts < _STARTS and len(found) < _ENOUGH:
            share = _ENOUGH_SHARE if found else _SEARCH_SHARE
            if budget.elapsed > share * budget.seconds:
                break
            self._starts += 1
            candidate = self._descend(int(self._rng.choice(goals)))
            if candidate is not None:
                found.append(candidate)
        return sorted(found, key=lambda candidate: candidate.cost)

    def plans(self, candidate: ArcCandidate) -> Iterator[Solution]:
        """Yield the motion under the switching times found with more and more nodes."""
        program, xi = candidate.program, candidate.point
        for steps in _REFINED_STEPS:
            program = VirtualArcProgram(self._task, program.torques, program.turns, steps)
            minimum = self._minimise(program, xi, self._feasibility, radius=0.05)
            if minimum.point.violation > _CORRECTABLE:
                self.rejected = f'with {steps} nodes an arc no transfer is left of it'
                return
            xi = minimum.point.xi
            motion = self._landed(program, xi)
            if motion is None:
                self.rejected = f'with {steps} nodes an arc the plant misses upright'
            elif not self._monotone(motion):
                self.rejected = 'the plant turns back on the way'
            else:
                yield self._task.plan(motion, xi, minimum.point.violation)
            if self.budget.spent:
                return

    def widen(self) -> bool:
        """Give up: random starts are all alike."""
        return False

    def failure(self) -> Infeasible:
        """Return why there is no monotone transfer, or none was found."""
        remedy = "; method 'switching' has no such restriction"
        if not self.goals():
            return Infeasible(
                "method 'virtual_arc' needs theta to go one way all along, but the pendulum "
                f'starts with theta_dot = {self._task.start[2]:g} rad/s away from goal.turns = '
                f'{self._task.turns}{remedy}'
            )
        if self.rejected:
            return VerificationFailed(
                f'monotone transfers were found, but none that passes the check: {self.rejected}'
            )
        nearest = ''
        if math.isfinite(self._closest):
            nearest = f' (the least violation was {self._closest:.2g})'
        reason = (
            f'none of {self._starts} starts gave a transfer in which theta goes one way all '
            f'along, as a virtual arc must{nearest}: {self._task.planned_torque:.3g} N m '
            f'(limits.torque less torque_reserve) may not do it without swinging back{remedy}'
        )
        cut_short = self._starts < _CONVINCING or self._closest < _PROMISING
        if cut_short and self._starts < _STARTS:
            return DeadlineExceeded(f'in {self.budget.seconds:g} s, {reason}')
        return Infeasible(reason)

    def goals(self) -> list[int]:
        """Return the n of theta = 2 pi n that lie ahead; the nearest two either way if at rest."""
        theta, _, theta_dot, _ = self._task.start.tolist()
        here = theta / (2 * math.pi)
        above, below = math.floor(here + 1e-9) + 1, math.ceil(here - 1e-9) - 1
        if self._task.turns is not None:
            above = below = self._task.turns
        ahead = [above] * (theta_dot >= 0.0 and above > here)
        ahead += [below] * (theta_dot <= 0.0 and below < here)
        return ahead

    def _descend(self, turns: int) -> ArcCandidate | None:
        """Minimise from random switches, first with the speed kept up, then less and less."""
        task, rng = self._task, self._rng
        arcs = int(rng.integers(_FEWEST_ARCS, self._most_arcs + 1))
        torques = task.planned_torque * rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(arcs)
        xi: Array = rng.dirichlet(np.full(arcs, 2.0))[:-1]
        for floor in _FLOORS:
            program = VirtualArcProgram(task, torques, turns, _COARSE_STEPS, floor)
            roughly = self._minimise(program, xi, 1e-3, 20).point
            if not roughly.violation < _HOPELESS:
                return None
            xi = roughly.xi
        program = VirtualArcProgram(task, torques, turns, _COARSE_STEPS)
        point = self._minimise(program, xi, self._feasibility, 50).point
        self._closest = min(self._closest, point.violation)
        return ArcCandidate(program, point.xi, point.cost) if point.violation < _FEASIBLE else None

    def _minimise(
        self,
        program: VirtualArcProgram,
        xi: Array,
        feasibility: float,
        iterations: int = 40,
        radius: float = 0.3,
    ) -> Minimum[VirtualArcProgram]:
        options = TrustRegionOptions(
            penalties=(30.0, 30.0),
            radius=radius,
            iterations=iterations,
            cost_tolerance=1e-4 if feasibility < _FEASIBLE else 1e-2,
            feasibility=(feasibility, feasibility),
            corrections=3,
        )
        with np.errstate(all='ignore'):
            return minimise(program, xi, options, self.budget)

    def _landed(self, program: VirtualArcProgram, xi: Array) -> Trajectory | None:
        """Return the plant's motion under the switching times, corrected until it ends upright."""
        durations = np.maximum(program.durations(xi), 0.0)
        arcs = Candidate(durations, program.torques, program.turns)
        task, until = replace(self._task, turns=program.turns), self.budget.part(math.inf)
        arrived = shoot_upright(task, [arcs], Steps(FINE_STEPS), until, rounds=ONE_ROUND)
        return trajectory(self._task, arrived[0]) if arrived else None

    def _monotone(self, motion: Trajectory) -> bool:
        theta_dot = motion.state('theta_dot')
        way = math.copysign(1.0, motion.states[-1, 0] - motion.states[0, 0])
        return bool((way * theta_dot > -_BACKWARDS).all())
