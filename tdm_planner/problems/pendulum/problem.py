# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Problem `pendulum_swing_up`: from any state to upright at rest in the shortest time.

Section 4.1 of Yakimenko (2006). The paper prescribes theta and the torque as functions of the
virtual arc, which together leave no freedom; by default the varied parameters are the switching
times of the torque instead (see `switching_program`). A continuous torque, and motions in which
theta goes one way all along, are stated as a `DirectProblem` (see `smooth`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
import math
from typing import Any, ClassVar

import numpy as np
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.parameters import group, parameter, Range, Validated
from tdm_planner.plants.pendulum_kernels import FeedbackTable, roll_feedback
from tdm_planner.plants.rotary_pendulum import PendulumLimits, RotaryPendulum
from tdm_planner.problems.pendulum.candidates import arcs_of
from tdm_planner.problems.pendulum.smooth import (
    ContinuousTorqueSearch,
    prepare_collocation,
    StatedSwingUp,
)
from tdm_planner.problems.pendulum.switching_search import SwitchingSearch
from tdm_planner.problems.pendulum.task import (
    PENDULUM_NAME,
    PendulumStart,
    SwingUpTask,
    TERMINAL_TOLERANCE,
)
from tdm_planner.problems.planner_parameters import SolverParameters
from tdm_planner.problems.problem import Problem, Search
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import NANOSECOND, to_nanoseconds, Trajectory
from tdm_planner.verification import Constraint

_HOLD_TIME = 5e-3  # s
_COMPILED_TORQUE = 0.012  # N m: of a motor with which a swing-up needs every kernel


@dataclass(frozen=True)
class PendulumGoal(Validated):
    """Which of the upright positions to reach."""

    turns: int | None = parameter(
        None,
        'number n of theta = 2 pi n at the end; unset: whichever is reached first',
        allowed=Range(-1e5, 1e5),
    )


@dataclass(frozen=True)
class PendulumSwingUp(Problem):
    """
    Swing a rotary pendulum up in the shortest time.

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
        'share of limits.torque that plans leave to the feedback; method switching also leaves a '
        'tenth of this share of limits.disk_angle, where that leads to a plan, except in replans',
        allowed=Range(0.0, 1.0, upper_open=True),
    )
    start: PendulumStart = group(PendulumStart)
    goal: PendulumGoal = group(PendulumGoal)
    method: str = parameter(
        'switching',
        'switching: quickest, the torque jumps, mostly to its extremes; smooth: the torque is '
        'continuous, for strong motors that cannot switch; virtual_arc: continuous as well, and '
        'theta goes one way all along, as in (9)-(16) of the paper',
        choices=('switching', 'smooth', 'virtual_arc'),
    )
    switching_arcs: int = parameter(
        4096,
        'largest number of arcs of constant torque in a plan; the search finds how many it takes',
        allowed=Range(4, 4096),
    )
    solver: SolverParameters = group(SolverParameters)

    def __post_init__(self) -> None:
        """Check the values, alone and together."""
        usable = (1.0 - self.torque_reserve) * self.limits.torque
        for name, value, limit, unit, reason in (
            ('psi', self.start.psi, self.limits.disk_angle, 'rad', 'limits.disk_angle'),
            ('torque', self.start.torque or 0.0, usable, 'N m', 'limits.torque, torque_reserve'),
        ):
            if abs(value) > limit:
                raise InvalidProblem(
                    f"parameter 'start.{name}' = {value:g} is not allowed: must be in "
                    f'{Range(-limit, limit)} {unit} ({reason})'
                )

    @property
    def task(self) -> SwingUpTask:
        """Boundary conditions and limits as numbers."""
        start = self.start
        return SwingUpTask(
            plant=self.plant,
            start=np.array([start.theta, start.psi, start.theta_dot, start.psi_dot]),
            planned_torque=(1.0 - self.torque_reserve) * self.limits.torque,
            torque_limit=self.limits.torque,
            disk_angle_limit=self.limits.disk_angle,
            turns=self.goal.turns,
            start_torque=start.torque,
        )

    @property
    def evaluations_per_second(self) -> float:
        """Return how often a search integrates a swing-up in a second; `smooth` begins so, too."""
        return 50_000.0 if self.method != 'virtual_arc' else super().evaluations_per_second

    def prepare(self) -> None:
        """Compile the kernels, or load them."""
        _compile()
        stated = StatedSwingUp(plant=self.plant, one_way=self.method == 'virtual_arc')
        if self.method != 'virtual_arc':  # it does not begin from a switching torque
            prepare_collocation(stated)
        if self.method != 'switching':
            stated.prepare()

    def standing_plan(self) -> Solution | None:
        """Return the plan that does nothing, where the pendulum stands upright already."""
        task = self.task
        error = task.start - task.goal_nearest(task.start)
        if (np.abs(error) > 0.5 * TERMINAL_TOLERANCE).any():
            return None
        time = max(min(_HOLD_TIME, 1.0 / self.plant.natural_frequency), NANOSECOND)
        times = to_nanoseconds([0.0, time])
        still = np.tile(task.start, (2, 1))
        motion = Trajectory.of(self.plant, times, still, np.zeros((2, 1)))
        plan = task.plan(motion.with_rates(self.plant.derivative), np.zeros(0), 0.0)
        return plan if plan.verification.ok else None

    def assess(self, trajectories: Mapping[str, Trajectory]) -> Solution:
        """Return an earlier swing-up, with its check and its arcs' durations recomputed."""
        motion = trajectories[PENDULUM_NAME].with_rates(self.plant.derivative)
        arcs = arcs_of(motion)
        durations = np.zeros(0) if arcs is None else arcs.durations
        return self.task.plan(motion, durations, 0.0)

    def search(
        self, budget: Budget, rng: np.random.Generator, previous: Solution | None
    ) -> Search[Any]:
        """
        Return the search that `method` names; switching starts from earlier arcs as well.

        Raises
        ------
        Infeasible
            If the torque cannot stop the disk before its limit.

        """
        task, tolerance = self.task, self.solver.tolerance
        if task.least_reach > (1.0 + 1e-9) * task.disk_angle_limit:
            raise Infeasible(
                f'{task.unstoppable}: it turns to {task.least_reach:.3g} rad at least'
            )
        psi, speed = self.start.psi, self.start.psi_dot
        if abs(psi) >= task.disk_angle_limit and psi * speed > 0.0:
            raise Infeasible(task.unstoppable)
        switching = partial(
            SwitchingSearch, task, rng=rng, arcs=self.switching_arcs, tolerance=tolerance
        )
        if self.method != 'switching':
            one_way = self.method == 'virtual_arc'
            return ContinuousTorqueSearch(
                task, budget, rng, one_way, lambda until: switching(until).run(), previous
            )
        return switching(
            budget, previous=None if previous is None else arcs_of(previous.trajectory)
        )

    def constraints_on(self, trajectory: Trajectory) -> Sequence[Constraint]:
        """Return the limits of torque and disk angle."""
        return self.task.constraints

    def describe(self, plan: Solution) -> str:
        """Return when the pendulum is upright, by what torque, and how weak that is."""
        motion = plan.trajectories[PENDULUM_NAME]
        torques = motion.control('torque')
        kind = 'a continuous torque'
        if motion.interpolation == 'zero_order_hold':
            kind = f'{motion.switches.size} switches'
        turns = round(float(motion.states[-1, 0]) / (2 * math.pi))
        speeds = np.sign(motion.state('theta_dot')[1:-1])
        swings = 1 + np.count_nonzero(np.diff(speeds[speeds != 0.0]))
        return (
            f'upright at theta = 2 pi * {turns} after {motion.duration:.3f} s, '
            f'{kind} of at most {np.abs(torques).max():.3g} N m, |psi| at most '
            f'{np.abs(motion.state("psi")).max():.2f} rad; drive {self.task.drive:.2g}, '
            f'{swings} swing{"" if swings == 1 else "s"}'
        )


@cache
def _compile() -> None:
    """Compile the kernels or load them from the disk: by a short search, and what it leaves."""
    weak = PendulumSwingUp(limits=PendulumLimits(torque=_COMPILED_TORQUE))
    weak.search(Budget(1.0, evaluations=20_000), np.random.default_rng(0), None).run()
    still = FeedbackTable(np.zeros((1, 4)), np.zeros(1), np.zeros((1, 4)), 1e-3, 1.0)
    roll_feedback(weak.plant, weak.task.start, still)
