# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Method `switching`: the quickest verified swing-up in arcs of constant torque.

Shooting brings rounds of initial guesses, random and pumping ones, upright. The quickest
arrivals are polished coarsely, then in order of their time their end is corrected in a fine
integration, until one passes the verification.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
import math

import numpy as np
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import (
    DeadlineExceeded,
    Infeasible,
    InvalidProblem,
    VerificationFailed,
)
from tdm_planner.problems.pendulum.candidates import (
    Candidate,
    COARSE_STEPS,
    corrected,
    distinct,
    FINE_STEPS,
    ONE_ROUND,
    polish,
    reaches_limit,
    shoot_upright,
    starts,
    TAIL_STEPS,
    to_polish,
    trajectory,
    warm_starts,
    with_new_arcs,
    without_short_arcs,
)
from tdm_planner.problems.pendulum.pumping import pumped_candidates
from tdm_planner.problems.pendulum.shooting import Steps
from tdm_planner.problems.pendulum.smooth import collocated
from tdm_planner.problems.pendulum.task import SwingUpTask, TERMINAL_TOLERANCE, WEAK_DRIVE
from tdm_planner.problems.problem import Search
from tdm_planner.problems.solution import Solution

# Random initial guesses.
_RANDOM_ROUNDS = 3  # before pumping is tried
_MORE_ROUNDS = 30  # for strong motors where pumping did not help
_STARTS, _FEWEST_STARTS = 100, 8  # of a round, and where the deadline is short:
_START_TIME = 1e-3  # s of the deadline for one of them more
_GUESSED = Steps(8), Steps(8, 0.4)  # of integration; where a light disk makes swings quick
# Shares of the deadline after which nothing more is shot if some have arrived, or pumping helped.
_ENOUGH, _ENOUGH_BESIDE = 0.5, 0.4
_SEARCH_UNTIL = 0.85  # if none has; also the end of pumping, and no round begins later

# Drives.
_PUMPED_FIRST = 0.25  # below which pumping is tried first
_ALWAYS_PUMPED = 0.1  # below which random starts hardly ever arrive

_FEW_ARCS = 64  # of `switching_arcs`, below which a failure tells that, too

# Minimising the time.
_POLISHED, _POLISHED_PUMPED = 5, 2  # candidates, of random starts and pumped ones
_COARSE = 0.75  # share of the deadline after which no more are polished
_CUTOFF = 1.05  # polishing stops where the time stays above this share of the best
_FEASIBLE = 1e-6  # violation after a polish
# Shares of the deadline until which collocation is begun, left, and what it gives is polished.
_COLLOCATED = 0.4, 0.46, 0.5
_COLLOCATED_AGAIN = 0.02  # gain after which it goes on
# Most times that swings are pumped, and share of the deadline until which they are once more.
_PUMPS, _PUMPED_AGAIN = 4, 0.07

# Further arcs for the quickest candidate.
_MOST_SHORTENED = 40  # arcs that it may have
_MOST_ROUNDS, _LEAST_GAIN = 6, 1e-3  # most turns, least relative gain of one
_SHORTENED = 0.3  # share of the deadline after which there are none

# The check.
_CHECKED = 4  # candidates that are verified before the search begins anew
_CHECK_TIME, _CHECK_SHARE = 2e-3, 0.1  # s, but no more than this share of the deadline
_OVERTIME = 0.03  # s after the deadline in which it may end
_INTEGRATION_TIME, _REPLAY_TIME = 3e-5, 5e-5  # s for 1/w0 of a motion: to correct, to check it
_CERTAIN = 1.02  # of the disk's limit, that the least peak found exceeds: its grid is coarse
_LOST = 2.0  # times the tolerance: a violation after the fine polish that is not worth a check

# Arcs of an earlier plan, or read from a collocation.
_CHANGES = 0.0, 0.01, 0.03, 0.1  # of the logarithms of their durations, side by side,
_ARRIVED = 2  # until so many arrive
_WARM_UNTIL = 0.6  # share of the deadline after which it is dropped
_WARM_TRIED = 3  # arrivals that are polished
_WARM_POLISHED = 12  # most arcs whose time is minimised


