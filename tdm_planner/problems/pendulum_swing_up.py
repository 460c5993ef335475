# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Problem `pendulum_swing_up`: from any state to upright at rest in the shortest time.

Section 4.1 of Yakimenko (2006). The paper prescribes theta and the torque as functions of the
virtual arc, which together leave no freedom; here the varied parameters are the switching times of
the torque (see `switching_program`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import DeadlineExceeded, InvalidProblem, VerificationFailed
from tdm_planner.parameters import group, parameter, POSITIVE, Range, Validated
from tdm_planner.plants.pendulum_rollout import compile_kernels
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems.base import Problem, Solution, SolverParameters
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_search import (
    Candidate,
    COARSE_STEPS,
    FINE_STEPS,
    polish,
    random_arcs,
    steered,
    trajectory,
    without_short_arcs,
)
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Verification

Array = NDArray[np.float64]

_STARTS = 240
_POLISHED = 8
_STEERING_SHARE = 0.6  # of the deadline, after which no more starts are steered,
_POLISHING_SHARE = 0.85  # and no more candidates polished


@dataclass(frozen=True)
class PendulumLimits(Validated):
    """Limits of actuator and rig."""

    torque: float = parameter(
        0.02, "largest torque of the disk's motor, either way", unit='N m', allowed=POSITIVE
    )
    disk_angle: float = parameter(
        2.0, 'largest angle of the disk, either way', unit='rad', allowed=POSITIVE
    )


@dataclass(frozen=True)
class PendulumStart(Validated):
    """State to start from."""

    theta: float = parameter(
        math.pi, "pendulum's angle from upright", unit='rad', allowed=Range(-1e6, 1e6)
    )
    psi: float = parameter(0.0, "disk's angle", unit='rad')
    theta_dot: float = parameter(
        0.0, "pendulum's angular velocity", unit='rad/s', allowed=Range(-1e4, 1e4)
    )
    psi_dot: float = parameter(
        0.0, "disk's angular velocity", unit='rad/s', allowed=Range(-1e4, 1e4)
    )


@dataclass(frozen=True)
class PendulumGoal(Validated):
    """Which of the upright positions to reach."""

    turns: int | None = parameter(
        None,
        'number n of theta = 2 pi n at the end; unset: whichever is reached first',
        allowed=Range(-1e5, 1e5),
    )


@dataclass(frozen=True)
class PendulumSwingUp(Problem, Validated):
    """Swing a rotary pendulum up in the shortest time.

    Raises
    ------
    InvalidProblem
        For a parameter that is not allowed, or a start beyond the disk's limit.
    """

    name: ClassVar[str] = 'pendulum_swing_up'

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumLimits = group(PendulumLimits)
    torque_reserve: float = parameter(
        0.3,
        'share of limits.torque that plans leave to the feedback',
        allowed=Range(0.0, 1.0, upper_open=True),
    )
    start: PendulumStart = group(PendulumStart)
    goal: PendulumGoal = group(PendulumGoal)
    method: str = parameter(
        'switching',
        'switching: quickest, torque jumps between its extremes',
        choices=('switching',),
    )
    switching_arcs: int = parameter(
        8, 'most arcs of constant torque in a plan', allowed=Range(4, 32)
    )
    solver: SolverParameters = group(SolverParameters)

    def __post_init__(self) -> None:
        """Check the values, alone and together."""
        super().__post_init__()
        if abs(self.start.psi) > self.limits.disk_angle:
            allowed = Range(-self.limits.disk_angle, self.limits.disk_angle)
            raise InvalidProblem(
                f"parameter 'start.psi' = {self.start.psi:g} is not allowed: must be in {allowed} "
                'rad (limits.disk_angle)'
            )

    @property
    def task(self) -> SwingUpTask:
        """Boundary conditions and limits as numbers."""
        start = self.start
        return SwingUpTask(
            plant=self.plant,
            start=np.array([start.theta, start.psi, start.theta_dot, start.psi_dot]),
            torque=(1.0 - self.torque_reserve) * self.limits.torque,
            torque_limit=self.limits.torque,
            disk_angle=self.limits.disk_angle,
            turns=self.goal.turns,
        )

    def prepare(self) -> None:
        """Compile the kernels, or load them."""
        compile_kernels(self.plant)

    def solve(
        self,
        deadline: float | None = None,
        seed: int | None = None,
        warm_start: Solution | None = None,
    ) -> Solution:
        """Find the quickest verified swing-up; see `Problem.solve`."""
        self.prepare()
        budget = Budget(self.solver.deadline if deadline is None else deadline)
        rng = np.random.default_rng(self.solver.seed if seed is None else seed)
        task = self.task
        resting = task.hold()
        if resting is not None:
            check = task.verify(resting)
            if check.ok:
                return self._solution(
                    Candidate(np.zeros(0), np.zeros(0), 0), resting, check, budget
                )
        failure = ''
        starts = 0
        while not budget.spent:
            batch = random_arcs(task, rng, _STARTS, self.switching_arcs)
            starts += _STARTS
            candidates = steered(task, batch, budget, _STEERING_SHARE * budget.seconds)
            for candidate in self._polished(task, candidates, budget):
                fine, violation = polish(
                    task,
                    without_short_arcs(task, candidate),
                    FINE_STEPS,
                    self.solver.tolerance,
                    budget,
                )
                plan = trajectory(task, fine)
                check = task.verify(plan)
                if check.ok:
                    return self._solution(fine, plan, check, budget, violation)
                failure = check.reasons[0]
                if budget.spent:
                    break
        if failure:
            raise VerificationFailed(f'no plan survived the check: {failure}')
        raise DeadlineExceeded(
            f'no plan within {budget.seconds:g} s from {starts} starts with torque up to '
            f'{task.torque:.3g} N m (limits.torque, torque_reserve)'
        )

    def _polished(
        self, task: SwingUpTask, candidates: list[Candidate], budget: Budget
    ) -> Iterator[Candidate]:
        done: list[Candidate] = []
        best = math.inf
        for candidate in candidates[:_POLISHED]:
            if budget.elapsed > _POLISHING_SHARE * budget.seconds:
                done.append(candidate)
                continue
            better, violation = polish(
                task,
                candidate,
                COARSE_STEPS,
                self.solver.tolerance,
                budget,
                cutoff=None if math.isinf(best) else 1.05 * best,
            )
            done.append(better)
            if violation < 1e-6:
                best = min(best, better.total)
        return iter(sorted(done, key=lambda c: c.total))

    def _solution(
        self,
        candidate: Candidate,
        plan: Trajectory,
        check: Verification,
        budget: Budget,
        penalty: float = 0.0,
    ) -> Solution:
        switches = max(candidate.durations.size - 1, 0)
        return Solution(
            problem=self.name,
            trajectories={'pendulum': plan},
            cost=plan.duration,
            penalty=penalty,
            parameters=candidate.durations,
            evaluations=budget.evaluations,
            solve_time=budget.elapsed,
            verification=check,
            summary=(
                f'swing-up in {plan.duration:.3f} s with {switches} switches of '
                f'{(1 - self.torque_reserve) * self.limits.torque:.3g} N m'
            ),
        )
