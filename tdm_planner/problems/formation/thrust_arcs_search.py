# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The search for formations' plans by thrust arcs: rounded polylines, the shared minimiser.

Initial guesses have one corner each, bowed to either side, and are screened together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property
import math
from typing import TypeAlias

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.trust_region import Minimum, TrustRegionOptions
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.formation.polynomial_search import PolynomialSearch
from tdm_planner.problems.formation.search import (
    FormationSearch,
    INSTANTS,
    kept_motions,
    screened,
)
from tdm_planner.problems.formation.task import DRIFT
from tdm_planner.problems.formation.thrust_arcs_kernels import (
    Fleet,
    positions,
    round_off,
    WEAKEST,
)
from tdm_planner.problems.formation.thrust_arcs_program import (
    arc_trajectory,
    cleaned,
    fitted,
    remaining,
    resumed,
    ThrustArcProgram,
)
from tdm_planner.problems.solution import Solution

MANY = 5  # robots from which on more is tried, and violations are charged more
_BOWS = np.array([0.0, 0.12, -0.12, 0.25, -0.25])  # as shares of the way
_OVERLAP = 0.35  # price of coming too near by a unit of length, in costs
_SPARE = 1.02  # clearances wanted of a guess
_MEETING = 1.1  # clearances within which it matters on which side robots pass
_LEAST_BOW = 1.2  # units of length: bows of short ways are shares of that
Arcs: TypeAlias = Minimum[ThrustArcProgram]
FEW = 8  # robots up to which plans are looked for directly, without one of polynomials
_MORE_STARTS = 4  # times as many initial guesses where robots are many: passing sides decide
_DESPERATE = 12  # random guesses, as long as nothing is found
_FIRST = 0.25  # half-turns of the thruster before the first burn
_LONGER = 1.3  # times the usual durations, up to which theirs are
_WORSE = 1.04  # times the best cost so far: a start that is nearly feasible there is aborted
_PENALTY, _PENALTY_MANY = 0.5, 3.0
_ACCURACY = 1e-3  # predicted decrease of J at which a minimum is one
_RADIUS, _POLISHING_RADIUS = 0.15, 0.1
_ITERATIONS = 50
_FEASIBLE = 1e-3  # violation at which the minimiser may end, whatever the tolerance


@compiled
def _survey(choices: Array, fleet: Fleet, times: Array) -> tuple[Array, Array]:
    """Paths (n, c, K, 2) and gas (n, c) of every robot's choices (n, c, v)."""
    (n, count, v), burns = choices.shape, fleet.held.copy()
    paths, gas = np.zeros((n, count, times.size, 2)), np.zeros((n, count))
    slopes = np.zeros((burns.shape[1], 4, v))
    for i in range(n):
        for c in range(count):
            if fleet.varied[i]:
                round_off(choices[i, c], fleet, i, burns[i], slopes)
            paths[i, c] = positions(times, fleet, i, burns)
            for k in range(burns.shape[1]):
                gas[i, c] += np.hypot(burns[i, k, 0], burns[i, k, 1])
    return paths, gas


def guesses(
    program: ThrustArcProgram, rng: np.random.Generator, most: int, drawn: int
) -> Iterator[Array]:
    """
    Yield initial guesses x (n, 5) for a program with three burns a robot.

    `most` screened ones at most, each the best of its set of sides, the best set first; then
    `drawn` ones with random corners and durations.
    """
    task, fleet, n = program.task, program.manoeuvre, program.task.n
    leg = math.pi / fleet.rate
    begun = task.start + DRIFT * leg * task.velocity
    usual, way = program.usual_durations(), task.goal - begun
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1)
    size = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    normal *= np.maximum(1.0, _LEAST_BOW * fleet.length / size)[:, None]

    def guess(share: Array, bow: Array, durations: Array) -> Array:
        """Parameters (n, 5): corners at shares of way and time, off by bows."""
        x = np.zeros((n, 5))
        corner = begun + share[:, None] * way + bow[:, None] * normal
        corner = np.clip(corner, program.low, program.high)
        first = np.linalg.norm(corner - task.start, axis=1)
        last = np.linalg.norm(task.goal - corner, axis=1)
        share = first / np.maximum(first + last, 1e-9)
        x[:, 0], x[:, 3], x[:, 4] = _FIRST * leg, share * durations, durations
        x[:, 1:3] = corner
        return x

    x = np.stack([guess(np.full(n, 0.5), np.full(n, bow), usual) for bow in _BOWS], axis=1)
    paths, gas = _survey(x, fleet, np.linspace(0.0, usual.max(), INSTANTS))
    price = _OVERLAP * program.scale / fleet.length
    alike = np.zeros(_BOWS.size)  # a detour that avoids no robot gives no other minimum
    given = paths, task.weights[2] * gas, alike, _MEETING, _SPARE, price, rng
    for chosen in screened(program, *given)[:most]:
        yield x[np.arange(n), chosen]
    for _ in range(drawn):
        corners = rng.uniform(0.3, 0.7, n), rng.uniform(-0.3, 0.3, n)
        yield guess(*corners, usual * rng.uniform(1.0, _LONGER))


