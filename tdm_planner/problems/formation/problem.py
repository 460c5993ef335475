# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Problem `robot_formation`: robots on a flat arena move into formation without collision.

Section 4.2 of Yakimenko (2006). By `method: thrust_arcs` the durations of a robot's burns and
coasts are varied. By `polynomials`, the paper's, the arrival times and the free derivatives at the
ends of the reference polynomials of x, y (and yaw) are varied; thrust and torque follow by inverse
dynamics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
import math
from typing import Any, ClassVar

import numpy as np
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build, ParameterSpec, shown, to_mapping
from tdm_planner.problems.formation.parameters import (
    DEFAULT_OFFSETS,
    default_start,
    formation_specifications,
    FormationParameters,
    place_in_arena,
    robot_names,
    RobotStart,
)
from tdm_planner.problems.formation.polynomial_search import PolynomialSearch
from tdm_planner.problems.formation.task import check_places, check_reach, FormationTask
from tdm_planner.problems.formation.thrust_arcs_search import ArcSearch
from tdm_planner.problems.formation.verification import assessed, gas_used, robot_constraints
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint


@lru_cache(maxsize=1)
def _compile() -> None:
    """Compile the kernels by a small problem, once: they take arrays of all sizes."""
    for method in ('thrust_arcs', 'polynomials'):
        problem = RobotFormation(robots=['robot1', 'robot2'], method=method)
        problem.search(Budget(math.inf), np.random.default_rng(0), None).run()


