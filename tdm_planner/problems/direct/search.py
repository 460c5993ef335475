# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The search for a plan of any stated problem: direct method, collocation, replay, verification.

1. Initial guesses: roughly minimised motions of the direct method, bent lines, later rollouts.
2. Each is solved by collocation on few intervals. The first solution is solved on more at once, of
   the others the cheapest, if they are cheaper; the plan on many, if there is time.
3. Each is replayed and repaired: by corrected controls, a reserve at a limit, or more intervals.
4. If there is no plan: the direct method's own, minimised to the end; then what failed in 2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.arc_basis import check_finite
from tdm_planner.direct_method.bases import chebyshev_nodes
from tdm_planner.direct_method.collocation import CollocatedMotion
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.trust_region import Minimum
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, NotFinite, VerificationFailed
from tdm_planner.problems.direct.guesses import enough_solutions, Guesses, TRIED
from tdm_planner.problems.direct.minima import DirectMinima
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import COARSE, FINE, FINEST, FIRST, Refinement
from tdm_planner.problems.direct.statement import (
    check_ends,
    check_use,
    constraints_of,
    short_of_reserve,
)
from tdm_planner.problems.problem import Search
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Interpolation, to_nanoseconds, Trajectory
from tdm_planner.verification import verify

if TYPE_CHECKING:
    from tdm_planner.problems.direct.problem import DirectProblem

_MOST = 40  # initial guesses
_HASTY = 3  # guesses, of which none is solved, before more iterations are allowed
_STARTS_SHARE = 0.55  # of the time allowed, after which one solution is enough
# Of J's size: what it may be off by for want of intervals; what equal solutions differ by.
_SETTLED, _SAME = 1e-3, 1e-5
_LATE = 1.0 / 9.0  # of the time allowed: a first solution after that is checked at once
_SOLUTIONS = 3  # on so many intervals that there is to be time for: two of them repairs
_EXCESS, _EXCESS_LEFT = 1.5, 0.5  # times what a check finds: is kept; must be left of it to go on
_DEAR = 0.25  # of J's size: a replan above the rest of its plan
_WORTHWHILE = 1e-3  # gain in scaled cost for which another candidate is checked
_CHECK_SHARE, _CHECK_TIME = 0.15, 0.1  # of the time allowed, and [s], kept for the check
_REFINEMENTS, _GUESS_ROUNDS = 4, 4  # of one candidate; while no guess leads to a feasible motion
_SEARCH_SHARE, _STUCK_SHARE = 0.6, 0.3  # of the time allowed, beside a first candidate, a plan

