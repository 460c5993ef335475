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

"""The search for formations' plans: several first guesses, the shared minimiser, best first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget, Point
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, VerificationFailed
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.problems.base import Solution
from tdm_planner.problems.formation_plan import initial_misalignment, trajectory
from tdm_planner.problems.formation_program import FormationProgram
from tdm_planner.problems.formation_seeds import BowSeeds
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.formation_verification import keeps_reserve, verify_formation
from tdm_planner.problems.kept_motion import kept_motions, LATE, turning_time
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion
from tdm_planner.problems.search import Plan, Search
from tdm_planner.problems.warm_start import warm_parameters
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_NEARLY_FEASIBLE = 2.5  # times the violation allowed, up to which a plan may survive the check
_RATE_FEASIBLE = 10.0  # times that, of the thruster's rate: where it is late shooting makes up
_TURNING_SHARE = 0.95  # of the thruster's rate, at which it turns before a manoeuvre
_ALIGNED = 0.1  # [rad] less than this the thruster turns on the way
_MANY = 12  # robots from which on violations are charged more
_RADIUS, _REFINING_RADIUS = 0.15, 0.05
_ROUNDS = 4  # of guesses, each keeping more distance, before giving up
_SIMPLE = 7  # order of the polynomials with which first guesses are minimised
_RAISE = 4  # by which the order is raised where the rest of an earlier plan did not do
_WORSE = 1.1  # times the best cost so far: a start that is nearly feasible there is given up
# Robots keep the rest of their motions that have less time left than so many half-turns of the
# thruster take; those late on the way do where they could not be planned anew.
_LAST_LEG = 1.0
_KEPT = 0.03  # margin of a separation that binds nobody
_ITERATIONS, _WARM_ITERATIONS = 60, 30
_SEARCH_SHARE = 0.75  # of the deadline, after which no other guess is tried once there is a plan
_NEARLY = 4.0  # times the accuracy of the end aimed at
_ANOTHER = 1.3  # times as long as its check another candidate takes at least
_CHECK_TIME, _CHECK_SHARE = 5e-3, 0.45  # s a robot, but no more than this share of the deadline


@dataclass(frozen=True)
class Form:
    """The reference functions and their grid: parameters of `ReferenceMotion` and the program."""

    order: int = 7
    yaw_order: int = 5
    speed_factor_order: int = 0
    vary_ends: bool = True
    nodes: int | None = None

    def model(self, task: FormationTask) -> ReferenceMotion:
        """Return the reference functions of a manoeuvre."""
        return ReferenceMotion(
            task, self.order, self.yaw_order, self.speed_factor_order, self.vary_ends
        )

    def of_order(self, order: int) -> Form:
        """Return the form with polynomials of another order, on as many nodes as that needs."""
        return self if order == self.order else replace(self, order=order, nodes=None)


@dataclass(frozen=True)
class Candidate:
    """A local minimum: the program it solves and the point found."""

    program: FormationProgram
    point: Point

    @property
    def cost(self) -> float:
        """Return the performance index, gas by quadrature."""
        return self.point.cost * self.program.scale

    @property
    def motion(self) -> FormationMotion:
        """Return the reference motions."""
        return self.program.motion(self.point.xi)

    @property
    def crowded(self) -> bool:
        """Whether a separation binds, so that other sides to pass on may be cheaper."""
        values = self.point.cache.values
        nearest = min(
            values.pairs.margins.min(initial=1.0), values.circles.margins.min(initial=1.0)
        )
        return bool(nearest < _KEPT)


def gas_used(plant: FloatingRobot, trajectory: Trajectory) -> float:
    """Integral of thrust per mass along a robot's trajectory [m/s]."""
    thrust = trajectory.control_names.index('thrust')
    return float(trajectory.control_integral(trajectory.times[-1])[thrust]) / plant.mass


