# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Method `smooth`: a verified swing-up with a continuous torque, for motors that cannot switch."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, VerificationFailed
from tdm_planner.problems.smooth_program import Motion, SmoothProgram, VARIED
from tdm_planner.problems.swing_up_task import SwingUpPlan, SwingUpTask
from tdm_planner.trajectory import to_nanoseconds, Trajectory

Array = NDArray[np.float64]

_STARTS = 12  # of which the quickest result is taken
_SEARCH_SHARE = 0.7  # of the deadline, after which the search ends as soon as there is a result
_POLISH_SHARE = 0.92  # of the deadline, which leaves the rest to the verification
_COARSE_STEPS, _FINE_STEPS = 60, 240  # RK4 steps while searching, and for the final polish
_SAMPLE_TIME = 2e-3  # [s], at most; short, as the torque is read by a spline between samples
_FEWEST_SAMPLES = 250
_SUBSTEPS = 4  # RK4 steps between two samples


class SmoothMethod:
    """One search; `solve` runs it."""

    def __init__(
        self, task: SwingUpTask, budget: Budget, rng: np.random.Generator, tolerance: float
    ) -> None:
        self._task = task
        self._budget = budget
        self._rng = rng
        self._feasibility = max(tolerance, 1e-11)
        self._starts = 0
        self._closest = math.inf
        self._rejected = ''

    def solve(self) -> SwingUpPlan:
        """Return the quickest plan found that passes the verification.

        Raises
        ------
        DeadlineExceeded, VerificationFailed
            If there is none within the budget.
        """
        while not self._budget.spent:
            for program, minimum in self._minima():
                plan = self._verified(program.turns, minimum)
                if plan is not None:
                    return plan
                if self._budget.spent:
                    break
        if self._rejected:
            raise VerificationFailed(
                f'smooth swing-ups were found, but none within {self._budget.seconds:g} s that '
                f'passes the check: {self._rejected}'
            )
        raise DeadlineExceeded(
            f'in {self._budget.seconds:g} s, {self._starts} starts with smooth torques of at most '
            f'{self._task.torque:.3g} N m (limits.torque less torque_reserve) gave no swing-up; '
            f"the least violation was {self._closest:.2g}; weak torque needs method 'switching'"
        )

    def _minima(self) -> list[tuple[SmoothProgram, Minimum]]:
        """Minimise from random starts; the feasible results, quickest first."""
        found: list[tuple[SmoothProgram, Minimum]] = []
        budget = self._budget
        until = Budget(0.9 * budget.seconds - budget.elapsed)
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
        self._budget.evaluations += program.evaluations
        return minimum

    def _verified(self, turns: int, coarse: Minimum) -> SwingUpPlan | None:
        """Polish with finer steps, write the trajectory, check it."""
        program = SmoothProgram(self._task, turns, _FINE_STEPS)
        until = Budget(_POLISH_SHARE * self._budget.seconds - self._budget.elapsed)
        minimum = self._minimise(program, coarse.point.xi, until)
        if minimum.point.violation > 1e-5:
            self._rejected = f'a limit is violated by {minimum.point.violation:.2g} of its value'
            return None
        motion = self._trajectory(minimum.point.xi)
        check = self._task.verify(motion)
        if not check.ok:
            self._rejected = check.reasons[0]
            return None
        return SwingUpPlan(motion, check, minimum.point.xi, minimum.point.violation)

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
