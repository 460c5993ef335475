# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The direct method's part of the search: initial guesses, random changes of them, and minima."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
import itertools

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.bases import chebyshev_nodes
from tdm_planner.direct_method.collocation import CollocatedMotion
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import NotFinite
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import FIRST
from tdm_planner.problems.direct.statement import check_costs, check_dynamics

_GUESS_NODES = 25
_STIFF = 1e9  # times its size, beyond which an integrated state has left the range of numbers
_DENSITIES = 1, 4  # the second where integrated states leave the range of numbers
_TIGHT = TrustRegionOptions(
    penalties=(5.0, 5.0),
    largest_penalty=1e4,
    radius=0.5,
    iterations=150,
    cost_tolerance=1e-7,
    corrections=2,
)
_LOOSE = _TIGHT._replace(
    iterations=8, cost_tolerance=1e-2, feasibility=(1e-3, 1e-3), corrections=1
)
_CHANGE = 0.15, 0.5  # of the initial guess, in its units: without and with conditions at the ends
_SMALLER = 0.2, 0.1, 0.05  # changes along which what is stated is looked at once more
_CHANGES = 10  # of an initial guess that is not finite everywhere
_FEASIBLE = 1e-6  # violation at which the tight minimiser is content,
_PROMISING = 1e-5  # and up to which the check may pass
_HASTY = 1.5  # times the shortest duration: a minimum there has not found a motion
_SCREENED = 64  # random initial guesses of which the one nearest to the end conditions is kept


