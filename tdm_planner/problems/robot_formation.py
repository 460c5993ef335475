# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Problem `robot_formation`: robots on a flat arena move into formation without collision.

Section 4.2 of Yakimenko (2006). The arrival times and the free derivatives at the ends of the
reference polynomials of x, y (and yaw) are varied; thrust, its direction and the torque follow by
inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, InvalidProblem, VerificationFailed
from tdm_planner.parameters import build, ParameterSpec, to_mapping
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.formation_checks import check_task
from tdm_planner.problems.formation_parameters import (
    default_offset,
    default_start,
    formation_specifications,
    FormationParameters,
    robot_names,
    RobotStart,
)
from tdm_planner.problems.formation_plan import trajectory
from tdm_planner.problems.formation_search import Candidate, Form, FormationSearch
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.formation_verification import (
    FormationVerification,
    keeps_reserve,
    verify_formation,
)
from tdm_planner.problems.warm_start import warm_parameters
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_ROUNDS = 4  # searches, each keeping more distance, before giving up


@dataclass(frozen=True)
class RobotFormation(FormationParameters, Problem):
    """Robots move into a formation, in the order listed, using little time and gas.

    `starts` and `offsets` hold start state and pose [x, y, yaw] in the anchor's frame by name.

    Raises
    ------
    InvalidProblem
        For a parameter that is not allowed, or starts and goals that contradict the arena.
    """

    name: ClassVar[str] = 'robot_formation'

    starts: Mapping[str, RobotStart] = field(default_factory=dict)
    offsets: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the values, alone and together."""
        super().__post_init__()
        names = robot_names(self.robots)
        for given in (self.starts, self.offsets):
            for name in given:
                if name not in names:
                    raise InvalidProblem(
                        f"robot '{name}' is not among parameter 'robots': {', '.join(names)}"
                    )
        self._check_orders()
        weights = self.weights
        if not weights.time + weights.sequence + weights.gas > 0:
            raise InvalidProblem(
                "parameters 'weights.time', 'weights.sequence', 'weights.gas' are all 0: at least "
                'one must be in (0, inf)'
            )
        if len(self.arena.obstacles) % 3:
            raise InvalidProblem(
                f"parameter 'arena.obstacles' holds {len(self.arena.obstacles)} numbers: must be "
                'x, y, radius of every zone'
            )
        check_task(self.task)

    def _check_orders(self) -> None:
        for parameter in ('polynomial_order', 'yaw_order'):
            if getattr(self, parameter) % 2 == 0:
                raise InvalidProblem(
                    f"parameter '{parameter}' = {getattr(self, parameter)} is not allowed: must "
                    'be an odd integer in [5, 15]'
                )

    @classmethod
    def parameter_specifications(cls, values: Mapping[str, Any]) -> dict[str, ParameterSpec]:
        """Return every parameter by dotted name, for the robots that `values` names."""
        return formation_specifications(values)

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> RobotFormation:
        """Make a problem from checked values by dotted name."""
        general = build(FormationParameters, values)
        starts, offsets = {}, {}
        for name in general.robots:
            default = default_start(name)
            given = {
                item.name: values.get(f'{name}.start.{item.name}', getattr(default, item.name))
                for item in fields(RobotStart)
            }
            starts[name] = RobotStart(**given)
            offset = values.get(f'formation.{name}', default_offset(name))
            if offset is not None:
                offsets[name] = offset
        shared = {item.name: getattr(general, item.name) for item in fields(FormationParameters)}
        return cls(**shared, starts=starts, offsets=offsets)

    def to_parameters(self) -> dict[str, Any]:
        """Return every parameter's value by dotted name, those of every robot included."""
        values = super().to_parameters()
        for name in self.robots:
            start = self.starts.get(name, default_start(name))
            values.update(to_mapping(start, f'{name}.start.'))
            values[f'formation.{name}'] = self.offsets.get(name, default_offset(name))
        return values

    @property
    def form(self) -> Form:
        """The reference functions asked for."""
        return Form(
            order=self.polynomial_order,
            yaw_order=self.yaw_order,
            speed_factor_order=self.speed_factor_order,
            vary_ends=self.end_accelerations == 'varied',
            nodes=self.nodes,
        )

    @property
    def task(self) -> FormationTask:
        """Boundary conditions and limits as arrays."""
        starts = [self._start(name) for name in self.robots]
        state = np.array([[s.x, s.y, s.u, s.v, s.yaw, s.omega] for s in starts], dtype=float)
        alpha = np.array([math.nan if s.alpha is None else s.alpha for s in starts])
        thrust = np.array([s.thrust for s in starts]) / self.plant.mass
        heading = state[:, 4] + np.nan_to_num(alpha)
        x, y, turn = self.formation.anchor
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        offset = np.array([self._offset(name) for name in self.robots], dtype=float)
        torque = self.limits.torque / self.plant.inertia
        # The attitude is reached on the turn nearest to where braking alone would end.
        resting = state[:, 4] + state[:, 5] * np.abs(state[:, 5]) / (2 * torque)
        goal_yaw = resting + np.angle(np.exp(1j * (turn + offset[:, 2] - resting)))
        arena, weights = self.arena, self.weights
        return FormationTask(
            names=tuple(self.robots),
            plant=self.plant,
            start=state[:, :2],
            velocity=state[:, 2:4],
            acceleration=thrust[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1),
            yaw=state[:, 4],
            yaw_rate=state[:, 5],
            yaw_acceleration=np.array([s.torque for s in starts]) / self.plant.inertia,
            alpha=alpha,
            goal=np.array([x, y]) + offset[:, :2] @ rotation.T,
            goal_yaw=goal_yaw,
            thrust=self.limits.thrust / self.plant.mass,
            torque=torque,
            thruster_rate=self.limits.thruster_rate,
            length=arena.length,
            width=arena.width,
            separation=arena.minimum_separation,
            margin=arena.tracking_margin,
            obstacles=np.array(arena.obstacles, dtype=float).reshape(-1, 3),
            interval=self.arrival_interval,
            weights=np.array([weights.time, weights.sequence, weights.gas]),
            longest=self.solver.longest,
            coast=np.zeros(len(starts)),
        )

    def _start(self, name: str) -> RobotStart:
        start = self.starts.get(name, default_start(name))
        for axis in ('x', 'y'):
            if getattr(start, axis) is None:
                raise InvalidProblem(
                    f"the state of robot '{name}' is missing: parameter '{name}.start.{axis}' is "
                    'unset'
                )
        return start

    def _offset(self, name: str) -> tuple[float, ...]:
        offset = self.offsets.get(name, default_offset(name))
        if offset is None:
            raise InvalidProblem(
                f"the place of robot '{name}' is missing: parameter 'formation.{name}' is unset, "
                'must be [x, y, yaw] relative to formation.anchor'
            )
        return tuple(offset)

    def prepare(self) -> None:
        """Tabulate the reference functions."""
        self.form.model(self.task)

    def solve(
        self,
        deadline: float | None = None,
        seed: int | None = None,
        warm_start: Solution | None = None,
    ) -> Solution:
        """Find the best verified plan; see `Problem.solve`.

        `warm_start` is a plan that was in force: its remaining motion is the first guess.
        """
        budget = Budget(self.solver.deadline if deadline is None else deadline)
        rng = np.random.default_rng(self.solver.seed if seed is None else seed)
        task = self.task
        search = FormationSearch(task, self.form, rng, budget)
        first = None
        if warm_start is not None:
            first = warm_parameters(search.model, search.seeds, warm_start)
        failure: str | None = None
        second_best: Solution | None = None
        tried = 0
        for _ in range(_ROUNDS):
            guess = None if first is None else search.guess_from(first)
            starts = self.solver.starts if guess is None else 0
            candidates = search.minima(starts, guess)
            tried += search.tried
            for candidate in self._improved(search, candidates):
                plan, check = self._check(task, candidate)
                if check.ok:
                    solution = self._solution(task, candidate, plan, check, budget)
                    if keeps_reserve(task, check):
                        return solution
                    second_best = second_best or solution
                else:
                    failure = check.overall.reasons[0]
                if budget.spent:
                    break
            if second_best is not None:
                return replace(second_best, solve_time=budget.elapsed)
            if budget.spent:
                break
            first, search = None, search.wider(rng) if candidates else search
        raise self._failure(search, failure, tried, budget)

    def _improved(
        self, search: FormationSearch, candidates: list[Candidate]
    ) -> Iterator[Candidate]:
        """Candidates with thrusters turned first; then, did none do, with their rate limited."""
        kept = []
        for candidate in candidates:
            turned = search.turned(candidate) or candidate
            kept.append(turned)
            yield turned
        for candidate in kept:
            refined = search.refined(candidate)
            if refined is not None:
                yield refined

    def _check(
        self, task: FormationTask, candidate: Candidate
    ) -> tuple[dict[str, Trajectory], FormationVerification]:
        motion = candidate.motion
        model = candidate.program.model
        plan = {name: trajectory(model, motion, i) for i, name in enumerate(task.names)}
        return plan, verify_formation(task, plan, np.array(self.weights.penalty))

    def _solution(
        self,
        task: FormationTask,
        candidate: Candidate,
        plan: dict[str, Trajectory],
        check: FormationVerification,
        budget: Budget,
    ) -> Solution:
        arrivals = np.array([plan[name].duration for name in task.names])
        gas = np.array(
            [trapezoid(plan[name].control('thrust'), plan[name].times) for name in task.names]
        )
        terms = task.cost_terms(arrivals, gas / task.plant.mass)
        return Solution(
            problem=self.name,
            trajectories=plan,
            cost=sum(terms.values()),
            penalty=check.penalty,
            parameters=candidate.point.xi,
            evaluations=budget.evaluations,
            solve_time=budget.elapsed,
            verification=check.overall,
            verifications=check.robots,
            cost_terms=terms,
            summary=(
                f'{task.n} robot{"s" if task.n > 1 else ""} in formation after '
                f'{arrivals.max():.2f} s, {gas.sum() / task.plant.mass:.3g} m/s of gas'
            ),
        )

    def _failure(
        self, search: FormationSearch, failure: str | None, tried: int, budget: Budget
    ) -> Infeasible:
        if failure is not None:
            return VerificationFailed(f'no plan survived the check: {failure}')
        closest = search.closest
        binding = '' if closest is None else closest.program.binding(closest.point)
        if closest is not None and closest.motion.durations.max() > 0.999 * search.task.longest:
            binding += f' (with arrival as late as solver.longest = {search.task.longest:g} s)'
        if budget.spent:
            return DeadlineExceeded(
                f'no plan within {budget.seconds:g} s from {tried} starts; nearest to one, '
                f'{binding} was violated'
            )
        return Infeasible(f'no plan from {tried} starts: {binding} is violated at best')