Candidate = CollocatedMotion | Minimum[Transcription]


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
        self._problem, self._previous = problem, previous
        self._rng, self._seed = rng, int(rng.integers(2**32))
        self._plant = DirectPlant(problem)
        self._stated, self._trace = self._plant.stated, self._plant.trace
        self._refinement = Refinement(self._plant, budget)
        # Not where collocation would lose a boundary condition.
        self._refines = problem._refined and not self._refinement.ends.unkept
        check_use(self._trace)
        self._end_margins = check_ends(self._plant)
        self._rounds, self._found, self._coarse = 0, False, False
        self._no_guess: NotFinite | None = None  # why the direct method has none that is finite
        self._stuck = np.nan  # J of a motion that has no solution on more intervals
        self._aside = list[CollocatedMotion]()  # solutions that more intervals do not confirm
        self._tried = list[CollocatedMotion]()  # those that were checked
        self._last_checked: Trajectory | None = None
        self._best: Candidate | None = None  # what the cheapest plan is made of,
        self._least, self._enough = np.inf, -np.inf  # its J, and that which ends the search
        self._origin = np.inf  # and J before it was repaired

    def candidates(self) -> Iterator[Candidate]:
        """
        Yield refined motions, the cheapest first; the direct method's own if there are none.

        Raise InvalidProblem if what is stated does not fit together, or gives no finite numbers.
        """
        if self._rounds == 0 and self._refines:
            yield from self._refined()
        if self._best is None or (self._is_stuck and self._no_guess is None):
            yield from self._direct()
        if self._best is None:
            aside, self._aside = self._aside, []  # another round need not check them again
            yield from aside

    def is_worth_checking(self, candidate: Candidate, plan: Solution) -> bool:
        """Whether its cost is lower by more than rounding, and it is no minimum tried before."""
        if isinstance(candidate, CollocatedMotion):
            n, cost, worth = candidate.intervals, candidate.cost, _WORTHWHILE * candidate.size
            again = any(n == m.intervals and abs(cost - m.cost) < worth for m in self._tried)
            return cost < plan.cost - worth and not again
        program = candidate.program
        return program.cost(candidate.point) < plan.cost - _WORTHWHILE * program.cost_scale

    def accept(self, plan: Solution) -> bool:
        """Return True, to end the search, after a warm start that is not much dearer."""
        if plan.cost < self._least:
            self._best, self._least = self._checked, plan.cost
            self._origin = self._tried[-1].cost if self._tried else np.inf
        return plan.cost <= self._enough

    def widen(self) -> bool:
        """Try a few more rounds of the direct method while none leads to a feasible motion."""
        return not (self._found or self._until_check.spent) and self._rounds < _GUESS_ROUNDS

    def failure(self) -> Infeasible:
        """Return what was found and why it does not do, or how near the search came."""
        if self.rejected:
            reason = f'a candidate was found, but it did not pass the check: {self.rejected}'
            if self._last_checked is not None:
                reason += self._plant.instability(self._last_checked)
        elif self._minima.nearest_miss:
            reason = self._minima.nearest_miss
        elif self._until_check.spent:
            reason = 'no search from a guess finished'
        else:
            reason = 'no initial guess gives a motion that is finite everywhere'
        for where in ('start', 'end'):
            reason = '; '.join([reason, *short_of_reserve(self._stated, self._end_margins, where)])
        if self._until_check.spent:
            return DeadlineExceeded(f'in {self.budget.seconds:g} s, {reason}')
        return (VerificationFailed if self.rejected else Infeasible)(reason)

    @property
    def remark(self) -> str:
        """Say where the plan is not refined, or on fewer intervals than J asks for, and why."""
        best, why = self._best, ''
        if isinstance(best, Minimum) and self._problem._refined:
            if unkept := self._refinement.ends.unkept:
                where = 'start' if unkept[0].endswith('start') else 'end'
                out = f'state it in {where}_conditions, or leave it out'
                why = f' ({unkept[0]} fixes no state: {out})'
            elif broken := self._refinement.breakdowns:
                why = f' (rates had no value in {broken} attempts: limit the states)'
            return f', not refined by collocation{why}: J is some per cent too high, or far more'
        if isinstance(best, CollocatedMotion) and best.intervals < FINEST:
            if self._coarse:
                why = ': J may be lower with a longer solver.deadline'
            elif self._is_stuck:
                why = ', as more lead to no solution: J may be lower'
            return f', on {best.intervals} intervals{why}' if why else ''
        return ''

    def plans(self, candidate: Candidate) -> Iterator[Solution]:
        """Yield the plan; after a failed check, better refined."""
        self._checked: Candidate = candidate
        if isinstance(candidate, Minimum):
            yield from self._minimised(candidate)
            return
        self._tried.append(candidate)
        refinement, names = self._refinement, self._trace.margin_names
        found: CollocatedMotion | None = candidate
        reserve, before = np.zeros(len(names)), np.inf
        while found is not None:
            found, states, reserve, diverged = refinement.repaired(found, reserve)
            self._checked = found
            xi = np.concatenate([[found.duration], found.controls.ravel()])
            plan = self.checked(found.times, states, found.controls, found.cost, xi)
            if plan is not None:
                yield plan
            if plan is None or diverged:
                return
            violated = self._plant.violated(plan)
            excess = sum(violated.values())  # the check looks more closely than the replay
            if 0.0 < excess < _EXCESS_LEFT * before and not self.budget.spent:
                before = excess
                reserve = reserve + [_EXCESS * violated.get(name, 0.0) for name in names]
                continue
            reserve, before, more = np.zeros(len(names)), np.inf, 2 * found.intervals
            found = refinement.finer(found, more) if refinement.has_time_for(more) else None

    def _refined(self) -> Iterator[CollocatedMotion]:
        """Yield solutions: of a warm start, else the first that is found, then the cheapest."""
        earlier = self._previous
        if earlier is not None and (motion := self._refinement.warm(earlier.trajectory)):
            self._enough = self._problem.cost_to_go(earlier, 0.0) + _DEAR * motion.size
            yield motion
            self._enough = -np.inf
        solved, until = list[tuple[CollocatedMotion, str]](), self._until_check
        for tried, (guess, kind) in enumerate(self._guesses(), 1):
            eased = tried % 2 == 1  # kinks show the way more often, and more often the same
            patient, hard = tried > _HASTY and not solved, tried > TRIED
            if (hard and self._best) or self._refinement.leapt:  # first intervals may mislead
                guess = self._refinement.spread(guess, COARSE)
            motion = self._refinement.from_guess(guess, until, eased=eased, patient=patient)
            if motion and not solved:  # a plan to fall back on, and mostly the plan
                if settled := self._settled(motion):
                    self._found = True
                    yield settled
                motion = motion if settled and self._best else None
            if motion:
                solved.append((motion, kind))
            late, blocked = self.budget.past(_STARTS_SHARE), bool(self._plant.obstacles.any())
            if until.spent or (solved and (late or enough_solutions(solved, tried, blocked))):
                break
            if tried == TRIED:
                finer = [(self._refinement.finer(m, COARSE), kind) for m, kind in solved]
                solved = [(m, kind) for m, kind in finer if m]
        yield from self._cheaper([m for m, _ in solved])

    def _cheaper(self, solved: Sequence[CollocatedMotion]) -> Iterator[CollocatedMotion]:
        """Yield the others on more intervals while they may be cheaper; at last the plan's own."""
        origin = solved[0].cost if solved else np.inf  # J of what the best plan is made of
        last = np.inf
        for motion in sorted(solved[1:], key=lambda found: found.cost):
            least = self._least
            if self._best and motion.cost >= max(origin, least) - _WORTHWHILE * motion.size:
                break
            same = any(abs(motion.cost - cost) < _SAME * motion.size for cost in (origin, last))
            last = motion.cost
            if not same and (settled := self._settled(motion)):
                yield settled
                origin = motion.cost if self._least < least else origin
        best, raised = self._best, self._least - self._origin  # by repairs
        if isinstance(best, CollocatedMotion) and (self._coarse or raised > _SETTLED * best.size):
            self._coarse = False  # there may be time
            if finer := self._settled(best, FINEST):
                yield finer

    def _guesses(self) -> Iterator[tuple[CollocatedMotion, str]]:
        """Yield initial guesses, mostly on the first intervals, and the kind of each."""
        try:
            minima: DirectMinima | None = self._minima
        except NotFinite as error:  # as an unstable plant is, integrated under a rough control
            if not self._refinement.ends.regular:
                raise
            minima, self._no_guess = None, error
        guesses = Guesses(self._plant, self._refinement.ends, self.budget, self._seed)
        for attempt in range(_MOST):
            in_sight = minima is not None and bool(minima.in_sight)  # that takes its time, too
            if self.budget.past(_STARTS_SHARE) and (attempt >= TRIED if self._best else in_sight):
                break
            kind = guesses.kind(attempt, self._best is not None)
            if kind != 'direct' or minima is None:
                rollout = guesses.rollout() if kind == 'rollout' else None
                screen = self._refinement.leapt
                yield rollout or guesses.line(straight=attempt == 0, screen=screen), 'line'
            elif (minimum := minima.minimise_roughly(attempt)) is not None:
                minima.note_miss(minimum)
                yield from ((motion, kind) for motion in minima.collocated(minimum.point.xi))

    def _settled(self, motion: CollocatedMotion, most: int = FINE) -> CollocatedMotion | None:
        """Solve on as many intervals as J asks for, few in a hurry; put aside what fails."""
        solutions = _SOLUTIONS if self._best is None else 1
        last = COARSE if self._best is None and self.budget.past(_LATE) else most
        intervals = COARSE if motion.intervals < COARSE else 2 * motion.intervals
        failed = False
        while intervals <= last and self._refinement.has_time_for(intervals, solutions):
            finer = self._refinement.finer(motion, intervals)
            if finer is None:
                failed = not self.budget.spent
                break
            # The error is that of a second-order method: controls are linear in an interval.
            left = abs(motion.cost - finer.cost) / ((intervals / motion.intervals) ** 2 - 1.0)
            motion, intervals = finer, 2 * intervals
            if left <= _SETTLED * motion.size:
                return motion
        if failed and motion.intervals == FIRST:
            self._aside.append(motion)
            return None
        self._coarse |= not failed
        self._stuck = motion.cost if failed else self._stuck
        return motion

    def _direct(self) -> Iterator[Minimum[Transcription]]:
        """Minimise from a round of initial guesses while there is time."""
        if self._no_guess is not None:
            raise self._no_guess
        minima, found = self._minima, False
        self._rounds += 1
        most = np.inf if self._best is None else _STUCK_SHARE * self.budget.seconds
        until = self.budget.part(min(most, self._until_check.remaining))
        earlier = None if self._previous is None else self._previous.parameters
        for xi in minima.seeds(earlier, self._rounds == 1):
            if until.spent or (found and self.budget.past(_SEARCH_SHARE)):
                break
            minimum = minima.minimise_fully(minima.program, xi, until)
            if minimum is not None and minima.feasible(minimum):
                found = self._found = True
                yield minimum
            elif minimum is not None:
                minima.note_miss(minimum)

    @cached_property
    def _minima(self) -> DirectMinima:
        minima = DirectMinima(self._plant, self._problem.solver.tolerance, self.budget, self._rng)
        minima.check()
        return minima

    @property
    def _is_stuck(self) -> bool:
        """Whether the plan has no solution on more intervals."""
        best, off = self._best, abs(self._least - self._stuck)
        return isinstance(best, CollocatedMotion) and bool(off < _WORTHWHILE * best.size)

    @property
    def _until_check(self) -> Budget:
        """What is left then is for the check: half of the time at most."""
        kept = max(_CHECK_SHARE * self.budget.seconds, _CHECK_TIME)
        return self.budget.leaving(kept, 0.5)

    def _minimised(self, minimum: Minimum[Transcription]) -> Iterator[Solution]:
        """Yield the plan; after a failed check with more nodes, or farther off the limits."""
        minima, nodes = self._minima, minimum.program.nodes.size
        reserve: dict[str, float] = {}
        samples = max(201, 4 * nodes + 1)
        for refinement in range(_REFINEMENTS):
            plan = self._plan(minimum.point.xi, samples)
            if plan is None:
                return
            yield plan
            xi, violated = plan.parameters, self._plant.violated(plan)
            samples = 2 * samples - 1
            if not violated and not minimum.program.integrated:
                continue  # more samples are all that is wanted
            # What twice the nodes leave of a quadratic error, and a little.
            share = 0.3 if refinement < 2 else 1.1
            for name, excess in violated.items():
                reserve[name] = reserve.get(name, 0.0) + share * excess
            nodes = 2 * nodes if refinement < 2 else nodes
            program = minimum.program.refine(chebyshev_nodes(nodes), reserve)
            until = self._until_check
            again = None if until.spent else minima.minimise_fully(program, xi, until)
            if again is None or not minima.feasible(again):
                if until.spent:
                    self.rejected += '; it was not refined further: the time was up'
                return
            minimum = again

    def _plan(self, xi: Array, samples: int) -> Solution | None:
        """Return the plan of a minimum Xi, and its check, on an odd number of samples."""
        fine = self._minima.on(np.linspace(0.0, 1.0, samples))
        motion = fine.motion(xi)
        try:
            check_finite(self._stated, motion, fine.nodes)
        except NotFinite as error:
            self.rejected = str(error)
            return None
        return self.checked(motion.times, motion.states, motion.controls, None, xi)

    def checked(
        self,
        times: Array,
        states: Array,
        controls: Array,
        cost: float | None,
        parameters: Array,
        interpolation: Interpolation = 'linear',
    ) -> Solution | None:
        """Return a plan, J by its replay if not given, and its check; None if it is not finite."""
        try:
            if not np.isfinite(states).all():
                raise NotFinite('its replay is not finite everywhere')
            trajectory = Trajectory.of(
                self._problem, to_nanoseconds(times), states, controls, interpolation
            ).with_rates(self._plant.derivative)
            self._last_checked = trajectory
            replayed = self._plant.replay(trajectory, self.budget.with_grace())
            cost = self._plant.cost_of(trajectory, replayed) if cost is None else cost
            tolerance = self._refinement.tolerance(states)
            check = verify(
                self._plant,
                trajectory,
                replayed,
                self._refinement.goal(states),
                tolerance,
                constraints_of(self._stated, trajectory, self._plant.limit_tolerances(trajectory)),
                start=self._refinement.ends.states[0],
                breaks=self._plant.breaks,
            )
        except (NotFinite, DeadlineExceeded) as error:
            self.rejected = self.rejected or str(error)  # what an earlier one violates tells more
            return None
        if check.ok and (reason := self._plant.mistaken(trajectory, replayed, tolerance)):
            check = replace(check, ok=False, reasons=(reason,))
        penalty = max(0.0, -min(check.worst.values(), default=0.0))
        return Solution({self._problem.name: trajectory}, check, cost, parameters, penalty)
