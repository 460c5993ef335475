# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The search for a plan of any formulation: seeds, minimiser, node refinement, verification."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tdm_planner.direct_method.arc_nodes import chebyshev_nodes
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, VerificationFailed
from tdm_planner.plants.base import Plant
from tdm_planner.problems.search import Plan, Search
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from tdm_planner.verification import Constraint, Verification, verify

if TYPE_CHECKING:
    from tdm_planner.problems.direct_problem import DirectProblem

Array = NDArray[np.float64]

_FEASIBLE = 1e-6  # largest violated margin
_MARGIN_TOLERANCE = 1e-5  # of the verification, for what is exactly on a limit
_ROUNDS = 4  # of refinement of one candidate
_WORTHWHILE = 1e-5  # gain in scaled cost for which another candidate is checked
_COARSE_SHARE = 0.85  # of the time allowed, for minimising before any check
_SEARCH_SHARE = 0.6  # of the time allowed, for candidates beside the first


class DirectSearch(Search[Minimum]):
    """Search for the cheapest verified plan of a formulation; `previous` is a first guess Xi."""

    def __init__(
        self,
        problem: DirectProblem,
        plant: Plant,
        budget: Budget,
        rng: np.random.Generator,
        previous: Array | None = None,
    ) -> None:
        super().__init__(budget)
        self._problem = problem
        self._stated = CheckedFormulation(problem)
        self._plant = plant
        self._rng = rng
        self._previous = previous
        self._nodes = self._node_count()
        self._program = Transcription(problem, chebyshev_nodes(self._nodes))
        self._closest = np.inf
        self._nearest_miss = ''

    def candidates(self) -> Iterator[Minimum]:
        """Minimise from all first guesses while there is time.

        Raises
        ------
        InvalidProblem
            If what the problem states does not fit together, or gives numbers that are not finite.
        """
        self._program.begin(self._program.first_guess)
        found = False
        until = Budget(_COARSE_SHARE * self.budget.seconds - self.budget.elapsed)
        for xi in self._seeds():
            late = self.budget.elapsed > _SEARCH_SHARE * self.budget.seconds
            if until.spent or (found and late):
                break
            minimum = self._minimise(self._program, xi, until)
            if minimum is None:
                continue
            if self._feasible(minimum):
                found = True
                yield minimum
            elif minimum.point.violation < self._closest:
                self._closest = minimum.point.violation
                self._nearest_miss = self._name_violation(minimum)

    def promises_more(self, candidate: Minimum, than: Minimum) -> bool:
        """Whether its cost, before refinement, is lower by more than rounding."""
        return candidate.point.cost < than.point.cost - _WORTHWHILE

    def satisfied_with(self, plan: Plan) -> bool:
        """Never: all first guesses are tried."""
        return False

    def widen(self) -> bool:
        """Give up: one round has tried all first guesses."""
        return False

    def failure(self) -> Infeasible:
        """Return what was found and why it does not do, or how near the search came."""
        kind: type[Infeasible] = Infeasible
        if self.rejected:
            kind = VerificationFailed
            reason = f'a candidate was found, but it did not pass the check: {self.rejected}'
        elif self._nearest_miss:
            reason = f'no start gave a feasible motion; the nearest violated {self._nearest_miss}'
        elif self._late:
            reason = 'not one first guess could be followed'
        else:
            reason = 'no first guess gives a motion that is finite everywhere'
        if self._late:
            return DeadlineExceeded(f'in {self.budget.seconds:g} s, {reason}')
        return kind(reason)

    @property
    def _late(self) -> bool:
        return self.budget.elapsed > _COARSE_SHARE * self.budget.seconds

    def _node_count(self) -> int:
        outputs = self._stated.outputs().values()
        free = max(o.free if o.shapes is None else o.shapes.size for o in outputs)
        return max(self._problem.nodes, 3 * free + 15)

    def _seeds(self) -> Iterator[Array]:
        """Yield the previous solution, the plain boundary conditions, and random changes.

        With a previous solution no changes are tried: replanning is to be quick.
        """
        first = self._program.first_guess
        if self._previous is not None and self._previous.shape == first.shape:
            yield self._previous
            yield first
            return
        yield first
        timing = first > 0
        for attempt in range(1, self._problem.starts):
            longer = np.exp(0.4 * self._rng.normal() + 0.2)
            change = min(0.15 * attempt, 1.0) * self._rng.normal(size=first.size)
            yield np.where(timing, first * longer, 3.0 * change / np.sqrt(first.size))

    def _minimise(self, program: Transcription, xi: Array, budget: Budget) -> Minimum | None:
        before = program.evaluations
        if not np.isfinite(program.evaluate(xi).cost):
            return None
        options = TrustRegionOptions(
            penalties=(5.0, 5.0),
            radius=0.5,
            iterations=150,
            cost_tolerance=1e-7,
            feasibility=(self._problem.solver.tolerance, _FEASIBLE),
            corrections=2,
        )
        with np.errstate(all='ignore'):
            minimum = minimise(program, xi, options, budget)
        self.budget.evaluations += program.evaluations - before
        return minimum

    def _feasible(self, minimum: Minimum) -> bool:
        ends, margins = minimum.point.violations
        return bool(ends <= max(self._problem.solver.tolerance, 1e-6) and margins <= 1e-5)

    def _name_violation(self, minimum: Minimum) -> str:
        ends, margins = minimum.point.violations
        if ends > margins:
            return f'the conditions at the end by {ends:.2g}'
        motion = self._program.motion(minimum.point.xi[None])
        margins = self._stated.margins(motion.times, motion.states, motion.controls)
        least = {name: float(np.min(value)) for name, value in margins.items()}
        name = min(least, key=lambda key: least[key])
        return f'{name} by {-least[name]:.2g}'

    def plans(self, candidate: Minimum) -> Iterator[Plan]:
        """Yield the plan; after a failed check with more nodes, or farther off the limits."""
        program, minimum, nodes = self._program, candidate, self._nodes
        reserve: dict[str, float] = {}
        samples = max(201, 4 * nodes + 1)
        for refinement in range(_ROUNDS):
            xi = minimum.point.xi
            trajectory, goal = self._trajectory(xi, samples)
            check = self._verify(trajectory, goal)
            cost = float(program.cost(program.motion(xi[None]))[0])
            yield Plan({self._problem.name: trajectory}, check, cost, xi, minimum.point.violation)
            samples *= 2
            violated = {k: -v for k, v in check.worst.items() if v < -_MARGIN_TOLERANCE}
            if not violated and not program.integrated:
                continue  # more samples are all that is wanted
            # What twice the nodes leave of a quadratic error, and a little.
            share = 0.3 if refinement < 2 else 1.1
            for name, excess in violated.items():
                reserve[name] = reserve.get(name, 0.0) + share * excess
            nodes = 2 * nodes if refinement < 2 else nodes
            program = program.refine(chebyshev_nodes(nodes), reserve)
            if self.budget.spent:
                return
            again = self._minimise(program, xi, self.budget)
            if again is None or not self._feasible(again):
                return
            minimum = again

    def _trajectory(self, xi: Array, samples: int) -> tuple[Trajectory, Array]:
        """Return the motion on `samples` points of the arc, and the goal (nx,)."""
        problem = self._problem
        fine = Transcription(problem, np.linspace(0.0, 1.0, samples))
        motion = fine.motion(xi[None])
        trajectory = Trajectory(
            times=to_nanoseconds(motion.times[0]),
            states=motion.states[0],
            controls=motion.controls[0],
            state_names=problem.state_names,
            control_names=problem.control_names,
            interpolation='cubic',
            state_units=problem.state_units,
            control_units=problem.control_units,
        ).with_rates(self._plant.derivative)
        goal = np.array(motion.states[0, -1])
        for name, state in fine.integrated.items():
            if state.end is not None:
                goal[problem.state_names.index(name)] = state.end
        return trajectory, goal

    def _verify(self, trajectory: Trajectory, goal: Array) -> Verification:
        problem = self._problem
        duration = trajectory.duration
        if problem.terminal_tolerance is None:
            tolerance = 1e-3 * np.ptp(trajectory.states, axis=0) + 1e-6
        else:
            tolerance = np.array(problem.terminal_tolerance, dtype=float)
        margins = self._stated.margins(trajectory.times, trajectory.states, trajectory.controls)
        constraints = [
            Constraint(
                name,
                lambda t, x, u, name=name: self._stated.margins(t, x, u)[name],  # type: ignore[misc]
                tolerance=_MARGIN_TOLERANCE,
            )
            for name in margins
        ]
        return verify(
            self._plant, trajectory, goal, tolerance, constraints, resolution=duration / 1000
        )
