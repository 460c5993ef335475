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

"""Method `smooth`: a verified swing-up with a continuous torque, for motors that cannot switch."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, VerificationFailed
from tdm_planner.problems.base import Solution
from tdm_planner.problems.search import Plan, Search
from tdm_planner.problems.smooth_program import Motion, SmoothProgram, VARIED
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.trajectory import to_nanoseconds, Trajectory

Array = NDArray[np.float64]

_STARTS = 12  # of which the quickest result is taken
_SEARCH_SHARE = 0.7  # of the deadline, after which the search ends as soon as there is a result
_POLISH_SHARE = 0.92  # of the deadline, which leaves the rest to the verification
_COARSE_STEPS, _FINE_STEPS = 60, 240  # RK4 steps while searching, and for the final polish
_SAMPLE_TIME = 2e-3  # [s], at most; short, as the torque is read by a spline between samples
_FEWEST_SAMPLES = 250
_SUBSTEPS = 4  # RK4 steps between two samples

SmoothCandidate = tuple[SmoothProgram, Minimum]


class SmoothMethod(Search[SmoothCandidate]):
    """
    The search for the quickest smooth torque.

    The rest of a `previous` plan is tried first, and alone if it leads to a plan.
    """

    def __init__(
        self,
        task: SwingUpTask,
        budget: Budget,
        rng: np.random.Generator,
        tolerance: float,
        previous: Solution | None = None,
    ) -> None:
        super().__init__(budget)
        self._task = task
        self._rng = rng
        self._feasibility = max(tolerance, 1e-11)
        self._starts = 0
        self._previous = previous
        self._closest = math.inf

    def plans(self, candidate: SmoothCandidate) -> Iterator[Plan]:
        """Yield the motion polished with finer steps."""
        if self.budget.spent:
            return
        program = SmoothProgram(self._task, candidate[0].turns, _FINE_STEPS)
        until = Budget(_POLISH_SHARE * self.budget.seconds - self.budget.elapsed)
        point = self._minimise(program, candidate[1].point.xi, until).point
        if point.violation > 1e-5:
            self.rejected = f'a limit is violated by {point.violation:.2g} of its value'
            return
        yield self._task.plan(self._trajectory(point.xi), point.xi, point.violation)

    def failure(self) -> Infeasible:
        """Return what was found and why it does not do, or how near the search came."""
        if self.rejected:
            return VerificationFailed(
                f'smooth swing-ups were found, but none within {self.budget.seconds:g} s that '
                f'passes the check: {self.rejected}'
            )
        return DeadlineExceeded(
            f'in {self.budget.seconds:g} s, {self._starts} starts with smooth torques of at most '
            f'{self._task.torque:.3g} N m (limits.torque less torque_reserve) gave no swing-up; '
            f"the least violation was {self._closest:.2g}; weak torque needs method 'switching'"
        )

    def candidates(self) -> list[SmoothCandidate]:
        """Minimise from random starts; the feasible results, quickest first."""
        found: list[SmoothCandidate] = []
        budget = self.budget
        until = Budget(0.9 * budget.seconds - budget.elapsed)
        if self._previous is not None:
            warm = self._warm(self._previous, until)
            self._previous = None
            if warm is not None:
                return [warm]
        for _ in range(_STARTS):
            late = budget.elapsed > _SEARCH_SHARE * budget.seconds
            if until.spent or (found and late):
                break
            xi = self._random_start()
            program = SmoothProgram(self._task, 0, _COARSE_STEPS)
            with np.errstate(all='ignore'):
                end = program.motion(xi).states[-1]
            if not np.isfinite(end).all():
                continue
            program.turns = self._task.turns_nearest(end)
            minimum = self._minimise(program, xi, until)
            self._starts += 1
            self._closest = min(self._closest, minimum.point.violation)
            if minimum.point.violation <= 1e-5:
                found.append((program, minimum))
        found.sort(key=lambda item: item[1].point.cost)
        costs = np.array([minimum.point.cost for _, minimum in found])
        return [found[i] for i in range(len(found)) if i == 0 or costs[i] > 1.002 * costs[i - 1]]

    def _warm(self, previous: Solution, until: Budget) -> SmoothCandidate | None:
        """Minimise from the rest of a smooth plan; None if that leads nowhere."""
        motion = previous.trajectory
        if motion.interpolation != 'cubic' or motion.control_names != ('torque',):
            return None
        turns = self._task.turns_nearest(motion.states[-1])
        program = SmoothProgram(self._task, turns, _COARSE_STEPS)
        minimum = self._minimise(program, program.fit(motion), until)
        self._starts += 1
        return (program, minimum) if minimum.point.violation <= 1e-5 else None

    def _random_start(self) -> Array:
        """Random t_f and small random end derivatives of the disk's angle."""
        w0 = self._task.plant.natural_frequency
        quickest = max(self._task.quickest, 1e-3 / w0)
        total = quickest * math.exp(self._rng.uniform(math.log(2.0), math.log(14.0)))
        return np.concatenate([[w0 * total], 0.1 * self._rng.normal(size=2 * len(VARIED))])

    def _minimise(self, program: SmoothProgram, xi: Array, budget: Budget) -> Minimum:
        options = TrustRegionOptions(
            penalties=(10.0 / self._task.distance, 10.0),
            radius=0.5,
            iterations=80,
            cost_tolerance=1e-3,
            feasibility=(self._feasibility, 1e-6),
            corrections=3,
        )
        with np.errstate(all='ignore'):
            minimum = minimise(program, xi, options, budget)
        self.budget.evaluations += program.evaluations
        return minimum

    def _trajectory(self, xi: Array) -> Trajectory:
        t_f = float(xi[0]) / self._task.plant.natural_frequency
        count = max(_FEWEST_SAMPLES, math.ceil(t_f / _SAMPLE_TIME))
        motion: Motion = SmoothProgram(self._task, 0, _SUBSTEPS * count).motion(xi)
        return self._task.trajectory(
            to_nanoseconds(np.linspace(0.0, t_f, count + 1)),
            motion.states[::_SUBSTEPS],
            motion.torque[::_SUBSTEPS, None],
            'cubic',
        )
