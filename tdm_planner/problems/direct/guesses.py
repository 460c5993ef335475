# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Initial guesses of collocation that are not of the direct method: bent lines, and rollouts.

Lines, and minima of the direct method, lead to few of the optima of a plant that must gather
energy in several swings, or turn more than once. A rollout is a motion of the plant under random
controls: sines of random amplitude, frequency and chirp, cut off at the limits, so that they are
close to bang-bang. Many are integrated at once; those are kept that come nearest to the goal,
until the instant at which they do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from tdm_planner.arrays import Array, largest_of_unit
from tdm_planner.direct_method.collocation import CollocatedMotion, Ends
from tdm_planner.direct_method.graphs import Call
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import COARSE, FIRST

TRIED = 8  # initial guesses after which there are rollouts, and which solutions must agree
# No further guess once over half of the solutions, so many at least, agree in cost within a share;
# or once so many (after TRIED guesses twice as many) are solved.
_AGREED, _ALIKE, _ENOUGH = 2, 1e-2, 6
# Kinds of initial guesses, in turn: so many; then as long as there is no plan, or once there is.
_BEFORE = ('direct', 'line') * (TRIED // 2)
_FAILED = 'line', 'rollout'
_AGAIN = 'rollout', 'rollout', 'direct', 'rollout'
_BENDS = 0.25, 0.5, 1.0, 2.0, 0.1, 0.25, 0.5, 3.0, 5.0  # of lines
_SCREENED = 32  # lines, past obstacles that motions leap over
_SMALL = 1e-3  # share of half the range by which controls of a line lie off its middle
_LEAST_BEND = 0.3  # added to a state's range, of which sines are a share
_LANES, _STEPS, _ROLLOUTS_KEPT = 128, 160, 12  # rollouts at once; RK4 steps of each; best of them
_DURATIONS = -1.0, 1.6  # logarithm of a rollout's duration over the one that is guessed
_PERIODS = 0.4, 8.0  # of a control, in a rollout
_CHIRP, _AMPLITUDE, _OFFSET = 0.6, (0.5, 4.0), 0.3
_SHORTEST = 8  # part of a rollout that a motion takes at least
_WORTH = 20  # evaluations of a motion that a batch is worth
_NOWHERE = 1e3  # standard deviations that a condition is off by where it is no number


class Guesses:
    """Lines and rollouts of a plant between given `ends`, random by `seed`."""

    def __init__(self, plant: DirectPlant, ends: Ends, budget: Budget, seed: int) -> None:
        self._plant, self._ends, self._budget, self._seed = plant, ends, budget, seed
        self._duration = plant.stated.duration().guess
        limits = plant.control_range
        limits = np.where(np.isfinite(limits).all(axis=0), limits, [[-1.0], [1.0]])
        self._middle, self._half = limits.mean(axis=0), 0.5 * np.ptp(limits, axis=0)
        self._lines, self._rollouts = 0, self._batches()

    def kind(self, attempt: int, planned: bool) -> str:
        """Return what to try next: direct, line or rollout; `planned` once there is a plan."""
        kinds = _BEFORE if attempt < TRIED else _AGAIN if planned else _FAILED
        return kinds[attempt % len(kinds)]

    def line(self, *, straight: bool, screen: bool) -> CollocatedMotion:
        """
        Return a line, bent to either side of what may be in the way unless `straight`.

        With `screen` it is, of several, the one that leads through obstacles the least.
        """
        pair, side = divmod(self._lines, 2)
        self._lines += 1
        rng = np.random.default_rng([self._seed, pair])
        if straight:
            return self.bent(FIRST, 0.0, rng)
        bends = [_BENDS[(pair + k) % len(_BENDS)] for k in range(_SCREENED if screen else 1)]
        lines = (self.bent(FIRST, (-1.0) ** side * bend, rng) for bend in bends)
        return min(lines, key=self._blocked) if screen else next(lines)

    def _blocked(self, line: CollocatedMotion) -> float:
        """Return the sum of what a line violates obstacles by, in units of their largest value."""
        left = self._plant.limits(*line.halves)[:, self._plant.obstacles]
        worst = np.maximum(-left.min(axis=0), 0.0)
        return float((worst / np.abs(left).max(axis=0)).sum())

    def bent(self, intervals: int, bend: float, rng: np.random.Generator) -> CollocatedMotion:
        """
        Return lines between the given ends, bent by random sines of a share of their range.

        The range is the largest distance between the ends of a state of the same unit: a motion
        along one axis may have to give way along another. A state that is free at the end keeps
        its start value; one that is free at the start begins at 0.
        """
        s = np.linspace(0.0, 1.0, 2 * intervals + 1)[:, None]
        first, last = self._ends.states
        first, last = np.nan_to_num([first, np.where(np.isfinite(last), last, first)])
        states = first + (last - first) * s
        half = self._half
        controls = np.tile(self._middle + _SMALL * half, (s.size, 1))
        duration = self._duration
        if bend:
            alike = largest_of_unit(np.abs(last - first), self._plant.state_units)
            size = bend * (alike + _LEAST_BEND)
            for k in (1, 2, 3):
                states = states + size * rng.normal(size=first.size) * np.sin(k * np.pi * s) / k
                wave = np.cos(k * np.pi * s) / k
                controls = controls + bend * half * rng.normal(size=half.size) * wave
            duration *= float(np.exp(0.4 * rng.normal()))
        return CollocatedMotion(states[::2], states[1::2], controls[::2], duration)

    def rollout(self) -> CollocatedMotion | None:
        """Return the next rollout on a few more intervals; None if none is finite any more."""
        return next(self._rollouts, None)

    def _batches(self) -> Iterator[CollocatedMotion]:
        """Yield rollouts, batch by batch, the nearest to the goal first."""
        rng = np.random.default_rng([self._seed, TRIED])
        found = True
        while found:
            durations = self._duration * np.exp(rng.uniform(*_DURATIONS, _LANES))
            durations = np.clip(durations, *self._plant.durations)
            controls = self._random(rng)
            with np.errstate(all='ignore'):
                states = self._flown(durations, controls)
                away = self._away(durations, states)
            self._budget.evaluations += _WORTH
            last = np.argmin(away, axis=0)
            nearest = np.argsort(away[last, np.arange(_LANES)])[:_ROLLOUTS_KEPT]
            nearest = nearest[np.isfinite(away.min(axis=0)[nearest])]
            found = nearest.size > 0
            for lane in nearest:
                at = np.linspace(0, 2 * last[lane], 2 * COARSE + 1)
                x, u = (
                    np.stack([np.interp(at, known, c) for c in values.T], axis=-1)
                    for known, values in (
                        (np.arange(0, 2 * _STEPS + 1, 2), states[:, lane]),
                        (np.arange(2 * _STEPS + 1), controls[:, lane]),
                    )
                )
                duration = float(durations[lane] * last[lane] / _STEPS)
                yield CollocatedMotion(x[::2], x[1::2], u[::2], duration)

    def _random(self, rng: np.random.Generator) -> Array:
        """Return controls at the ends and middles of all steps, (2 steps + 1, lanes, nu)."""
        size = _LANES, self._half.size
        s = np.linspace(0.0, 1.0, 2 * _STEPS + 1)[:, None, None]
        least, most = np.log(_PERIODS)
        periods = np.exp(rng.uniform(least, most, size))
        chirp, phase = rng.uniform(-_CHIRP, _CHIRP, size), rng.uniform(0.0, 1.0, size)
        wave = np.sin(2.0 * np.pi * (periods * (s + chirp * s**2) + phase))
        wave = rng.uniform(*_AMPLITUDE, size) * wave + _OFFSET * rng.normal(size=size)
        return np.asarray(self._middle + self._half * np.clip(wave, -1.0, 1.0))

    def _flown(self, durations: Array, controls: Array) -> Array:
        """Integrate all lanes by RK4: states at the ends of all steps, (steps + 1, lanes, nx)."""
        numbers, h = self._plant.numbers, (durations / _STEPS)[:, None]
        call = Call(self._plant.trace.rates, _LANES)

        def rates(state: Array, control: Array) -> Array:
            return call(state, control, numbers)[0].copy()

        start = np.nan_to_num(self._ends.states[0])
        states = np.tile(start, (_STEPS + 1, _LANES, 1))
        of_steps = zip(controls[:-2:2], controls[1::2], controls[2::2], strict=True)
        for k, (u, middle, last) in enumerate(of_steps):
            x = states[k]
            a = rates(x, u)
            b = rates(x + 0.5 * h * a, middle)
            c = rates(x + 0.5 * h * b, middle)
            d = rates(x + h * c, last)
            states[k + 1] = x + h / 6.0 * (a + 2.0 * (b + c) + d)
        return states

    def _away(self, durations: Array, states: Array) -> Array:
        """
        Return the squared distance from the goal (steps + 1, lanes), infinite where there is none.

        The unit of each state, and of each condition at the end, is its standard deviation.
        """
        finite, given = np.isfinite(states).all(axis=(0, 2)), np.isfinite(self._ends.states[1])
        if not finite.any():
            return np.full(states.shape[:2], np.inf)
        missed = [states[..., given] - self._ends.states[1][given]]
        conditions = self._plant.trace.end_conditions
        if conditions.numel_out(0):
            call, numbers = Call(conditions, _LANES), self._plant.numbers
            times = np.linspace(0.0, 1.0, _STEPS + 1)[:, None, None] * durations[:, None]
            missed.append(
                np.array(
                    [call(t, x, numbers)[0].copy() for t, x in zip(times, states, strict=True)]
                )
            )
        off = np.concatenate(missed, axis=-1)
        spread = np.nan_to_num(off[:, finite]).std(axis=(0, 1))
        off = np.nan_to_num(off / np.where(spread > 0.0, spread, 1.0), nan=_NOWHERE)
        away = np.where(finite, np.square(off).sum(axis=-1), np.inf)
        shortest, longest = self._plant.durations
        first = _STEPS if shortest == longest else _STEPS // _SHORTEST
        away[:first] = np.inf
        return np.asarray(away)


def enough_solutions(
    solved: Sequence[tuple[CollocatedMotion, str]], tried: int, obstacles: bool
) -> bool:
    """
    Whether solutions from so many guesses `tried` do: most are alike in cost, or they are enough.

    Each stands with the kind of its guess. One kind often leads to the same local minimum: where
    all that are alike are of one, or after `TRIED` guesses, one more must be. Past `obstacles`
    those are all tried, as lines lead to either side, and one more must be alike, but not most.
    """
    if obstacles and tried < TRIED:
        return False
    hard, best = tried > TRIED, min((found for found, _ in solved), key=lambda found: found.cost)
    kinds = [kind for found, kind in solved if found.cost <= best.cost + _ALIKE * best.size]
    more = max(hard + obstacles, len(set(kinds)) == 1)
    alike = len(kinds) >= _AGREED + more and (obstacles or 2 * len(kinds) > len(solved))
    return alike or len(solved) >= _ENOUGH * (1 + hard)
