# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The search for formations' plans by thrust arcs: rounded polylines, the shared minimiser."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property
import itertools
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.exceptions import Infeasible
from tdm_planner.problems.formation.polynomial_search import PolynomialSearch
from tdm_planner.problems.formation.search import Candidate, FormationSearch
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.thrust_arcs_kernels import WEAKEST
from tdm_planner.problems.formation.thrust_arcs_motion import (
    arc_trajectory,
    cleaned,
    fitted,
    remaining,
    resumed,
)
from tdm_planner.problems.formation.thrust_arcs_program import ArcProgram, HeldMotion
from tdm_planner.problems.formation.thrust_arcs_seeds import ArcSeeds, MANY, reseated
from tdm_planner.problems.formation.warm_start import kept_motions, LATE
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]
Arcs: TypeAlias = Candidate[ArcProgram]

FEW = 8  # robots up to which plans are looked for directly, without one of polynomials
_DESPERATE = 12  # random guesses, as long as nothing is found
_WORSE = 1.04  # times the best cost so far: a start that is nearly feasible there is aborted
_PROMISING = 1.01  # times the best cost: minima that are polished
_POLISHED = 2  # of them at most
_PENALTY, _PENALTY_MANY = 0.5, 3.0
_ROUGH, _FINE = 1e-3, 2e-4  # predicted decrease of J at which a minimum is one
_RADIUS, _POLISHING_RADIUS = 0.15, 0.1
_ITERATIONS = 50
_FEASIBLE = 1e-3  # violation at which the minimiser may end, whatever the tolerance


def arc_motions(candidate: Arcs, task: FormationTask) -> dict[str, Trajectory]:
    """Write the motions of a minimum out, of the robots that are not held."""
    program, values = candidate.program, candidate.point.cache
    weakest = WEAKEST * program.fleet.speed
    found = {}
    for i, name in enumerate(task.names):
        if i in program.held:
            continue
        duration, burns = float(values.x[i, -1]), np.zeros((0, 4))
        if program.varied[i]:
            burns = cleaned(task, i, values.burns[i], duration, weakest)
        found[name] = arc_trajectory(task, i, burns, duration)
    return found


def compile_arcs(task: FormationTask) -> None:
    """Compile the kernels or load them from the disk."""
    program = ArcProgram(task)
    guess = program.reduce(next(ArcSeeds(program, np.random.default_rng(0)).screened()))
    point = program.evaluate(guess)
    program.linearise(point, None)
    arc_motions(Candidate(program, point), task)