class SwitchingSearch(Search[Candidate]):
    """
    The search for the quickest switching times.

    `arcs` is the most arcs of a plan, `tolerance` the largest violation that still counts as
    feasible. The `previous` plan's arcs, shifted in time, are tried before all else: the rest of a
    plan that is under way nearly solves the problem from where the plant is. After shooting it is
    polished at once, and the first plan that passes the check is taken.
    """

    def __init__(
        self,
        task: SwingUpTask,
        budget: Budget,
        rng: np.random.Generator,
        arcs: int,
        tolerance: float,
        previous: Candidate | None = None,
    ) -> None:
        super().__init__(budget)
        # An earlier plan may need all of the disk's range.
        self._task = replace(task, whole_range=previous is not None)
        self._rng, self._arcs, self._tolerance = rng, arcs, tolerance
        self._previous = previous
        self._replans = previous is not None  # soon matters more than short
        w0 = task.plant.natural_frequency
        self._lost = _LOST * float((TERMINAL_TOLERANCE / [1.0, 1.0, w0, w0]).max())
        self._pumping = task.swing_drive < _PUMPED_FIRST
        # A strong motor that the disk's range makes weak: random starts find shorter swing-ups.
        self._narrow = self._pumping and task.drive >= WEAK_DRIVE
        self._rounds = self._starts = 0
        self._arrived = 0

    def candidates(self) -> Iterable[Candidate]:
        """Shoot from initial guesses and minimise the times of the quickest arrivals."""
        if self._previous is not None:
            return self._warm(self._previous)
        pumped, quicker = list[Candidate](), list[Candidate]()
        for _ in range(_PUMPS if self._pumping else 0):
            pumped = distinct(pumped + self._pumped())
            if not pumped or self._replans or self.budget.past(_PUMPED_AGAIN):
                break
        if self._narrow and pumped:
            quicker = self._collocated(pumped[0])
        latest = _ENOUGH_BESIDE if pumped else _SEARCH_UNTIL
        arrived = self._arrivals(latest) if self._narrow or not self._pumping else []
        if quicker:  # than the pumped ones, which need no polish then
            found = self._polished(distinct(quicker + arrived)) + pumped
        else:
            found = self._polished(distinct(pumped + arrived))
        return sorted(found, key=lambda c: c.total)[:_CHECKED]

    def plans(self, candidate: Candidate) -> Iterator[Solution]:
        """
        Yield the motion under the arcs, finely integrated.

        Arcs too short to matter are omitted. Only the end is corrected; the time is minimised anew
        for an earlier plan with few arcs.
        """
        task, budget = self._task, self.budget
        with suppress(DeadlineExceeded):  # while one was checked
            arcs = without_short_arcs(task, candidate)
            if self._short_of_time(arcs):
                return
            if self._previous is not None and candidate.durations.size <= _WARM_POLISHED:
                until = budget.leaving(_CHECK_TIME, _CHECK_SHARE)
                fine, violation = polish(task, arcs, FINE_STEPS, self._tolerance, until)
            else:
                fine, violation = corrected(task, arcs, FINE_STEPS, budget)
            if violation < self._lost:
                yield self._checked(fine, violation)
            elif not budget.spent:  # or else there was no time to correct it
                self.rejected = (
                    'one found with coarse integration steps misses upright, or a limit, with '
                    f'fine ones (violation {violation:.2g})'
                )

    def _warm(self, previous: Candidate) -> Iterator[Candidate]:
        """Yield arrivals of the earlier arcs, a little changed if need be."""
        until = self._until_share(_WARM_UNTIL)
        found = self._shot_again(previous, until)
        if previous.durations.size > _WARM_POLISHED:  # the times are not minimised anew
            found = to_polish(found)
        yield from distinct(found)[:_WARM_TRIED]

    def _shot_again(self, arcs: Candidate, until: Budget) -> list[Candidate]:
        """Return arrivals of these arcs, a little changed in several ways, side by side."""
        guesses = [
            guess
            for change in _CHANGES
            for guess in warm_starts(self._task, self._rng, arcs, self._arcs, change)
        ]
        found = shoot_upright(self._task, guesses, TAIL_STEPS, until, _ARRIVED)
        self._starts += len(guesses)
        self._arrived += len(found)
        return found

    def _until_share(self, share: float) -> Budget:
        """Return what remains until that share of the deadline."""
        return self.budget.part(share * self.budget.seconds - self.budget.elapsed)

    def _checked(self, candidate: Candidate, violation: float) -> Solution:
        """Return the motion with its check, which may end a little after the deadline."""
        if self._short_of_time(candidate, _REPLAY_TIME, _OVERTIME):
            raise DeadlineExceeded('there is no time for a check')
        motion = trajectory(self._task, candidate)
        return self._task.plan(motion, candidate.durations, violation)

    def _short_of_time(
        self, candidate: Candidate, time: float = _INTEGRATION_TIME, overtime: float = 0.0
    ) -> bool:
        """
        Whether work on a motion would end more than `overtime` s after the deadline.

        It takes `time` s for every 1/w0 of the motion, times the plant's quickness.
        """
        task = self._task
        scale = candidate.total * task.plant.natural_frequency * task.plant.quickness
        return self.budget.remaining + overtime <= self.budget.charged(time * scale)

    def widen(self) -> bool:
        """Give an earlier plan up; pump after random starts, and the other way round."""
        if self._previous is not None:
            self._previous = None
            self._task = replace(self._task, whole_range=False)
            return True
        if self._pumping:
            self._task = replace(self._task, whole_range=True)
        # From near upright random starts arrive, however weak the motor: they get one turn.
        tried = self._rounds >= _RANDOM_ROUNDS and self._task.swing_drive < _ALWAYS_PUMPED
        self._pumping = tried or self._narrow or not self._pumping
        return not self.budget.past(_SEARCH_UNTIL)

    def failure(self) -> Infeasible:
        """Return what was found and why it does not do, or how long it was looked for."""
        if self.rejected:
            return VerificationFailed(
                f'swing-ups were found, but none within {self.budget.seconds:g} s that passes '
                f'the check: {self.rejected}{self._task.difficulties}'
            )
        peak = 0.0 if self._arrived else self._task.least_peak(self.budget.with_grace())
        if peak > _CERTAIN * self._task.disk_angle_limit:
            found = f': least peak found {peak:.5g} rad' if math.isfinite(peak) else ''
            return Infeasible(self._task.unstoppable + found)
        return DeadlineExceeded(self._missed())

    def _pumped(self) -> list[Candidate]:
        """Pump and shoot the tails; the quickest distinct arrivals, quickest first."""
        found, tried = pumped_candidates(
            self._task, self._rng, self._arcs, self._until_share(_SEARCH_UNTIL)
        )
        self._starts += tried
        self._arrived += len(found)
        return distinct(found)[:_POLISHED_PUMPED]

    def _arrivals(self, latest: float) -> list[Candidate]:
        """
        Shoot from rounds of random starts until that share of the deadline; return all arrivals.

        Shooting uses fewer steps, as most starts fail; polishing corrects the difference.
        """
        found, again = list[Candidate](), self._rounds > 0
        strong = self._task.swing_drive >= _PUMPED_FIRST
        steps = _GUESSED[self._task.plant.quickness > 1.0]
        # Fewer where one round would use all the time up.
        size = min(_STARTS, max(_FEWEST_STARTS, round(self.budget.seconds / _START_TIME)))
        for _ in range(_MORE_ROUNDS if again and strong else _RANDOM_ROUNDS):
            if self.budget.past(min(_ENOUGH, latest) if found else latest) or (found and again):
                break
            guesses = starts(self._task, self._rng, size, self._arcs)
            until = self._until_share(latest)
            found += shoot_upright(self._task, guesses, steps, until, rounds=ONE_ROUND)
            self._starts += size
            self._rounds += 1
        self._arrived += len(found)
        return found

    def _polished(self, candidates: list[Candidate]) -> list[Candidate]:
        """
        Minimise the times of the quickest candidates; collocation may shorten the first further.

        Where the disk's range is narrow it is tried at once, and what it gives needs no polish.
        """
        if self._narrow and candidates and (quicker := self._quicker(candidates[0])):
            return quicker + candidates
        done, best, until = list[Candidate](), math.inf, self._until_share(_COARSE)
        for candidate in candidates[:_POLISHED]:
            if until.spent:
                done.append(candidate)
                continue
            better, violation = self._polish(candidate, until, _CUTOFF * best)
            done.append(better)
            if violation < _FEASIBLE:
                best = min(best, better.total)
        done.sort(key=lambda c: c.total)
        if done and not self._replans and done[0].durations.size <= _MOST_SHORTENED:
            shorter = self._shortened(done[0], self._until_share(_SHORTENED))
            if shorter.total < done[0].total:
                done = [shorter, *done]
        if done and not self._narrow:
            done = self._quicker(done[0]) + done
        return done

    @property
    def _coarse_steps(self) -> int:
        """Steps an arc of a coarse polish."""
        return (2 if self._pumping else 1) * COARSE_STEPS

    def _polish(
        self, candidate: Candidate, until: Budget, cutoff: float = math.inf
    ) -> tuple[Candidate, float]:
        task, steps = self._task, self._coarse_steps
        better, violation = polish(task, candidate, steps, self._tolerance, until, cutoff)
        if violation > _FEASIBLE:
            better, violation = corrected(task, better, steps, until)
        return better, violation

    def _shortened(self, candidate: Candidate, until: Budget) -> Candidate:
        """Return a candidate with further arcs, as long as they shorten it and there is time."""
        task = self._task
        best = without_short_arcs(task, replace(candidate, fixed=0))
        for _ in range(_MOST_ROUNDS):
            if until.spent:
                break
            further = with_new_arcs(task, best, self._coarse_steps, self._arcs)
            if further is None:
                break
            better, violation = self._polish(further, until)
            gained = 1.0 - better.total / best.total if violation < _FEASIBLE else 0.0
            if gained > 0.0:
                best = without_short_arcs(task, better)
            if gained < _LEAST_GAIN:
                break
        return best

    def _quicker(self, candidate: Candidate) -> list[Candidate]:
        """Return ever quicker arcs that collocation leads to, the quickest first."""
        found = list[Candidate]()
        while more := self._collocated(candidate):
            gained = 1.0 - more[0].total / candidate.total
            candidate, found = more[0], more + found
            if not self._narrow or gained < _COLLOCATED_AGAIN:
                break
        return found

    def _collocated(self, candidate: Candidate) -> list[Candidate]:
        """
        Return quicker arcs that collocation leads to from a candidate, if any.

        It pays for a strong motor where the disk comes to its limit: what moves along that has
        more arcs than shooting finds.
        """
        late = self._replans or self.budget.past(_COLLOCATED[0])
        pays = not late and self._task.drive >= WEAK_DRIVE
        if pays and (self._narrow or reaches_limit(self._task, candidate)):
            left, until = map(self._until_share, _COLLOCATED[1:])
            with suppress(InvalidProblem):  # numbers of a rig that collocation cannot compute with
                for read in collocated(self._task, candidate, left):
                    if found := self._shot_again(read, until):
                        quickest = min(found, key=lambda c: c.total)
                        better, violation = self._polish(quickest, until)
                        best = better if violation < _FEASIBLE else quickest
                        if best.total < candidate.total:
                            return [best]
        return []

    def _missed(self) -> str:
        task = self._task
        search = (
            f'in {self.budget.seconds:g} s, {self._starts} initial guesses with at most '
            f'{task.planned_torque:.3g} N m (limits.torque less torque_reserve) '
        )
        if self._arcs < _FEW_ARCS:
            search += f'and {self._arcs} arcs (switching_arcs) '
        if self._arrived:
            return search + f'gave {self._arrived} swing-ups, but left no time to verify one'
        return search + 'gave no swing-up' + task.difficulties
