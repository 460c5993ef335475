# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The refinement of a motion until its replay confirms it: the part of the search that collocates.

A solution on few intervals is solved again on more; it is replayed and repaired: by a correction
where it ends beside the goal, by a reserve at a limit that the replay violates, or by more
intervals. A motion that leaps over an obstacle between two nodes cannot be repaired: those that
leap over the same are recognised by how deep they are within it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.collocation import (
    COLD,
    CollocatedMotion,
    Collocation,
    LIMITS_ROUNDING,
    Settings,
    WARM,
)
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.problems.direct.plant import corrected, DirectPlant, END_TOLERANCE
from tdm_planner.trajectory import lines, Trajectory
from tdm_planner.verification import usual_tolerance

# Intervals of the collocation: from initial guesses, from earlier plans, of most plans, at most.
FIRST, COARSE, FINE, FINEST = 12, 20, 40, 160
_REPAIRS, _CORRECTIONS = 7, 5
# Shares by which kinks between two limits of which one will do are rounded, in turn.
_ALTERNATIVES = 0.2, 0.05, 0.01
_END_REACHED = 0.1  # of the end's tolerance, to be content
_TOUCHED = 0.5  # of what a limit may be violated by: it needs no repair
_COST_AGREES = 1e-3  # share of J's size by which it may differ from that of the replay
# A replay that misses the goal by so many tolerances goes elsewhere, unless twice the intervals
# leave that share of it, or let it leave the motion so much later.
_ELSEWHERE, _NEARER, _LATER = 50.0, 0.5, 1.05
_CHECK_SHARE = 0.2  # of the time allowed, for the check
# A motion leaps over an obstacle if it violates a limit by more than so many tolerances, and no
# solution with a reserve leaves less than that share of it.
_DEEP, _SHALLOWER = 1e3, 0.5
_BETWEEN = 4  # parts of an interval, at whose ends and middles it is looked at for that
_SOLVING = 1.2  # times what solving should take
_LONGER = 1.3  # times the rest of the plan: the duration of a warm start's second guess
_INSTANTS = 400  # at which a plan is compared with where it was left
_LOOKS = 32  # parts of an interval, at whose ends the replay looks at the limits
_CELL = 8  # such parts in a cell of the sum for J, and from where limits are kept to the next


class Repaired(NamedTuple):
    """
    A motion whose cost is that of its replay, and the replayed `states` (n + 1, nx) at its nodes.

    `reserve` (nm,) is kept of the limits beside what is stated. The replay has `diverged` where it
    goes elsewhere, or the motion leaps over an obstacle, and more intervals would not help.
    """

    motion: CollocatedMotion
    states: Array
    reserve: Array
    diverged: bool


class _Replay(NamedTuple):
    """
    A replay: states (m, nx) at m looks, J.

    `least` are the least margins (nm,) in units of what they may be violated by, `unit`; `beside`
    are the least ones, in their own units, where collocation keeps them in that interval. `gap` is
    what the end is off the `goal` by, in tolerances, or `_END_REACHED` where a limit is just kept
    there; `departs` is the first node at which the replay is off the motion, n + 1 if it never
    is. Where it fails there are no numbers but an infinite gap.
    """

    states: Array
    least: Array
    beside: Array
    unit: Array
    cost: float
    gap: float
    goal: Array
    departs: int


