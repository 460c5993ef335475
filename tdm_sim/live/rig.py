# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The plants that the page shows, from the parameters of their planner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.client import PlanResult
from tdm_planner.drawing import Shape
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.plant_views import PlantView, view_of
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_planner.trajectory import NANOSECOND, TimedTrajectory, Trajectory
from tdm_sim.live.geometry import Colour, colour_of
from tdm_sim.live.listener import Listener, Motion, Vehicle

Array = NDArray[np.float64]


class Rig:
    """
    Problem, vehicles and their motions, and the plan.

    It is empty until `follow` was given the parameters of the planner.
    """

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self.problem: Problem | None = None
        self.view = PlantView(PENDULUM)
        self.vehicles: dict[str, Vehicle] = {}
        self.motions: dict[str, Motion] = {}
        self.plan: PlanResult | None = None
        self.chosen = ''

    def follow(self, values: Mapping[str, Any]) -> bool:
        """
        Update from the planner's parameters; returns whether the vehicles have changed.

        Raise InvalidProblem if they do not make a problem.
        """
        kind = load_problem(values['problem'])
        known = kind.parameter_specifications(values)
        problem = kind.from_parameters({name: values.get(name) for name in known})
        view, several = view_of(problem), isinstance(problem, RobotFormation)
        names = list(problem.robots) if isinstance(problem, RobotFormation) else [view.name]
        others = self.problem is None or self.view.kind != view.kind
        others |= names != list(self.vehicles)
        if others:
            self.vehicles = {
                name: self._listener.vehicle(view.kind, f'{name}/' if several else '')
                for name in names
            }
            self.chosen, self.plan, self.motions = names[0], None, {}
        self.problem, self.view = problem, view
        return others

    def move(self) -> bool:
        """Update the newest states and the newest plan; returns whether the plan has changed."""
        news = {name: vehicle.newest() for name, vehicle in self.vehicles.items()}
        self.motions = {name: motion for name, motion in news.items() if motion is not None}
        before, self.plan = self.plan, self._listener.client.newest
        return self.plan is not before

    def drawn(self, state: Array, control: Array | None = None) -> Sequence[Shape]:
        """Return the shapes of a vehicle in states (nx,) or (n, nx), under controls if given."""
        kind = self.view.kind
        x = dict(zip(kind.state_names, state.T, strict=True))
        controls = () if control is None else zip(kind.control_names, control.T, strict=True)
        return self.view.drawing(x, dict(controls))

    def colour(self, name: str) -> Colour | None:
        """Return the colour of a vehicle; None where there is only one."""
        return colour_of(list(self.vehicles).index(name), len(self.vehicles))

    def trajectory(self, name: str) -> Trajectory | None:
        """Return what is planned for a vehicle."""
        if self.plan is None:
            return None
        planned = self.plan.trajectories
        return planned.get(name) if len(self.vehicles) > 1 else next(iter(planned.values()))

    def timed(self, name: str) -> TimedTrajectory | None:
        """Return what is planned for a vehicle, by instants [s] of the nodes' clock."""
        planned = self.trajectory(name)
        if planned is None or self.plan is None:
            return None
        return TimedTrajectory(planned, self.plan.start * NANOSECOND)