class DirectMinima:
    """
    Minima of the direct method for one problem; `budget` counts what they took.

    `program` is that on the nodes at which limits are kept; `rough` that of a first look, on
    `density` times as many nodes as usual; `changed` a changed initial guess to look along. Xi of
    rough minima that are feasible but for little are `in_sight`. `nearest_miss` says what the
    minimum violates that is nearest to a feasible motion.

    Making them raises NotFinite if the initial guess and its changes give numbers that are not
    finite.
    """

    def __init__(
        self,
        plant: DirectPlant,
        tolerance: float,
        budget: Budget,
        rng: np.random.Generator,
    ) -> None:
        self._tolerance, self._budget, self._rng = tolerance, budget, rng
        self._plant, self._stated, self._trace = plant, plant.stated, plant.trace
        self._problem = plant.stated.formulation
        self.in_sight: list[Array] = []
        self._closest, self.nearest_miss = np.inf, ''
        self.density, self.rough, self.changed = self._begun()
        steering = self.rough.has_end_conditions
        self._loose = _LOOSE._replace(steering=steering)
        feasibility = (tolerance, _FEASIBLE)
        self._tight = _TIGHT._replace(steering=steering, feasibility=feasibility)

    def check(self) -> None:
        """Raise InvalidProblem if what is stated contradicts itself along the initial guess."""
        smaller = (self._change(self.rough, size) for size in _SMALLER)
        check_dynamics(self.rough, itertools.chain([self.changed], smaller))
        check_costs(self._trace, self.rough.motion(self.changed), self._plant.numbers)

    def on(self, nodes: Array) -> Transcription:
        """Return the program on other nodes; its cost is not scaled."""
        return Transcription(self._problem, nodes, None, self._trace, self._plant.kept_at_ends)

    @cached_property
    def program(self) -> Transcription:
        """Return the program on the nodes of the direct method's own plans."""
        outputs = self._stated.outputs().values()
        free = max(o.free if o.shapes is None else o.shapes.size for o in outputs)
        count = self.density * max(self._problem.nodes, 3 * free + 15)
        return self.rough.refine(chebyshev_nodes(count), {})

    def _begun(self) -> tuple[int, Transcription, Array]:
        """
        Return the rough program and a change of the initial guess to check it along.

        Its cost is scaled at the initial guess, or at a change of it that is finite everywhere.
        """
        refusals = []
        for density in _DENSITIES:
            program = self.on(chebyshev_nodes(density * _GUESS_NODES))
            for size in (0.0, *np.linspace(0.1, 1.0, _CHANGES)):
                xi = self._change(program, float(size)) if size else program.first_guess
                try:
                    program.begin(xi)
                    return density, program, xi if size else self._change(program, 0.5)
                except NotFinite as error:
                    refusals.append(error)
            if not program.integrated:
                break
        raise refusals[0]

    def minimise_roughly(self, attempt: int) -> Minimum[Transcription] | None:
        """Minimise roughly from the initial guess or, from `attempt` 1 on, a change of it."""
        program = self.rough
        size = min(_CHANGE[program.has_end_conditions] * attempt, 1.0)
        xi = self._change(program, size) if attempt else program.first_guess
        minimum = self._minimise(program, xi, self._budget, self._loose)
        if minimum is not None and minimum.point.violation <= self._loose.feasibility[0]:
            self.in_sight.append(minimum.point.xi)
        return minimum

    @cached_property
    def _halves(self) -> Transcription:
        """Return the program on the ends and middles of the first intervals."""
        return self.on(np.linspace(0.0, 1.0, 2 * FIRST * self.density + 1))

    def collocated(self, xi: Array) -> Iterator[CollocatedMotion]:
        """Yield the motion of Xi on the first intervals, if it is finite and takes some time."""
        motion = self._halves.motion(xi)
        times = motion.times[:: self.density]
        even = np.linspace(0.0, times[-1], times.size)
        states, controls = (
            np.stack([np.interp(even, times, c) for c in values[:: self.density].T], axis=-1)
            for values in (motion.states, motion.controls)
        )
        for name, state in self._stated.integrated().items():
            column = states[:, self._stated.state_names.index(name)]
            if not np.abs(column).max() < _STIFF * (state.scale + abs(state.start)):
                column[:] = state.start  # too stiff for steps between nodes
        found = CollocatedMotion(states[::2], states[1::2], controls[::2], float(even[-1]))
        given = self._stated.duration()
        bounded = given.fixed or given.shortest is not None
        finite = np.isfinite(states).all() and np.isfinite(controls).all()
        if finite and found.duration > (0.0 if bounded else _HASTY * given.bounds[0]):
            yield found

    def minimise_fully(
        self, program: Transcription, xi: Array, budget: Budget
    ) -> Minimum[Transcription] | None:
        """Minimise to the end; None where nothing can be computed."""
        return self._minimise(program, xi, budget, self._tight)

    def _minimise(
        self, program: Transcription, xi: Array, budget: Budget, options: TrustRegionOptions
    ) -> Minimum[Transcription] | None:
        if not np.isfinite(program.evaluate(xi).cost):
            return None
        budget.evaluations += 1
        with np.errstate(all='ignore'):
            return minimise(program, xi, options, budget)

    def feasible(self, minimum: Minimum[Transcription]) -> bool:
        """Whether the check of a minimum may pass."""
        ends, margins = minimum.point.violations
        tolerance = max(self._tolerance, _PROMISING)
        return bool(ends <= tolerance and margins <= _PROMISING)

    def note_miss(self, minimum: Minimum[Transcription]) -> None:
        """Keep what a minimum violates if it is the nearest to a feasible motion so far."""
        if self.feasible(minimum) or not minimum.point.violation < self._closest:
            return
        program, (shortest, longest) = minimum.program, self._plant.durations
        self._closest, fixed = minimum.point.violation, shortest == longest
        allowed = f'{longest:.4g} s' if fixed else f'{shortest:.3g} to {longest:.3g} s'
        self.nearest_miss = (
            f'no initial guess led to a feasible motion of {allowed}; '
            f'the nearest violated {program.violated(minimum.point)}'
        )
        takes = program.motion(minimum.point.xi).times[-1]
        if takes > (1.0 - 1e-6) * longest and not fixed:
            self.nearest_miss += f' and took {longest:.3g} s, the longest that is allowed'

    def seeds(self, earlier: Array | None, plain: bool) -> Iterator[Array]:
        """
        Yield random changes of the initial guess, if `plain` after the unchanged guesses.

        Those are rough minima in sight, an `earlier` solution, the initial guess. With an earlier
        solution no changes are tried: replanning is to be quick.
        """
        program, first = self.program, self.program.first_guess
        if plain:
            yield from self.in_sight
            if earlier is not None and earlier.shape == first.shape:
                yield from (earlier, first)
                return
            yield first
        for attempt in range(1, self._problem.starts):
            if program.has_end_conditions:
                sizes = np.exp(self._rng.uniform(np.log(0.1), np.log(1.5), _SCREENED))
                guesses = self._changed(program, sizes)
                yield min(guesses, key=lambda xi: float(program.evaluate(xi).violations[0]))
            else:
                yield self._change(program, min(0.15 * attempt, 1.0))

    def _change(self, program: Transcription, size: float) -> Array:
        return np.asarray(self._changed(program, np.array([size]))[0])

    def _changed(self, program: Transcription, sizes: Array) -> Array:
        """Random changes of the initial guess, about `sizes` (count,) in its units, (count, n)."""
        first, timing = program.first_guess, program.basis.timing
        longer = np.exp(0.4 * self._rng.normal(size=(sizes.size, 1)) + 0.2)
        change = self._rng.normal(size=(sizes.size, first.size))
        change *= 3.0 * sizes[:, None] / np.sqrt(first.size)
        return np.hstack([first[:timing] * longer, first[timing:] + change[:, timing:]])