class ArcSearch(FormationSearch[Arcs | Solution]):
    """
    Local minima of one manoeuvre from screened and random guesses, and their plans.

    Minima by polynomials are the guesses where robots are many, and plans by them the last resort.
    Of a `previous` plan with thrust arcs the rest is the initial guess; robots about to arrive
    keep theirs.
    """

    def prepared(self) -> list[Callable[[], Iterable[Arcs | Solution]]]:
        """Return what makes the candidates of each round."""
        task = self.task
        self.task = replace(task, thrust=(1.0 - self.settings.thrust_reserve) * task.thrust)
        self.feasible = min(self.feasible, _FEASIBLE)
        self._options = TrustRegionOptions(
            penalties=(_PENALTY if task.n < MANY else _PENALTY_MANY,),
            feasibility=(self.feasible,),
            radius=_RADIUS,
            iterations=_ITERATIONS,
            cost_tolerance=_ACCURACY,
        )
        if any(plan.interpolation != 'zero_order_hold' for plan in self.rest.values()):
            self.rest = {}
        if task.n >= MANY and not self.rest:
            self.starts *= _MORE_STARTS
        resumed = [self._resumed] if self.rest else []
        directly = [self._minima] if task.n <= FEW else []
        return [*resumed, *directly, self._near_polynomials, lambda: [self._polynomials.run()]]

    @cached_property
    def _polynomials(self) -> PolynomialSearch:
        given = self._original_task, self.settings, self.rng, self.budget, self.previous
        return PolynomialSearch(*given)

    def _near_polynomials(self) -> Iterator[Arcs | Solution]:
        """Yield the minima with four burns a robot near those of polynomials, each before it."""
        program, search = ThrustArcProgram(self.task, 4), self._polynomials
        for polynomials in search.candidates():
            motions = search.motions(polynomials)
            near = fitted(program, {**motions, **search.kept})
            yield from self._polished(program, program.reduce(near))
            yield search.assessed(motions, polynomials.point.xi)

    def _minima(self) -> list[Arcs]:
        """Feasible local minima, cheapest first."""
        program = ThrustArcProgram(self.task)
        drawn = 0 if self.rest else _DESPERATE  # on the way there is little time
        first = map(program.reduce, guesses(program, self.rng, self.starts, drawn))
        return self.minima(program, first, self._options, _WORSE)

    def _resumed(self) -> Iterator[Arcs]:
        """Yield the minimum that the rest of the plan before leads to."""
        self.kept = kept_motions(self.task, self.rest)
        x = resumed(self.task, self.rest, self.kept)
        count = (x.shape[1] + 4) // 3
        if all(len(remaining(motion)) <= count for motion in self.kept.values()):
            program = ThrustArcProgram(self.task, count, self.kept)
            yield from self._polished(program, program.reduce(x))

    def _polished(self, program: ThrustArcProgram, xi: Array) -> list[Arcs]:
        """Return the minimum near Xi, if there is one."""
        return self.minimised(program, xi, self._options._replace(radius=_POLISHING_RADIUS))

    def plans(self, candidate: Arcs | Solution) -> Iterator[Solution]:
        """Yield the plan of a candidate."""
        if isinstance(candidate, Solution):
            yield candidate
            return
        program, values, motions = candidate.program, candidate.point.cache, {}
        weakest = WEAKEST * program.manoeuvre.speed
        for i, name in enumerate(self.task.names):
            if program.kept[i]:
                continue
            duration, burns = float(values.x[i, -1]), np.zeros((0, 4))
            if program.varied[i]:
                burns = cleaned(self.task, i, values.burns[i], duration, weakest)
            motions[name] = arc_trajectory(self.task, i, burns, duration)
        yield self.assessed(motions, candidate.point.xi)