class Refinement:
    """Collocation of the problem whose plant is given, within a `budget`."""

    def __init__(self, plant: DirectPlant, budget: Budget) -> None:
        self._plant, self.trace, self._budget = plant, plant.trace, budget
        self._stated, self._numbers = plant.stated, plant.numbers
        self.ends = plant.ends
        self._reserve = plant.stated.reserves(plant.trace.margin_names)
        # Limits (nm,) that depend on free states at the end: a repair may keep more of them there.
        free = np.isnan(self.ends.states[1]) & (not plant.trace.end_conditions.numel_out(0))
        self._open_at_end = (plant.trace.uses[:, 1:][:, : free.size] & free).any(axis=1)
        # The last motion that has no solution on twice the intervals.
        self._dead_end: CollocatedMotion | None = None
        self._roughly = False  # whether rounder kinks were solved last, and sharp ones were not
        # s an interval that the last solution took, and those on more intervals, the last most.
        self._took = self._solved = 0.0
        # The least that limits were violated by, by motions that leap over obstacles, (nm,).
        self._leapt = np.full(len(plant.trace.margin_names), np.inf)
        self.breakdowns = 0  # solutions that ended where a number has no value

    def tolerance(self, states: Array) -> Array:
        """Return by how much states (N, nx) may differ from the goal at the end, (nx,)."""
        given = self._stated.formulation.terminal_tolerance
        if given is None:
            return usual_tolerance(states, self._plant.state_units)
        return np.array(given, dtype=float)

    def goal(self, states: Array) -> Array:
        """Return the goal, (nx,), which is the last of `states` (N, nx) where the end is free."""
        given = self.ends.states[1]
        return np.asarray(np.where(np.isfinite(given), given, states[-1]))

    def solve(
        self,
        intervals: int,
        guess: CollocatedMotion,
        settings: Settings | None = None,
        until: Budget | None = None,
        reserve: Array | float = 0.0,
        **how: Any,
    ) -> CollocatedMotion | None:
        """
        Return the optimum on so many intervals near a guess; None if there is none in time.

        `reserve` (nm,) is kept of the limits beside what is stated; `how` as of
        `Collocation.solve`.
        """
        settings = settings or (COLD if intervals == FIRST else WARM)
        program = Collocation.of(self.trace, intervals, settings)
        kept = np.tile(self._reserve + reserve, (intervals + 1, 1))
        kept[0], last = self._plant.kept_at_ends
        kept[-1] = np.where(self._open_at_end, kept[-1], last)
        until = until or self._budget
        given = self._numbers, guess, self.ends, self._plant.durations, kept, until
        kinked = settings is WARM and program.has_kinks
        for roughly in (self._roughly, not self._roughly) if kinked else (False,):
            began = self._budget.elapsed
            found = program.solve(*given, roughly=roughly, **how)
            self._took = (self._budget.elapsed - began) / intervals
            self.breakdowns += program.broke_down
            if found is not None and kinked:
                self._roughly = roughly
            if found is not None or until.spent:
                break
        return found

    def from_guess(
        self, guess: CollocatedMotion, until: Budget, *, eased: bool, patient: bool
    ) -> CollocatedMotion | None:
        """
        Return the optimum on the first intervals near an initial guess.

        Where it is `eased` and one of two limits will do, the kink between them is round at first;
        where it is `patient` Ipopt is given more iterations. A guess on more intervals is solved
        on as many. What leaps over an obstacle that others leapt over is no solution.
        """
        eased &= Collocation.of(self.trace, FIRST, COLD).has_alternatives
        found: CollocatedMotion | None = guess
        for share in _ALTERNATIVES if eased else (LIMITS_ROUNDING,):
            begun = found and replace(found, multipliers=())
            found = begun and self.solve(
                guess.intervals, begun, COLD, until, patient=patient, alternatives=share
            )
        return None if found is None or self._leaps(found) else found

    def warm(self, plan: Trajectory) -> CollocatedMotion | None:
        """Solve from what is left of an earlier plan; None if that leads nowhere."""
        own = tuple(self._plant.state_names), tuple(self._plant.control_names)
        if (plan.state_names, plan.control_names) != own:
            return None
        now = self._resume_instant(plan)
        rest = plan.duration - now
        if not rest > 0.0:
            return None
        s = np.linspace(0.0, 1.0, 2 * COARSE + 1)
        sample = plan.sample(now + rest * s)
        states, controls = sample.state.copy(), sample.control.copy()
        for side, share in ((0, 1.0 - s), (-1, s)):
            for values, given in ((states, self.ends.states), (controls, self.ends.controls)):
                values += np.nan_to_num(given[side] - values[side]) * share[:, None]
        guess = CollocatedMotion(states[::2], states[1::2], controls[::2], rest)
        motion = self.solve(COARSE, guess)
        if motion is None:
            longer = replace(self.spread(guess, FIRST), duration=_LONGER * rest)
            motion = self.solve(FIRST, longer)
            motion = motion and self.finer(motion, COARSE)
        return motion

    def _resume_instant(self, plan: Trajectory) -> float:
        """Instant [s] at which a plan is nearest to the given part of the start."""
        times = np.linspace(0.0, plan.duration, _INSTANTS)
        states = plan.sample(times).state
        gaps = np.nan_to_num((states - self.ends.states[0]) / (np.ptp(states, axis=0) + 1e-9))
        return float(times[np.argmin(np.square(gaps).sum(axis=1))])

    def finer(self, motion: CollocatedMotion, intervals: int) -> CollocatedMotion | None:
        """Solve again on more intervals."""
        found = self.solve(intervals, self.spread(motion, intervals))
        if found is None and intervals == 2 * motion.intervals:
            self._dead_end = motion
        self._solved = 0.5 * (self._took + (self._solved or self._took))
        return found

    def repaired(self, motion: CollocatedMotion, reserve: Array) -> Repaired:
        """
        Correct a motion, or solve again, until its replay ends well and keeps the limits.

        `reserve` (nm,) is kept of the limits beside what is stated.
        """
        if reserve.any():
            motion = self.solve(motion.intervals, motion, reserve=reserve) or motion
        good: tuple[CollocatedMotion, _Replay] | None = None
        before, diverged, unsolved, deep = (np.inf, 0.0), False, motion is self._dead_end, np.inf
        last = np.full(len(reserve), -np.inf)  # the least margins before
        for turn in range(_REPAIRS + 1):
            motion, flown = self._landed(motion)
            more, along = 2 * motion.intervals, flown.departs / motion.intervals
            far = flown.gap > max(_NEARER * before[0], _ELSEWHERE)
            diverged |= far and along <= _LATER * before[1]
            refines = self.has_time_for(more) and not (diverged or unsolved)
            near = abs(flown.cost - motion.cost) <= _COST_AGREES * motion.size
            landed = flown.gap <= _END_REACHED and (near or not refines)
            kept = bool((flown.least >= -_TOUCHED).all())
            if flown.gap <= _END_REACHED and kept:
                good = motion, flown
            done = kept if landed else not refines
            if done or turn == _REPAIRS or self._late:
                break
            if landed:
                share = 1.0 - (1.1 if turn < 2 else 2.0) * flown.least
                # A reserve that touches nothing around the violation does not make it less.
                idle = np.maximum(flown.beside - self._reserve - reserve, 0.0)
                more_of = flown.unit * share + np.where(flown.least < 0.5 * last, idle, 0.0)
                reserve = np.where(flown.least < -_TOUCHED, reserve + more_of, reserve)
                last = flown.least
                deep, earlier = -flown.least[self._plant.obstacles].min(initial=0.0), deep
                hopeless = deep >= max(_DEEP, _SHALLOWER * earlier)
                again = None if hopeless else self.solve(motion.intervals, motion, reserve=reserve)
                if again is None:
                    diverged |= deep > _DEEP
                    over = (flown.least < -_DEEP) & self._plant.obstacles
                    depths = np.where(over, -flown.least * flown.unit, np.inf)
                    self._leapt = np.minimum(self._leapt, depths)
                    break
            else:
                guess, half = self.spread(motion, more), 0.5 * self._budget.remaining
                again = self.solve(more, guess, reserve=reserve, until=self._budget.part(half))
                unsolved = again is None
            before = (np.inf, 0.0) if landed or unsolved else (flown.gap, along)
            motion = again or motion
        if good is not None:
            motion, flown = good
        # A root of what should be zero may be of less than that in the replay.
        cost = flown.cost if np.isfinite(flown.cost) else motion.cost
        motion, diverged = replace(motion, cost=cost), diverged and good is None
        return Repaired(motion, flown.states[::_LOOKS], reserve, diverged)

    def _landed(self, motion: CollocatedMotion) -> tuple[CollocatedMotion, _Replay]:
        """Correct a motion while that brings the end of its replay nearer to the goal."""
        flown = self._replayed(motion)
        for _ in range(_CORRECTIONS):
            if flown.gap <= _END_REACHED or self._late:
                break
            tolerance = self.tolerance(motion.states)
            other = None
            with suppress(np.linalg.LinAlgError):
                ends = replace(self.ends, states=np.stack([self.ends.states[0], flown.goal]))
                other = corrected(self._plant, motion, ends, self._plant.durations, tolerance)
            if other is None:
                break
            again = self._replayed(other)
            if not (again.gap < flown.gap or again.departs > flown.departs):
                break
            motion, flown = other, again
        return motion, flown

    def _replayed(self, motion: CollocatedMotion) -> _Replay:
        """Replay a motion, controls linear in every interval, to look before the check proper."""
        n, u = motion.intervals, motion.controls
        ends = motion.times
        times = np.linspace(0.0, ends[-1], n * _LOOKS + 1)
        controls = np.stack([np.interp(times, ends, column) for column in u.T], axis=-1)
        given = lines(ends, u), motion.states[0], self._numbers
        flown = self.trace.integrator(*given, self._budget.with_grace())
        nowhere = np.full((times.size, motion.states.shape[1]), np.nan)
        states = nowhere if flown is None else flown.states(times)
        seen = self._plant.limits(times, states, controls)
        halves = slice(None, None, _CELL // 2)
        along = times[halves], states[halves], controls[halves]
        cost = self.trace.cost_through(self._numbers, *along)
        conditions = self._plant.end_conditions(times[-1], states[-1])[0] / END_TOLERANCE
        goal = self.ends.states[1]
        free = np.isnan(goal).all() and not conditions.size
        if free and not abs(cost - motion.cost) <= _COST_AGREES * motion.size:
            goal = motion.states[-1]  # the plant has left the motion
        missed = np.nan_to_num((states[-1] - goal) / self.tolerance(motion.states))
        unit = self._plant.limit_tolerances(replace(motion, states=states[::_LOOKS]))
        # A goal on a limit is to be met more closely: no reserve can be kept there.
        beyond = -_END_REACHED / _TOUCHED * seen[-1] / unit
        gap = float(np.append(np.abs(np.append(missed, conditions)), beyond).max())
        gap = gap if np.isfinite(states).all() else np.inf
        first = np.minimum(seen.argmin(axis=0) // _LOOKS, n - 1) * _LOOKS  # of the interval
        kept = first + np.arange(0, _LOOKS + 1, _CELL)[:, None]
        beside = np.take_along_axis(seen, kept, axis=0).min(axis=0)
        away = np.abs(states[::_LOOKS] - motion.states) > self.tolerance(motion.states)
        departs = int(np.argmax(np.append(away.any(axis=1), True)))
        least = seen.min(axis=0) / unit
        return _Replay(states, least, beside, unit, cost, gap, goal, departs)

    @property
    def leapt(self) -> bool:
        """Whether a motion was found to leap over an obstacle."""
        return bool(np.isfinite(self._leapt).any())

    def _leaps(self, motion: CollocatedMotion) -> bool:
        """Whether a motion leaps over an obstacle that others were found to leap over."""
        if not self.leapt:
            return False
        least = self._plant.limits(*self.spread(motion, _BETWEEN * motion.intervals).halves)
        return bool((least.min(axis=0) < -_SHALLOWER * self._leapt).any())

    def has_time_for(self, intervals: int, solutions: int = 1) -> bool:
        """Whether there is time for so many solutions on so many intervals, and a check."""
        work = _SOLVING * solutions * self._solved
        room = self._budget.remaining - _CHECK_SHARE * self._budget.seconds
        return intervals <= FINEST and room > work * intervals

    @property
    def _late(self) -> bool:
        """Whether the time that is left is for the check."""
        return self._budget.remaining < _CHECK_SHARE * self._budget.seconds

    def spread(self, motion: CollocatedMotion, intervals: int) -> CollocatedMotion:
        """Return a motion on other intervals."""
        rates = self._plant.rates(motion.states, motion.controls)  # 0 / 0 for some at rest
        return motion.on(intervals, np.nan_to_num(rates, posinf=0.0, neginf=0.0))


def prepare_refinement(trace: Trace) -> None:
    """Make the programs that most plans need."""
    trace.integrator  # noqa: B018 - it is made when it is first asked for
    for intervals, settings in ((FIRST, COLD), (COARSE, WARM), (FINE, WARM)):
        Collocation.of(trace, intervals, settings)
