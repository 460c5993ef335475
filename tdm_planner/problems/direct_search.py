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

"""The search for a plan of any formulation: seeds, minimiser, node refinement, verification."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.arc_motion import check_finite
from tdm_planner.direct_method.arc_nodes import chebyshev_nodes
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, NotFinite, VerificationFailed
from tdm_planner.plants.base import Plant
from tdm_planner.problems.search import Plan, Search
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from tdm_planner.verification import Constraint, usual_tolerance, Verification, verify

if TYPE_CHECKING:
    from tdm_planner.problems.direct_problem import DirectProblem

Array = NDArray[np.float64]

_FEASIBLE = 1e-6  # violation at which the minimiser is content,
_PROMISING = 1e-5  # and up to which the check may pass
_MARGIN_TOLERANCE = 1e-5  # of the verification, for what is exactly on a limit
_ROUNDS = 4  # of refinement of one candidate
_WORTHWHILE = 1e-5  # gain in scaled cost for which another candidate is checked
_CHECK_SHARE, _CHECK_TIME = 0.15, 0.1  # of the time allowed, and [s], kept for the check
_GUESS_ROUNDS = 4  # of first guesses while none leads to a feasible motion
_SCREENED = 256  # random first guesses of which the one nearest to the end conditions is kept
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
        self._rounds = 0
        self._found = False
        self._closest = np.inf
        self._nearest_miss = ''

    def candidates(self) -> Iterator[Minimum]:
        """
        Minimise from a round of first guesses while there is time.

        Raises
        ------
        InvalidProblem
            If what the problem states does not fit together, or gives numbers that are not finite.

        """
        if self._rounds == 0:
            self._program.begin(self._program.first_guess)
        self._rounds += 1
        found = False
        until = Budget(self._latest - self.budget.elapsed)
        for xi in self._seeds():
            late = self.budget.elapsed > _SEARCH_SHARE * self.budget.seconds
            if until.spent or (found and late):
                break
            minimum = self._minimise(self._program, xi, until)
            if minimum is None:
                continue
            if self._feasible(minimum):
                found = self._found = True
                yield minimum
            elif minimum.point.violation < self._closest:
                self._closest = minimum.point.violation
                self._nearest_miss = self._name_violation(minimum)

    def promises_more(self, candidate: Minimum, than: Minimum) -> bool:
        """Whether its cost, before refinement, is lower by more than rounding."""
        return candidate.point.cost < than.point.cost - _WORTHWHILE

    def satisfied_with(self, plan: Plan) -> bool:
        """Never: all first guesses of the round are tried."""
        return False

    def widen(self) -> bool:
        """Go on with other first guesses, a few rounds, while none leads to a feasible motion."""
        return not (self._found or self._late) and self._rounds < _GUESS_ROUNDS

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
    def _latest(self) -> float:
        """When minimising before any check has to end [s]: a check takes its time, too."""
        seconds = self.budget.seconds
        return seconds - max(_CHECK_SHARE * seconds, min(_CHECK_TIME, 0.5 * seconds))

    @property
    def _late(self) -> bool:
        return self.budget.elapsed > self._latest

    def _node_count(self) -> int:
        outputs = self._stated.outputs().values()
        free = max(o.free if o.shapes is None else o.shapes.size for o in outputs)
        return max(self._problem.nodes, 3 * free + 15)

    def _seeds(self) -> Iterator[Array]:
        """
        Yield the previous solution, the plain boundary conditions, and random changes.

        With a previous solution no changes are tried: replanning is to be quick.
        """
        first = self._program.first_guess
        if self._rounds == 1:
            if self._previous is not None and self._previous.shape == first.shape:
                yield self._previous
                yield first
                return
            yield first
        for attempt in range(1, self._problem.starts):
            if self._program.has_end_conditions:
                sizes = np.exp(self._rng.uniform(np.log(0.1), np.log(1.5), _SCREENED))
                yield self._nearest_of(self._changed(sizes))
            else:
                yield self._changed(np.array([min(0.15 * attempt, 1.0)]))[0]

    def _changed(self, sizes: Array) -> Array:
        """Random changes of the first guess of about `sizes` (count,) in its units, (count, n)."""
        first = self._program.first_guess
        longer = np.exp(0.4 * self._rng.normal(size=(sizes.size, 1)) + 0.2)
        change = self._rng.normal(size=(sizes.size, first.size))
        change *= 3.0 * sizes[:, None] / np.sqrt(first.size)
        return np.where(first > 0, first * longer, change)

    def _nearest_of(self, guesses: Array) -> Array:
        """Return that of `guesses` (count, n) which misses the conditions at the end least."""
        misses = self._program.misses(guesses)
        return np.asarray(guesses[np.argmin(np.nan_to_num(misses, nan=np.inf))])

    def _minimise(self, program: Transcription, xi: Array, budget: Budget) -> Minimum | None:
        before = program.evaluations
        if not np.isfinite(program.evaluate(xi).cost):
            return None
        options = TrustRegionOptions(
            penalties=(5.0, 5.0),
            largest_penalty=1e4,
            steering=program.has_end_conditions,
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
        return bool(
            ends <= max(self._problem.solver.tolerance, _PROMISING) and margins <= _PROMISING
        )

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
            plan = self._plan(program, minimum, samples)
            if plan is None:
                return
            yield plan
            check, xi = plan.verification, plan.parameters
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
            again = None if self.budget.spent else self._minimise(program, xi, self.budget)
            if again is None or not self._feasible(again):
                if self.budget.spent:
                    self.rejected += '; it was not refined further: the time was up'
                return
            minimum = again

    def _plan(self, program: Transcription, minimum: Minimum, samples: int) -> Plan | None:
        """Return the plan and its check; None, `rejected`, where it is not finite everywhere."""
        xi = minimum.point.xi
        try:
            trajectory, goal = self._trajectory(xi, samples)
            check = self._verify(trajectory, goal)
        except NotFinite as error:
            self.rejected = str(error)
            return None
        cost = float(program.cost(program.motion(xi[None]))[0])
        return Plan({self._problem.name: trajectory}, check, cost, xi, minimum.point.violation)

    def _trajectory(self, xi: Array, samples: int) -> tuple[Trajectory, Array]:
        """Return the motion on `samples` points of the arc, and the goal (nx,)."""
        problem = self._problem
        fine = Transcription(problem, np.linspace(0.0, 1.0, samples))
        motion = fine.motion(xi[None])
        check_finite(self._stated, motion, fine.nodes)
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

    def _margin(self, name: str, times: Array, states: Array, controls: Array) -> Array:
        return self._stated.margins(times, states, controls)[name]

    def _verify(self, trajectory: Trajectory, goal: Array) -> Verification:
        problem = self._problem
        if problem.terminal_tolerance is None:
            tolerance = usual_tolerance(trajectory.states, problem.state_units)
        else:
            tolerance = np.array(problem.terminal_tolerance, dtype=float)
        margins = self._stated.margins(trajectory.times, trajectory.states, trajectory.controls)
        constraints = [
            Constraint(
                name,
                partial(self._margin, name),
                tolerance=_MARGIN_TOLERANCE,
            )
            for name in margins
        ]
        return verify(
            self._plant,
            trajectory,
            goal,
            tolerance,
            constraints,
            start=self._stated.start(),
        )
