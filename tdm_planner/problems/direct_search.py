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

"""
The search for a plan of any stated problem: direct method, collocation, replay, verification.

A loose minimum of the direct method is the first guess of a collocation on few intervals; the
cheapest of a few such solutions is solved again on more. It is replayed and repaired: by a shifted
end, a reserve at a limit that the replay violates, or more intervals. Where nothing comes of that
the direct method's own motion, minimised to the end, is the plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.arc_motion import check_finite
from tdm_planner.direct_method.arc_nodes import chebyshev_nodes
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import COLD, Motion, WARM
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import (
    DeadlineExceeded,
    Infeasible,
    NotFinite,
    VerificationFailed,
)
from tdm_planner.problems.direct_plant import TracedPlant
from tdm_planner.problems.direct_statement import (
    check_costs,
    check_dynamics,
    check_ends,
    check_limits,
    constraints_of,
    MARGIN_TOLERANCE,
)
from tdm_planner.problems.refinement import COARSE, FINE, Refinement
from tdm_planner.problems.search import Plan, Search
from tdm_planner.trajectory import Interpolation, to_nanoseconds, Trajectory
from tdm_planner.verification import Verification, verify

if TYPE_CHECKING:
    from tdm_planner.problems.base import Solution
    from tdm_planner.problems.direct_problem import DirectProblem

Array = NDArray[np.float64]

_MOST = 8  # first guesses; fewer where the best solution
_AGREED, _ALIKE, _ENOUGH = 2, 1e-2, 4  # was found so often, within a share; or so many solved
_GUESS_NODES = 25
_TIGHT = TrustRegionOptions(
    penalties=(5.0, 5.0),
    largest_penalty=1e4,
    radius=0.5,
    iterations=150,
    cost_tolerance=1e-7,
    corrections=2,
)
_LOOSE = replace(
    _TIGHT, iterations=8, cost_tolerance=1e-2, feasibility=(1e-3, 1e-3), corrections=1
)
_CHANGE = 0.15, 0.5  # of the first guess, in its units: without and with conditions at the ends
_CHANGES = 10  # of a first guess that is not finite everywhere
_PLAIN, _STRAIGHT = 2, (3, 5, 7)  # attempts: boundary conditions alone, lines in state space
_FAR = 0.3  # violation with which the loose minimiser goes on
_STARTS_SHARE = 0.4  # of the time allowed, after which one solution is enough
_HURRY = 8.0  # times what the first solution took: with less time left it is checked at once

_FEASIBLE = 1e-6  # violation at which the direct method's minimiser is content,
_PROMISING = 1e-5  # and up to which the check may pass
_ROUNDS = 4  # of refinement of one candidate
_WORTHWHILE = 1e-5  # gain in scaled cost for which another candidate is checked
_CHECK_SHARE, _CHECK_TIME = 0.15, 0.1  # of the time allowed, and [s], kept for the check
_LEAST_CHECK = 0.04  # s that a check may take past the deadline
_GUESS_ROUNDS = 4  # of first guesses while none leads to a feasible motion
_SCREENED = 64  # random first guesses of which the one nearest to the end conditions is kept
_SEARCH_SHARE = 0.6  # of the time allowed, for candidates beside the first

Candidate = Motion | Minimum


class DirectSearch(Search[Candidate]):
    """Search for the cheapest verified plan of a stated problem; `previous` is a warm start."""

    def __init__(
        self,
        problem: DirectProblem,
        budget: Budget,
        rng: np.random.Generator,
        previous: Solution | None = None,
    ) -> None:
        super().__init__(budget)
        self._problem = problem
        self._stated = CheckedFormulation(problem)
        self._rng = rng
        self._previous = previous
        trace = self._trace = Trace.of(self._stated)
        self._plant = TracedPlant(problem, trace)
        tolerance = problem.terminal_tolerance
        self._refinement = Refinement(self._stated, trace, tolerance, budget)
        check_limits(trace)
        check_ends(self._stated, self._refinement.ends)
        self._nodes = self._node_count()
        self._rounds = 0
        self._found = self._warm = self._hurried = False
        self._closest = np.inf
        self._nearest_miss = ''

    def candidates(self) -> Iterator[Candidate]:
        """
        Yield refined motions, the cheapest first; the direct method's own if there are none.

        Raises
        ------
        InvalidProblem
            If what the problem states does not fit together, or gives numbers that are not finite.

        """
        if self._rounds == 0 and self._refines:
            yield from self._refined()
        if not self._found:
            yield from self._direct()

    def promises_more(self, candidate: Candidate, than: Candidate) -> bool:
        """Whether its cost, before refinement, is lower by more than rounding."""
        costs = [
            c.cost if isinstance(c, Motion) else c.point.cost * self._program.cost_scale
            for c in (candidate, than)
        ]
        return costs[0] < costs[1] - _WORTHWHILE * abs(costs[1])

    def satisfied_with(self, plan: Plan) -> bool:
        """Whether it came of a warm start: others are not tried."""
        return self._warm

    def widen(self) -> bool:
        """Go on with other first guesses, a few rounds, while none leads to a feasible motion."""
        rounds = 1 if self._refines else _GUESS_ROUNDS
        return not (self._found or self._late) and self._rounds < rounds

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

    def plans(self, candidate: Candidate) -> Iterator[Plan]:
        """Yield the plan; after a failed check, better refined."""
        if isinstance(candidate, Motion):
            yield from self._collocated(candidate)
        else:
            yield from self._minimised(candidate)

    # Collocation.

    def _refined(self) -> Iterator[Motion]:
        """Yield solutions on few intervals: of a warm start, else of a few first guesses."""
        if self._previous is not None:
            motion = self._refinement.warm(self._previous.trajectory)
            if motion is not None:
                self._warm = True
                yield motion
                self._warm = False
        solved: list[Motion] = []
        until = Budget(self._latest - self.budget.elapsed)
        for guess in self._guesses():
            if until.spent:
                break
            motion = self._refinement.solve(COARSE, guess, COLD, until)
            if motion is None:
                continue
            solved.append(motion)
            self._found = True
            if len(solved) == 1 and _HURRY * self.budget.elapsed > self.budget.remaining:
                self._hurried = True
                yield motion
                self._hurried = False
            best = min(found.cost for found in solved)
            again = sum(found.cost <= best + _ALIKE * abs(best) for found in solved)
            late = self.budget.elapsed > _STARTS_SHARE * self.budget.seconds
            if again >= _AGREED or len(solved) >= _ENOUGH or late:
                break
        yield from sorted(solved, key=lambda found: found.cost)

    def _guesses(self) -> Iterator[Motion]:
        """Yield first guesses on the coarse intervals, mostly minima of the direct method."""
        program = self._program_on(chebyshev_nodes(_GUESS_NODES))
        self._begin(program)
        options = replace(_LOOSE, steering=program.has_end_conditions)
        for attempt in range(_MOST):
            xi = program.first_guess
            if attempt == _PLAIN:
                yield from self._finite(xi)
                continue
            if attempt in _STRAIGHT:
                bend = 0.5 if attempt > _STRAIGHT[0] else 0.0
                yield self._refinement.straight(COARSE, bend, self._rng)
                continue
            if attempt:
                size = _CHANGE[program.has_end_conditions] * attempt
                xi = self._changed(program, np.array([min(size, 1.0)]))[0]
            minimum = self._minimise(program, xi, self.budget, options)
            if minimum is not None and minimum.point.violation > _FAR:
                xi = minimum.point.xi
                minimum = self._minimise(program, xi, self.budget, replace(options, iterations=32))
            if minimum is not None:
                yield from self._finite(minimum.point.xi)

    def _finite(self, xi: Array) -> Iterator[Motion]:
        """Yield the direct method's motion if it is finite everywhere."""
        motion = self._motion_of(xi)
        if motion.finite:
            yield motion

    def _begin(self, program: Transcription) -> None:
        """Scale the cost at the first guess, or at a change of it that is finite everywhere."""
        try:
            program.begin(program.first_guess)
        except NotFinite as error:
            refusal = error
        else:
            changed = self._changed(program, np.array([0.5]))[0]
            check_dynamics(program, changed)
            check_costs(self._trace, program.motion(changed), self._refinement.numbers)
            return
        for size in np.linspace(0.1, 1.0, _CHANGES):
            try:
                program.begin(self._changed(program, np.array([size]))[0])
                return
            except NotFinite:
                pass
        raise refusal

    def _motion_of(self, xi: Array) -> Motion:
        """Return the direct method's motion on the coarse intervals, which are even in time."""
        motion = self._halves.motion(xi)
        even = np.linspace(0.0, motion.times[-1], motion.times.size)
        states, controls = (
            np.stack([np.interp(even, motion.times, column) for column in values.T], axis=-1)
            for values in (motion.states, motion.controls)
        )
        return Motion(states[::2], states[1::2], controls[::2], float(even[-1]))

    def _collocated(self, coarse: Motion) -> Iterator[Plan]:
        """Yield the plan of a solution on more intervals, repaired as its replay asks."""
        motion, quick = coarse, self._warm or self._hurried
        if not quick:
            motion = self._refinement.finer(coarse, FINE) or coarse
        for found in self._refinement.refined(motion):
            plan = self._plan_of(found)
            if plan is None:
                return
            yield plan

    def _plan_of(self, motion: Motion) -> Plan | None:
        """Return the plan of a motion with its replayed states, and its check."""
        states = self._refinement.replayed(motion)
        try:
            if not np.isfinite(states).all():
                raise NotFinite('its replay is not finite everywhere')
            times = np.linspace(0.0, motion.duration, motion.intervals + 1)
            trajectory = self._trajectory_of(times, states, motion.controls, 'linear')
            trajectory = trajectory.with_rates(self._plant.derivative)
            check = self._verify(trajectory, self._refinement.goal(states))
        except (NotFinite, DeadlineExceeded) as error:
            self.rejected = str(error)
            return None
        penalty = max(0.0, -min(check.worst.values(), default=0.0))
        parameters = np.concatenate([[motion.duration], motion.controls.ravel()])
        return Plan({self._problem.name: trajectory}, check, motion.cost, parameters, penalty)

    # The direct method by itself.

    def _direct(self) -> Iterator[Candidate]:
        """Minimise from a round of first guesses while there is time."""
        program = self._program
        self._begin(program)
        self._rounds += 1
        found = False
        until = Budget(self._latest - self.budget.elapsed)
        for xi in self._seeds():
            late = self.budget.elapsed > _SEARCH_SHARE * self.budget.seconds
            if until.spent or (found and late):
                break
            minimum = self._minimise(program, xi, until)
            if minimum is None:
                continue
            if self._feasible(minimum):
                found = self._found = True
                yield minimum
                motion = self._from_minimum(minimum) if self._refines else None
                if motion is not None:
                    yield motion
            elif minimum.point.violation < self._closest:
                self._closest = minimum.point.violation
                self._nearest_miss = self._name_violation(minimum)

    def _from_minimum(self, minimum: Minimum) -> Motion | None:
        """Solve the collocation from a minimum of the direct method; None if that fails."""
        for guess in self._finite(minimum.point.xi):
            return self._refinement.solve(COARSE, guess, WARM)
        return None

    @property
    def _refines(self) -> bool:
        """Whether plans are refined: not where collocation would lose a boundary condition."""
        return self._problem.refined and self._refinement.ends.complete

    @cached_property
    def _program(self) -> Transcription:
        return self._program_on(chebyshev_nodes(self._nodes))

    def _program_on(self, nodes: Array) -> Transcription:
        return Transcription(self._problem, nodes, trace=self._trace)

    @cached_property
    def _halves(self) -> Transcription:
        """Return the program on the ends and middles of the coarse intervals."""
        return self._program_on(np.linspace(0.0, 1.0, 2 * COARSE + 1))

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
        Yield an earlier solution, the first guess, and random changes of that.

        With an earlier solution no changes are tried: replanning is to be quick.
        """
        program, first = self._program, self._program.first_guess
        if self._rounds == 1:
            if self._previous is not None and self._previous.parameters.shape == first.shape:
                yield self._previous.parameters
                yield first
                return
            yield first
        for attempt in range(1, self._problem.starts):
            if program.has_end_conditions:
                sizes = np.exp(self._rng.uniform(np.log(0.1), np.log(1.5), _SCREENED))
                guesses = self._changed(program, sizes)
                misses = np.nan_to_num(program.misses(guesses), nan=np.inf)
                yield guesses[np.argmin(misses)]
            else:
                yield self._changed(program, np.array([min(0.15 * attempt, 1.0)]))[0]

    def _changed(self, program: Transcription, sizes: Array) -> Array:
        """Random changes of the first guess of about `sizes` (count,) in its units, (count, n)."""
        first, timing = program.first_guess, program.basis.timing
        longer = np.exp(0.4 * self._rng.normal(size=(sizes.size, 1)) + 0.2)
        change = self._rng.normal(size=(sizes.size, first.size))
        change *= 3.0 * sizes[:, None] / np.sqrt(first.size)
        return np.hstack([first[:timing] * longer, first[timing:] + change[:, timing:]])

    def _minimise(
        self,
        program: Transcription,
        xi: Array,
        budget: Budget,
        options: TrustRegionOptions | None = None,
    ) -> Minimum | None:
        before = program.evaluations
        point = program.evaluate(xi)
        if not np.isfinite(point.cost):
            return None
        if not program.size:  # the boundary conditions leave nothing to vary
            return Minimum(point, 0, converged=True, multipliers=None)
        tight = replace(
            _TIGHT,
            steering=program.has_end_conditions,
            feasibility=(self._problem.solver.tolerance, _FEASIBLE),
        )
        with np.errstate(all='ignore'):
            minimum = minimise(program, xi, options or tight, budget)
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
        motion = self._program.motion(minimum.point.xi)
        margins = self._stated.margins(motion.times, motion.states, motion.controls)
        least = {name: float(np.min(value)) for name, value in margins.items()}
        name = min(least, key=lambda key: least[key])
        return f'{name} by {-least[name]:.2g}'

    def _minimised(self, candidate: Minimum) -> Iterator[Plan]:
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
            violated = {k: -v for k, v in check.worst.items() if v < -MARGIN_TOLERANCE}
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
        fine = self._program_on(np.linspace(0.0, 1.0, samples))
        motion = fine.motion(xi)
        try:
            check_finite(self._stated, motion, fine.nodes)
            trajectory = self._trajectory_of(
                motion.times, motion.states, motion.controls, 'cubic'
            ).with_rates(self._plant.derivative)
            check = self._verify(trajectory, self._refinement.goal(motion.states))
        except (NotFinite, DeadlineExceeded) as error:
            self.rejected = str(error)
            return None
        cost = program.cost(xi)
        return Plan({self._problem.name: trajectory}, check, cost, xi, minimum.point.violation)

    def _trajectory_of(
        self, times: Array, states: Array, controls: Array, interpolation: Interpolation
    ) -> Trajectory:
        problem = self._problem
        return Trajectory(
            times=to_nanoseconds(times),
            states=states,
            controls=controls,
            state_names=problem.state_names,
            control_names=problem.control_names,
            interpolation=interpolation,
            state_units=problem.state_units,
            control_units=problem.control_units,
        )

    def _verify(self, trajectory: Trajectory, goal: Array) -> Verification:
        check = verify(
            self._plant,
            trajectory,
            goal,
            self._refinement.tolerance(trajectory.states),
            constraints_of(self._stated, trajectory),
            start=self._refinement.ends.states[0],
            until=Budget(max(self.budget.remaining, _LEAST_CHECK)),
        )
        if check.ok and not self._plant.agrees(trajectory.states, trajectory.controls):
            reason = 'derivative gives other rates when it is traced than with numpy'
            return replace(check, ok=False, reasons=(reason,))
        return check