class ArcSearch(FormationSearch[Arcs | Solution]):
    """
    Local minima of one manoeuvre from screened and random guesses, and their plans.

    `polynomials` makes a search by the other method, whose minima are the guesses where robots are
    many, and whose plans the last resort. `reserve` is the share of the thrust that burns leave to
    the feedback. Of a `previous` plan with thrust arcs the rest is the initial guess; robots about
    to arrive keep theirs.
    """

    def __init__(
        self,
        task: FormationTask,
        rng: np.random.Generator,
        budget: Budget,
        polynomials: Callable[[], PolynomialSearch],
        reserve: float,
        **shared: Any,
    ) -> None:
        super().__init__(task, rng, budget, **shared)
        self.task = replace(task, thrust=(1.0 - reserve) * task.thrust)
        self.feasible = min(self.feasible, _FEASIBLE)
        self._make_polynomials = polynomials
        self._last: Infeasible | None = None
        if any(plan.interpolation != 'zero_order_hold' for plan in self.rest.values()):
            self.rest = {}
        directly = [self._minima] if task.n <= FEW else []
        first = [self._resumed, *directly] if self.rest else [*directly, self._again]
        self.rounds = [*first, self._near_polynomials, self._by_polynomials]

    @cached_property
    def _polynomials(self) -> PolynomialSearch:
        return self._make_polynomials()

    def _again(self) -> Iterable[Arcs]:
        """Minima with more distance kept, where plans failed the check."""
        return self._minima() if self.rejected else ()

    def _near_polynomials(self) -> Iterator[Arcs | Solution]:
        """Yield the minima with four burns a robot near those of polynomials, each before it."""
        program, options = ArcProgram(self.task, 4), self._options(_POLISHING_RADIUS)
        for polynomials in self._polynomials.candidates():
            motions = self._polynomials.motions(polynomials)
            near = fitted(program, {**motions, **self._polynomials.kept})
            candidate = self.minimised(program, program.reduce(near), options)
            if candidate is not None:
                yield candidate
            yield self._polynomials.assessed(motions, polynomials.point.xi)

    def _by_polynomials(self) -> Iterator[Solution]:
        """Yield the plan by the other method from further guesses."""
        try:
            yield self._polynomials.run()
        except Infeasible as error:
            self._last = error

    def _minima(self) -> list[Arcs]:
        """Feasible local minima, cheapest first, the most promising of them polished."""
        program = ArcProgram(self.task)
        seeds = ArcSeeds(program, self.rng)
        # On the way there is little time.
        more = (seeds.random() for _ in range(0 if self.rest else _DESPERATE))
        guesses = itertools.chain(itertools.islice(seeds.screened(), self.starts), more)
        found = self.minima(program, map(program.reduce, guesses), self._options(), _WORSE)
        for k, candidate in enumerate(found[:_POLISHED]):
            if candidate.cost < _PROMISING * found[0].cost and not self.budget.spent:
                found[k] = self._polished(candidate)
        return sorted(found, key=lambda each: each.cost)

    def _resumed(self) -> Iterator[Arcs]:
        """Yield the minimum that the rest of the plan before leads to."""
        task = self.task
        for half_turns in (1.0, LATE):
            fewer, self.kept = self.kept, kept_motions(task, self.rest, half_turns)
            if half_turns > 1.0 and len(self.kept) == len(fewer):
                break
            x = resumed(task, self.rest, self.kept)
            held = {
                task.names.index(name): HeldMotion(remaining(motion), motion.duration)
                for name, motion in self.kept.items()
            }
            count = max([(x.shape[1] + 4) // 3, *(len(each.burns) for each in held.values())])
            if count > (x.shape[1] + 4) // 3:
                break
            program = ArcProgram(task, count, held)
            options = self._options(_POLISHING_RADIUS)
            candidate = self.minimised(program, program.reduce(x), options)
            if candidate is not None:
                yield candidate

    def _options(self, radius: float = _RADIUS, accuracy: float = _ROUGH) -> TrustRegionOptions:
        return TrustRegionOptions(
            penalties=(_PENALTY if self.task.n < MANY else _PENALTY_MANY,),
            feasibility=(self.feasible,),
            radius=radius,
            iterations=_ITERATIONS,
            cost_tolerance=accuracy,
        )

    def _polished(self, candidate: Arcs) -> Arcs:
        """Minimise on, with corners where robots that fly straight touch others."""
        program, point = candidate.program, candidate.point
        for _ in range(2):
            x = reseated(program, point.cache)
            xi = candidate.point.xi if x is None else program.reduce(x)
            better = self.minimised(program, xi, self._options(_POLISHING_RADIUS, _FINE))
            if better is None or not better.cost < candidate.cost:
                break
            candidate, point = better, better.point
            if x is None:
                break
        return candidate

    def plans(self, candidate: Arcs | Solution) -> Iterator[Solution]:
        """Yield the plan of a candidate."""
        if isinstance(candidate, Solution):
            yield candidate
        else:
            yield self.assessed(arc_motions(candidate, self.task), candidate.point.xi)

    def promises_more(self, candidate: Arcs | Solution, than: Arcs | Solution) -> bool:
        """Whether a candidate is cheaper than one that is verified."""
        return candidate.cost < than.cost

    def failure(self) -> Infeasible:
        """Return why there is no plan, not even by polynomials."""
        return self._last if self._last is not None else super().failure()
