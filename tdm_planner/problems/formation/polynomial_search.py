# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The search for formations' plans by polynomials: first guesses simply, the best in full."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
import itertools
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bases import PolynomialBasis, PowerProducts
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.problems.formation.polynomial_plan import initial_misalignment, trajectory
from tdm_planner.problems.formation.program import PolynomialProgram
from tdm_planner.problems.formation.reference_motion import (
    FormationMotion,
    MotionForm,
    ReferenceMotion,
)
from tdm_planner.problems.formation.search import Candidate, FormationSearch
from tdm_planner.problems.formation.seeds import INSTANTS, screened
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.warm_start import kept_motions, LATE, warm_parameters
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]
Polynomials: TypeAlias = Candidate[PolynomialProgram]

BOWS = np.array([0.1, -0.1, 0.22, -0.22])
_LONGER = 0.75  # what a bow costs, in separations
_WANTED = 0.98  # clearances wanted of a guess: minimising gains what is left
_TOO_NEAR = 3.0  # price of a metre by which robots come too near
_TURNING_SHARE = 0.95  # of the thruster's rate, at which it turns before a manoeuvre
_ALIGNED = 0.1  # [rad] less than this the thruster turns on the way
_MANY = 12  # robots from which on violations are charged more
_RADIUS, _REFINING_RADIUS = 0.15, 0.05
_ROUNDS = 4  # of guesses, before giving up
_SIMPLE = 7  # order of the polynomials with which first guesses are minimised
_RAISE, _HIGHEST = 4, 15  # by which the order is raised where the rest of a plan did not do
_WORSE = 1.1  # times the best cost so far: a start that is nearly feasible there is aborted
_ITERATIONS, _WARM_ITERATIONS = 60, 30
_NEARLY = 4.0  # times the accuracy of the end aimed at


class PolynomialSearch(FormationSearch[Polynomials]):
    """
    Local minima of one manoeuvre from several first guesses, and their plans.

    Initial guesses are minimised with polynomials of a low order, the best of them go on with that
    of the `form`. Of a `previous` plan the remaining motion is the initial guess, with polynomials
    of higher order where those of the form do not do, and then one new guess after the other.
    """

    def __init__(
        self,
        task: FormationTask,
        form: MotionForm,
        rng: np.random.Generator,
        budget: Budget,
        **shared: Any,
    ) -> None:
        super().__init__(task, rng, budget, **shared)
        self.form = form
        self._simple = form.of_order(min(form.order, _SIMPLE))
        higher = form.of_order(min(form.order + _RAISE, _HIGHEST))
        self._guesses: tuple[FormationTask, PolynomialProgram, Iterator[Array]] | None = None
        self._careful = True  # whether to do all that can be done for a candidate
        # A plan that is to replace another on the way, and may be replaced, must be there soon.
        self._enough = _NEARLY if self.rest else 1.0
        if self.rest:
            self.starts = 1
            self.rounds = [partial(self._resumed, each) for each in (form, higher)]
        self.rounds += [self._minima] * _ROUNDS

    def _minima(self) -> Iterator[Polynomials]:
        """Yield minima from further guesses; then with more distance kept."""
        if self._guesses is None or self._guesses[0] is not self.task:
            program = PolynomialProgram(ReferenceMotion(self.task, self._simple))
            self._guesses = self.task, program, guesses(program, self.rng)
        _, program, further = self._guesses
        first = map(program.reduce, itertools.islice(further, self.starts))
        found = self.minima(program, first, self._options(_RADIUS), _WORSE)
        return self._completed(map(self._raised, found))

    def _resumed(self, form: MotionForm) -> Iterator[Polynomials]:
        """
        Yield the minimum that the remaining motion of a plan leads to.

        Robots about to arrive keep theirs, more of them where that does not do; the turning that
        the guess needs is reckoned with from the outset.
        """
        model = ReferenceMotion(self.task, form)
        x = warm_parameters(model, PolynomialProgram(model).usual_durations(), self.rest)
        coast = self._needed_coast(model, model.unpack(x))
        few, more = (kept_motions(self.task, self.rest, turns) for turns in (1.0, LATE))
        # With higher polynomials, and where no more robots can keep theirs, this is the last try.
        for last in (False, True) if form is self.form and len(more) > len(few) else (True,):
            self.kept, self._careful = more if last else few, last
            kept = np.array([name in self.kept for name in self.task.names])
            task = self.task.with_coast(np.where(kept, 0.0, 1.03 * coast))
            held = np.where(kept[:, None], x, np.nan)
            program = PolynomialProgram(ReferenceMotion(task, form), held)
            options = self._options(_RADIUS, _WARM_ITERATIONS)
            found = self.minimised(program, program.reduce(x), options)
            yield from self._completed([] if found is None else [found])

    def _completed(self, found: Iterable[Polynomials]) -> Iterator[Polynomials]:
        """Yield minima with thrusters turned first; then with more distance kept."""
        turned = []
        for candidate in found:
            turned.append(self._turned(candidate) or candidate)
            yield turned[-1]
        if self._careful:
            yield from filter(None, map(self._apart, turned))

    def _needed_coast(self, model: ReferenceMotion, motion: FormationMotion) -> Array:
        """Time [s] that every thruster needs to turn before a motion begins (n,)."""
        angle = initial_misalignment(model, motion)
        needed = angle / (_TURNING_SHARE * self.task.thruster_rate)
        return np.where(angle > _ALIGNED, needed + 0.01 * motion.durations, 0.0)

    def plans(self, candidate: Polynomials) -> Iterator[Solution]:
        """Yield the plan of a candidate."""
        yield self.assessed(self.motions(candidate), candidate.point.xi)

    def motions(self, candidate: Polynomials) -> dict[str, Trajectory]:
        """Return the motions that inverse dynamics make of a candidate, but for those kept."""
        model, motion = candidate.program.model, candidate.program.motion(candidate.point.xi)
        return {
            name: trajectory(model, motion, i, self.budget, self._enough, self._careful)
            for i, name in enumerate(self.task.names)
            if name not in self.kept
        }

    def _apart(self, candidate: Polynomials) -> Polynomials | None:
        """Minimise on, keeping more distance: a slow thruster leads robots off their motions."""
        model = candidate.program.model
        program = PolynomialProgram(
            model.with_task(self.farther(model.task)), candidate.program.held
        )
        return self.minimised(program, candidate.point.xi, self._options(_REFINING_RADIUS))

    def _options(self, radius: float, iterations: int = _ITERATIONS) -> TrustRegionOptions:
        return TrustRegionOptions(
            penalties=(3.0 if self.task.n >= _MANY else 1.0,),
            feasibility=(self.feasible,),
            radius=radius,
            iterations=iterations,
        )

    def _raised(self, candidate: Polynomials) -> Polynomials:
        """Minimise on with polynomials of the form's order, of which the candidate's are some."""
        low = candidate.program.model
        if low.form.order >= self.form.order or self.budget.spent:
            return candidate
        program = PolynomialProgram(ReferenceMotion(low.task, self.form))
        x = program.model.raise_order(low, candidate.program.full(candidate.point.xi))
        refining = self._options(_REFINING_RADIUS)
        return self.minimised(program, program.reduce(x), refining) or candidate

    def _turned(self, candidate: Polynomials) -> Polynomials | None:
        """
        Let thrusters that point elsewhere turn first: the same motions after coasting.

        The time a thruster needs depends on the motion and the motion on the time: a few rounds.
        None if that is not feasible.
        """
        for spare in (1.0, 1.03, 1.1):
            program, xi = candidate.program, candidate.point.xi
            needed = self._needed_coast(program.model, program.motion(xi))
            needed[program.kept] = 0.0
            # A thruster that is off by little turns on, thrusting, as the shooting reckons with.
            short = needed - _ALIGNED / self.task.thruster_rate
            coast = program.task.coast
            if ((short <= coast) & (coast <= 1.2 * needed + 0.1)).all():
                return candidate
            task = program.task.with_coast(spare * needed)
            later = PolynomialProgram(program.model.with_task(task), program.held)
            again = later.reduce(program.full(xi))
            better = self.minimised(later, again, self._options(_REFINING_RADIUS))
            if better is None:
                return None
            candidate = better
        return candidate