@dataclass(frozen=True)
class RobotFormation(FormationParameters, Problem):
    """
    Robots move into a formation, in the order listed, using little time and gas.

    `starts` and `offsets` hold start state and pose [x, y, yaw] in the anchor's frame by name.

    Raises
    ------
    InvalidProblem
        For a parameter that is not allowed, or starts and goals that contradict the arena.

    """

    name: ClassVar[str] = 'robot_formation'

    starts: Mapping[str, RobotStart] = field(default_factory=dict)
    offsets: Mapping[str, Sequence[float] | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the values, alone and together."""
        super().__post_init__()
        names = robot_names(self.robots)
        known = formation_specifications({'robots': names})
        for kind, default in (('starts', default_start), ('offsets', DEFAULT_OFFSETS.get)):
            given = dict(getattr(self, kind))
            for name in given:
                if name not in names:
                    raise InvalidProblem(
                        f"robot '{name}' is not among parameter 'robots': {', '.join(names)}"
                    )
                if kind == 'offsets':
                    given[name] = known[f'formation.{name}'].check(given[name])
                elif not isinstance(given[name], RobotStart):
                    value = shown(given[name])
                    raise InvalidProblem(f"starts['{name}'] = {value} must be a RobotStart")
            every = {name: given[name] if name in given else default(name) for name in names}
            object.__setattr__(self, kind, every)
        weights = self.weights
        if not weights.time + weights.sequence + weights.gas > 0:
            raise InvalidProblem(
                "parameters 'weights.time', 'weights.sequence', 'weights.gas' are all 0: at least "
                'one must be in (0, inf)'
            )
        self._check_given()
        check_places(self.task, 'start', self.task.start)
        check_places(self.task, 'goal', self.task.goal)

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
            default = to_mapping(default_start(name), f'{name}.start.')
            starts[name] = build(RobotStart, default | dict(values), f'{name}.start.')
            if values.get(f'formation.{name}') is not None:
                offsets[name] = values[f'formation.{name}']
        return cls(**vars(general), starts=starts, offsets=offsets)

    def to_parameters(self) -> dict[str, Any]:
        """Return every parameter's value by dotted name, those of every robot included."""
        values = super().to_parameters()
        for name in self.robots:
            values.update(to_mapping(self.starts[name], f'{name}.start.'))
            values[f'formation.{name}'] = self.offsets[name]
        return values

    @cached_property
    def task(self) -> FormationTask:
        """Boundary conditions and limits as arrays."""
        starts = list(self.starts.values())
        state = np.array([[s.x, s.y, s.u, s.v, s.yaw, s.omega] for s in starts], dtype=float)
        alpha = np.array([math.nan if s.alpha is None else s.alpha for s in starts])
        thrust = np.array([s.thrust for s in starts]) / self.plant.mass
        heading = state[:, 4] + np.nan_to_num(alpha)
        places = [place for place in self.offsets.values() if place is not None]
        goal = np.array([place_in_arena(self.formation.anchor, place) for place in places])
        torque = self.limits.torque / self.plant.inertia
        # The attitude is reached on the turn nearest to where braking alone would end.
        resting = state[:, 4] + state[:, 5] * np.abs(state[:, 5]) / (2 * torque)
        goal_yaw = resting + np.angle(np.exp(1j * (goal[:, 2] - resting)))
        arena, weights = self.arena, self.weights
        task = FormationTask(
            names=tuple(self.robots),
            plant=self.plant,
            start=state[:, :2],
            velocity=state[:, 2:4],
            acceleration=thrust[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1),
            yaw=state[:, 4],
            yaw_rate=state[:, 5],
            yaw_acceleration=np.array([s.torque for s in starts]) / self.plant.inertia,
            alpha=alpha,
            goal=goal[:, :2],
            goal_yaw=goal_yaw,
            thrust=self.limits.thrust / self.plant.mass,
            torque=torque,
            thruster_rate=self.limits.thruster_rate,
            sides=np.array([arena.length, arena.width]),
            separation=arena.minimum_separation,
            margin=arena.tracking_margin,
            obstacles=arena.zones,
            interval=self.arrival_interval,
            weights=np.array([weights.time, weights.sequence, weights.gas]),
            longest=self.solver.longest,
            coast=np.zeros(len(starts)),
            arrived=np.array([s.arrived for s in starts]),
        )
        # Trackers hold robots that stay: a drift would lead them away until the last one arrives.
        return replace(task, velocity=task.velocity * ~task.staying[:, None])

    def _check_given(self) -> None:
        """Check that no robot is without start or place."""
        for name in self.robots:
            for axis in ('x', 'y'):
                if getattr(self.starts[name], axis) is None:
                    raise InvalidProblem(
                        f"the state of robot '{name}' is missing: parameter "
                        f"'{name}.start.{axis}' is unset"
                    )
            if self.offsets[name] is None:
                raise InvalidProblem(
                    f"the place of robot '{name}' is missing: parameter 'formation.{name}' is "
                    'unset, must be [x, y, yaw] relative to formation.anchor'
                )

    @property
    def evaluations_per_second(self) -> float:
        """Return how often a search computes all motions in a second."""
        return 2000.0

    def prepare(self) -> None:
        """Compile the kernels, or load them from the disk."""
        _compile()

    def assess(self, trajectories: Mapping[str, Trajectory]) -> Solution:
        """Return an earlier manoeuvre, with its check and cost recomputed."""
        return assessed(self.task, self, trajectories, np.zeros(0))

    def search(
        self, budget: Budget, rng: np.random.Generator, previous: Solution | None
    ) -> PolynomialSearch | ArcSearch:
        """
        Return the search; the remaining motion of an earlier plan is the initial guess.

        Raise Infeasible if a goal is out of reach in the longest time.
        """
        check_reach(self.task)
        method = PolynomialSearch if self.method == 'polynomials' else ArcSearch
        return method(self.task, self, rng, budget, previous)

    def constraints_on(self, trajectory: Trajectory) -> Sequence[Constraint]:
        """Return the limits of one robot; separations are between robots."""
        return robot_constraints(self.task)

    def describe(self, plan: Solution) -> str:
        """Return when the last robot arrives, and the gas used."""
        count = len(plan.trajectories)
        gas = sum(gas_used(self.plant, trajectory) for trajectory in plan.trajectories.values())
        return (
            f'{count} robot{"s" if count > 1 else ""} in formation after {plan.duration:.2f} s, '
            f'{gas:.3g} m/s of gas'
        )
