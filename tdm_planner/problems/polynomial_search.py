# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The search for formations' plans by polynomials: first guesses simply, the best in full."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
import itertools
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.problems.base import Solution
from tdm_planner.problems.formation_plan import initial_misalignment, trajectory
from tdm_planner.problems.formation_program import FormationProgram
from tdm_planner.problems.formation_search import Candidate, FormationSearch
from tdm_planner.problems.formation_seeds import BowSeeds
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.reference_motion import FormationMotion, MotionForm, ReferenceMotion
from tdm_planner.problems.warm_start import (
    kept_motions,
    LATE,
    rest_of,
    turning_time,
    warm_parameters,
)
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]
Polynomials: TypeAlias = Candidate[FormationProgram]

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
_ITERATIONS, _WARM_ITERATIONS = 60, 30
_MORE_MARGIN = 0.04  # of the separation, that is kept more where plans came too near
_NEARLY = 4.0  # times the accuracy of the end aimed at
_ANOTHER = 1.3  # times as long as its check another candidate takes at least


class PolynomialSearch(FormationSearch[Polynomials]):
    """
    Local minima of one manoeuvre from several first guesses, and their plans.

    First guesses are minimised with polynomials of a low order, the best of them go on with that
    of the `form`. Of a `previous` plan the remaining motion is the first guess, without others at
    first.
    """

    def __init__(
        self,
        task: FormationTask,
        form: MotionForm,
        rng: np.random.Generator,
        budget: Budget,
        previous: Solution | None = None,
        **shared: Any,
    ) -> None:
        super().__init__(task, rng, budget, **shared)
        self.form = form
        self._rounds = 1
        self._found = False
        self._rest = {} if previous is None else rest_of(task, previous)
        self._first: Array | None = None
        self._kept: dict[str, Trajectory] = {}
        self._held: Array | None = None
        self._late = kept_motions(task, self._rest, LATE)
        self._half_turns = _LAST_LEG
        self._check_time = 0.0  # of the last candidate: writing it out and checking it
        simple = form.of_order(min(form.order, _SIMPLE))
        self._aim(task, form if self._rest else simple)
        self._resume()
        # A plan that is to replace another on the way, and may be replaced, must be there soon.
        self._enough = _NEARLY if self._rest else 1.0

    def _aim(self, task: FormationTask, form: MotionForm) -> None:
        self.task, self._form = task, form
        self._kept, self._held = {}, None
        self._use(task)
        self.seeds = BowSeeds(self.model, self.rng)
        self._guesses = iter(self.seeds)

    def _use(self, task: FormationTask) -> None:
        self.model = ReferenceMotion(task, self._form)
        self.program = FormationProgram(self.model, self._held)

    def _resume(self) -> None:
        """
        Take the remaining motion of a plan for the first guess, and nothing else for now.

        Robots about to arrive keep theirs; the turning that the guess needs is reckoned with from
        the outset.
        """
        if not self._rest:
            return
        self._first = warm_parameters(self.model, self.seeds.durations, self._rest)
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
        late = self._half_turns >= LATE
        return self._first is not None and not late and len(self._late) > len(self._kept)

    def _needed_coast(self, model: ReferenceMotion, motion: FormationMotion) -> Array:
        """Time [s] that every thruster needs to turn before a motion begins (n,)."""
        angle = initial_misalignment(model, motion)
        needed = angle / (_TURNING_SHARE * self.task.thruster_rate)
        return np.where(angle > _ALIGNED, needed + 0.01 * motion.durations, 0.0)

    def candidates(self) -> Iterator[Polynomials]:
        """Yield minima with thrusters turned first; then, did none do, with more distance kept."""
        guesses: Iterable[Array] = [self._first] if self._first is not None else ()
        guesses = guesses or itertools.islice(self._guesses, self.starts)
        reduced = map(self.program.reduce, guesses)
        found = self.minima(self.program, reduced, self._options(_RADIUS), _WORSE)
        self._found = bool(found)
        kept = []
        for candidate in map(self._raised, found):
            kept.append(self._turned(candidate) or candidate)
            yield kept[-1]
        late = self.budget.remaining < _ANOTHER * self._check_time
        if not (self._may_keep_more or late):
            yield from filter(None, map(self._farther, kept))

    def plans(self, candidate: Polynomials) -> Iterator[Solution]:
        """Yield the trajectories that the reference motions give by inverse dynamics."""
        model, motion = candidate.program.model, candidate.program.motion(candidate.point.xi)
        careful = not self._may_keep_more
        began = self.budget.elapsed
        motions = {
            name: self._kept[name]
            if name in self._kept
            else trajectory(model, motion, i, self.budget, self._enough, careful)
            for i, name in enumerate(self._required.names)
        }
        plan = self.assessed(motions, candidate.point.xi)
        self._check_time = self.budget.elapsed - began
        yield plan

    def widen(self) -> bool:
        """
        Keep more distance, where plans failed the check; else go on with other guesses.

        Where the rest of an earlier plan did not do, more robots keep theirs, then polynomials of
        higher order are tried, then guesses, one by one: on the way there is little time.
        """
        if self.budget.remaining < _ANOTHER * self._check_time:
            return False
        if self._may_keep_more:
            self._half_turns = LATE
            self._aim(self._required, self.form)
            self._resume()
            return True
        simple = self.form.of_order(min(self.form.order, _SIMPLE))
        if self._first is not None and self._form == self.form and self.form.order <= 15 - _RAISE:
            self._aim(self._required, self.form.of_order(self.form.order + _RAISE))
            self._resume()
            return True
        self._rounds += 1
        if self._first is not None:
            self._first, self.starts = None, 1
            self._aim(self._required, simple)
        elif self._found and not self._rest:
            self._aim(self._keeping_more(self.task), simple)
        return self._rounds <= _ROUNDS

    @staticmethod
    def _keeping_more(task: FormationTask) -> FormationTask:
        return replace(task, margin=task.margin + _MORE_MARGIN * task.separation)

    def _farther(self, candidate: Polynomials) -> Polynomials | None:
        """Minimise on, keeping more distance: a slow thruster leads robots off their motions."""
        model = candidate.program.model
        farther = model.with_task(self._keeping_more(model.task))
        program = FormationProgram(farther, candidate.program.held)
        return self.minimised(program, candidate.point.xi, self._options(_REFINING_RADIUS))

    def _options(self, radius: float) -> TrustRegionOptions:
        return TrustRegionOptions(
            penalties=(3.0 if self.task.n >= _MANY else 1.0,),
            feasibility=(self.feasible,),
            radius=radius,
            iterations=_ITERATIONS if self._first is None else _WARM_ITERATIONS,
        )

    def _raised(self, candidate: Polynomials) -> Polynomials:
        """Minimise on with polynomials of the form's order, of which the candidate's are some."""
        low = candidate.program.model
        if low.order >= self.form.order or self.budget.spent:
            return candidate
        model = ReferenceMotion(low.task, self.form)
        program = FormationProgram(model)
        z = program.reduce(model.raise_order(low, candidate.program.full(candidate.point.xi)))
        return self.minimised(program, z, self._options(_REFINING_RADIUS)) or candidate

    def _turned(self, candidate: Polynomials) -> Polynomials | None:
        """
        Let thrusters that point elsewhere turn first: the same motions after coasting.

        The time a thruster needs depends on the motion and the motion on the time: a few rounds.
        None if that is not feasible.
        """
        held = candidate.program.held
        for spare in (1.0, 1.03, 1.1):
            program, xi = candidate.program, candidate.point.xi
            needed = self._needed_coast(program.model, program.motion(xi))
            needed[~np.isnan(held[:, 0])] = 0.0
            # A thruster that is off by little turns on, thrusting, as the shooting reckons with.
            short = needed - _ALIGNED / self.task.thruster_rate
            kept = program.model.task.coast
            if ((short <= kept) & (kept <= 1.2 * needed + 0.1)).all():
                return candidate
            task = self.task.with_coast(spare * needed)
            later = FormationProgram(program.model.with_task(task), held)
            again = later.reduce(program.full(xi))
            better = self.minimised(later, again, self._options(_REFINING_RADIUS))
            if better is None:
                return None
            candidate = better
        return candidate