def assessed(
    task: FormationTask,
    motions: Mapping[str, Trajectory],
    penalty_weights: Array,
    tolerance: float,
    parameters: Array,
) -> Plan:
    """
    Return the robots' motions with their check and cost; `parameters` are Xi (m,).

    `tolerance` is the largest penalty that passes the check.
    """
    check = verify_formation(task, motions, penalty_weights)
    overall = check.overall
    if check.penalty > tolerance:
        excess = f'the penalty {check.penalty:.3g} is above solver.tolerance = {tolerance:g}'
        overall = replace(overall, ok=False, reasons=(*overall.reasons, excess))
    terms = task.cost_terms(
        np.array([motions[name].duration for name in task.names]),
        np.array([gas_used(task.plant, motions[name]) for name in task.names]),
    )
    return Plan(
        trajectories=motions,
        verification=overall,
        cost=sum(terms.values()),
        parameters=parameters,
        penalty=check.penalty,
        cost_terms=terms,
        verifications=check.robots,
    )


class FormationSearch(Search[Candidate]):
    """
    Local minima of one manoeuvre from several first guesses, and their plans.

    First guesses are minimised with polynomials of a low order, the best of them go on with that
    of the `form`. `penalty_weights` (4,) are k1 to k4 of (29), `tolerance` eps of (10). Of a
    `previous` plan the remaining motion is the first guess, without others at first. `closest` is
    the point of the least violation seen, for the reason of a failure.
    """

    def __init__(
        self,
        task: FormationTask,
        form: Form,
        rng: np.random.Generator,
        budget: Budget,
        *,
        starts: int,
        penalty_weights: Array,
        tolerance: float,
        previous: Solution | None = None,
    ) -> None:
        super().__init__(budget)
        self.form = form
        self.starts = starts
        self.closest: Candidate | None = None
        self.tried = 0
        self._required = task
        self._penalty_weights, self._tolerance = penalty_weights, tolerance
        # The violation, relative to a limit, whose square is worth that penalty.
        self._feasible = math.sqrt(tolerance / penalty_weights.max())
        self._rng = rng
        self._rounds = 1
        self._found = False
        self._previous = previous
        self._first: Array | None = None
        self._kept: dict[str, Trajectory] = {}
        self._held: Array | None = None
        self._late: dict[str, Trajectory] | None = None
        self._half_turns = _LAST_LEG
        self._check_time = 0.0  # of the last candidate: writing it out and checking it
        simple = form.of_order(min(form.order, _SIMPLE))
        self._aim(task, simple if previous is None else form)
        self._start_from(previous)
        # A plan that is to replace another on the way, and may be replaced, must be there soon.
        self._enough = 1.0 if previous is None else _NEARLY

    def _aim(self, task: FormationTask, form: Form) -> None:
        self.task, self._form = task, form
        self._kept, self._held = {}, None
        self._use(task)
        self.seeds = BowSeeds(self.model, self._rng)
        self._guesses = iter(self.seeds)

    def _use(self, task: FormationTask) -> None:
        self.model = self._form.model(task)
        self.program = FormationProgram(self.model, self._form.nodes, held=self._held)

    def _start_from(self, previous: Solution | None) -> None:
        """
        Take the remaining motion of a plan for the first guess, and nothing else for now.

        Robots about to arrive keep theirs; the turning that the guess needs is reckoned with from
        the outset.
        """
        if previous is None:
            return
        self._first = warm_parameters(self.model, self.seeds, previous)
        if self._first is None:
            return
        if self._late is None:
            self._late = kept_motions(self._required, previous.trajectories, LATE)
        leg = self._half_turns * turning_time(self.task.thruster_rate)
        self._kept = {name: m for name, m in self._late.items() if m.duration < leg}
        coast = self._needed_coast(self.model, self.model.unpack(self._first))
        if self._kept:
            kept = np.array([name in self._kept for name in self.task.names])
            self._held = np.where(kept[:, None], self._first, np.nan)
            coast[kept] = 0.0
        if coast.any() or self._kept:
            self._use(self.task.with_coast(1.03 * coast))

    @property
    def _may_keep_more(self) -> bool:
        """Whether, should this not do, more robots can keep their motions."""
        if self._first is None or self._late is None or self._half_turns >= LATE:
            return False
        return len(self._late) > len(self._kept)

    def _needed_coast(self, model: ReferenceMotion, motion: FormationMotion) -> Array:
        """Time [s] that every thruster needs to turn before a motion begins (n,)."""
        angle = initial_misalignment(model, motion)
        needed = angle / (_TURNING_SHARE * self.task.thruster_rate)
        return np.where(angle > _ALIGNED, needed + 0.01 * motion.durations, 0.0)

    def candidates(self) -> Iterator[Candidate]:
        """Minima with thrusters turned first; then, did none do, with their rate limited."""
        if self._first is None:
            found = self.minima(self.starts)
        else:
            found = self.minima(0, self.program.reduce(self._first))
        self._found = bool(found)
        kept = []
        for candidate in map(self.raised, found):
            turned = self.turned(candidate) or candidate
            kept.append(turned)
            yield turned
        if self._may_keep_more:
            return
        for candidate in kept:
            if self._too_late:
                return
            refined = self.refined(candidate)
            if refined is not None:
                yield refined

    def plans(self, candidate: Candidate) -> Iterator[Plan]:
        """Yield the trajectories that the reference motions give by inverse dynamics."""
        task, model, motion = self._required, candidate.program.model, candidate.motion
        careful = not self._may_keep_more
        began = self.budget.elapsed
        motions = {
            name: self._kept[name]
            if name in self._kept
            else trajectory(model, motion, i, self.budget, self._enough, careful)
            for i, name in enumerate(task.names)
        }
        plan = assessed(task, motions, self._penalty_weights, self._tolerance, candidate.point.xi)
        self._check_time = self.budget.elapsed - began
        yield plan

    @property
    def _too_late(self) -> bool:
        """Whether another candidate's check would end after the deadline."""
        return self.budget.remaining < _ANOTHER * self._check_time

    def satisfied_with(self, plan: Plan) -> bool:
        """Whether the distance kept for the tracking is left, by half at least."""
        return keeps_reserve(self._required, plan.verification)

    def widen(self) -> bool:
        """
        Keep more distance, where plans failed the check; else go on with other guesses.

        Where the rest of an earlier plan did not do, more robots keep theirs, then polynomials of
        higher order are tried, then guesses, one by one: on the way there is little time.
        """
        if self._too_late:
            return False
        if self._may_keep_more:
            self._half_turns = LATE
            self._aim(self._required, self.form)
            self._start_from(self._previous)
            return True
        simple = self.form.of_order(min(self.form.order, _SIMPLE))
        if self._first is not None and self._form == self.form and self.form.order <= 15 - _RAISE:
            self._aim(self._required, self.form.of_order(self.form.order + _RAISE))
            self._start_from(self._previous)
            return True
        self._rounds += 1
        if self._first is not None:
            self._first, self.starts = None, 1
            self._aim(self._required, simple)
        elif self._found and self._previous is None:
            margin = self.task.margin + 0.04 * self.task.separation
            self._aim(replace(self.task, margin=margin), simple)
        return self._rounds <= _ROUNDS

    def failure(self) -> Infeasible:
        """Return what was found and why it does not do, or how near the search came."""
        if self.rejected:
            return VerificationFailed(f'no plan survived the check: {self.rejected}')
        closest = self.closest
        binding = '' if closest is None else closest.program.binding(closest.point)
        if closest is not None and closest.motion.durations.max() > 0.999 * self.task.longest:
            binding += f' (with arrival as late as solver.longest = {self.task.longest:g} s)'
        if self.budget.spent:
            return DeadlineExceeded(
                f'no plan within {self.budget.seconds:g} s from {self.tried} starts; nearest to '
                f'one, {binding} was violated'
            )
        return Infeasible(f'no plan from {self.tried} starts: {binding} is violated at best')

    def minima(self, starts: int, first: Array | None = None) -> list[Candidate]:
        """
        Feasible local minima from `starts` guesses, cheapest first; `first` Xi is tried first.

        Ends early when the time is spent, but not before one minimum is found or time is up, and
        with one at which the robots do not hinder one another: none is cheaper.
        """
        found: list[Candidate] = []
        for guess in self._starting_points(starts, first):
            best = min((candidate.point.cost for candidate in found), default=None)
            cutoff = None if best is None else _WORSE * best
            candidate, converged = self._minimise(self.program, guess, _RADIUS, cutoff)
            self.tried += 1
            if converged:
                found.append(candidate)
            late = self.budget.elapsed > _SEARCH_SHARE * self.budget.seconds
            alone = converged and not (candidate.crowded or self.rejected)
            if self.budget.spent or alone or (late and found):
                break
        return sorted(found, key=lambda candidate: candidate.cost)

    def _starting_points(self, starts: int, first: Array | None) -> Iterator[Array]:
        if first is not None:
            yield first
        for _ in range(starts):
            yield self.program.reduce(next(self._guesses))

    def _minimise(
        self,
        program: FormationProgram,
        guess: Array,
        radius: float,
        cutoff: float | None = None,
    ) -> tuple[Candidate, bool]:
        penalty = 3.0 if program.model.task.n >= _MANY else 1.0
        options = TrustRegionOptions(
            penalties=(penalty, 0.5)[: program.groups],
            feasibility=(self._feasible, _RATE_FEASIBLE * self._feasible)[: program.groups],
            radius=radius,
            iterations=_ITERATIONS if self._first is None else _WARM_ITERATIONS,
            cutoff=cutoff,
        )
        if not program.free.size:
            return Candidate(program, program.evaluate(np.zeros(0))), True
        before = program.evaluations
        # What is left when the search must end is for the check.
        until = self.budget.leaving(_CHECK_TIME * program.model.task.n, _CHECK_SHARE)
        minimum = minimise(program, guess, options, until)
        self.budget.evaluations += program.evaluations - before
        candidate = Candidate(program, minimum.point)
        violation = float(minimum.point.violations[0])
        if self.closest is None or violation < self.closest.point.violations[0]:
            self.closest = candidate
        # Constants so extreme that a motion has no numbers leave its margins without meaning.
        finite = bool(np.isfinite(candidate.motion.position).all())
        return candidate, finite and violation <= _NEARLY_FEASIBLE * self._feasible

    def raised(self, candidate: Candidate) -> Candidate:
        """Minimise on with polynomials of the form's order, of which the candidate's are some."""
        low = candidate.program.model
        if low.order >= self.form.order or self.budget.spent:
            return candidate
        model = self.form.model(low.task)
        program = FormationProgram(model, self.form.nodes)
        z = model.raise_order(low, candidate.program.full(candidate.point.xi))
        better, converged = self._minimise(program, program.reduce(z), _REFINING_RADIUS)
        return better if converged else candidate

    def turned(self, candidate: Candidate) -> Candidate | None:
        """
        Let thrusters that point elsewhere turn first: the same motions after coasting.

        The time a thruster needs depends on the motion and the motion on the time: a few rounds.
        None if that is not feasible.
        """
        for spare in (1.0, 1.03, 1.1):
            model = candidate.program.model
            needed = self._needed_coast(model, candidate.motion)
            needed[~np.isnan(candidate.program.held[:, 0])] = 0.0
            # A thruster that is off by little turns on, thrusting, as the shooting reckons with.
            short = needed - _ALIGNED / self.task.thruster_rate
            kept = model.task.coast
            if ((short <= kept) & (kept <= 1.2 * needed + 0.1)).all():
                return candidate
            task = self.task.with_coast(spare * needed)
            program = FormationProgram(
                model.with_task(task), candidate.program.terms.nodes, held=candidate.program.held
            )
            again = program.reduce(candidate.program.full(candidate.point.xi))
            candidate, converged = self._minimise(program, again, _REFINING_RADIUS)
            if not converged:
                return None
        return candidate

    def refined(self, candidate: Candidate) -> Candidate | None:
        """Minimise again with the thruster's rate limited in the program; None if infeasible."""
        model = candidate.program.model
        nodes = candidate.program.terms.nodes
        program = FormationProgram(
            model, nodes, limit_thruster_rate=True, held=candidate.program.held
        )
        better, converged = self._minimise(program, candidate.point.xi, _REFINING_RADIUS)
        return better if converged else None