def guesses(program: PolynomialProgram, rng: np.random.Generator) -> Iterator[Array]:
    """
    Yield first guesses x (n, P): quintic motions bowed to either side by shares of their ways.

    Screened ones come first, best first, then random bows without end.
    """
    task, model = program.task, program.model
    durations = program.usual_durations()

    def bowed(bows: Array, s: Array, derivative: int = 0) -> Array:
        """Motions (n, c, 2, K) bowed by `bows` (n, c), or a derivative, at arcs s (n, K)."""
        way = task.goal - task.departure
        conditions = np.stack(
            [task.departure, durations[:, None] * task.velocity, task.goal], axis=-1
        )
        quintic = PolynomialBasis.of((0, 1, 2), (0, 1, 2)).values(s, derivative)[..., [0, 1, 3]]
        straight = conditions @ np.swapaxes(quintic, 1, 2)
        normal = np.stack([-way[:, 1], way[:, 0]], axis=1)
        power = 2 if model.form.vary_ends or model.form.order < 7 else 3
        # One in the middle of the arc.
        bump = (-4.0) ** power * PowerProducts(((power, power),)).values(s, derivative)[..., 0]
        side = bows[..., None, None] * normal[:, None, :, None] * bump[:, None, None]
        return np.asarray(straight[:, None] + side)

    def fit(bows: Array) -> Array:
        def bend(s: Array) -> Array:
            return bowed(bows[:, None], np.broadcast_to(s, (task.n, s.size)), 2)[:, 0]

        return model.fit(np.repeat(durations[:, None], model.nb, axis=1), bend)

    t = np.linspace(0.0, (durations + task.coast).max(), INSTANTS)
    s = np.clip((t - task.coast[:, None]) / durations[:, None], 0.0, 1.0)
    paths = bowed(np.broadcast_to(BOWS, (task.n, BOWS.size)), s)
    reach = task.separation / 2
    outside = np.maximum(reach - paths, paths - task.sides[:, None] + reach).max(axis=(2, 3))
    single = _LONGER * np.abs(BOWS) * task.separation + _TOO_NEAR * np.maximum(outside, 0.0)
    paths = np.ascontiguousarray(np.swapaxes(paths, 2, 3))
    for chosen in screened(program, paths, single, BOWS, np.inf, _WANTED, _TOO_NEAR, rng):
        yield fit(BOWS[chosen])
    while True:
        yield fit(rng.uniform(-0.35, 0.35, task.n))
