# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Connects a problem to ROS: the plants' states and trackers, plan messages, markers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from tdm_planner.drawing import DrawnPath
from tdm_planner.exceptions import InvalidProblem, NoState
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.markers import plan_markers
from tdm_planner.nodes.messages import LATCHED, path_message, plan_message, to_stamp
from tdm_planner.nodes.services import Request
from tdm_planner.nodes.vehicle import Vehicle
from tdm_planner.plant_kind import plan_kind
from tdm_planner.plant_views import view_of
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning import ActivePlan, Execution, Observation
from tdm_planner.replanning.planned_plants import planned_plant, Values
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]
T = TypeVar('T')


class ActivePlans:
    """
    The newest published plan, pending or active, and the one that is active until it begins.

    A pending plan that is superseded never becomes active. Safe in any thread.
    """

    def __init__(self) -> None:
        self._plans: tuple[ActivePlan, ...] = ()  # in the order of publication

    def add(self, plan: ActivePlan, now: float) -> None:
        """Add a plan published at the instant `now` [s]."""
        active = self.at(now)
        self._plans = (plan,) if active is None else (active, plan)

    def at(self, now: float) -> ActivePlan | None:
        """Return the plan that is active at an instant [s]; None before the first."""
        return next((plan for plan in reversed(self._plans) if plan.start <= now), None)

    def next_start(self, now: float) -> float | None:
        """Instant [s] at which the newest plan begins; None where that is not after `now`."""
        start = self._plans[-1].start if self._plans else now
        return start if start > now else None


class Adapter:
    """
    Gathers the measured states of a problem's plants, and publishes plans for them.

    `values` are those of the planner's parameters; poses given as goals ask for plans by
    `request`. Instants are those of `clock` [s]. Call methods in the executor's thread, except
    where they say otherwise.
    """

    def __init__(
        self,
        node: Node,
        clock: MotionClock,
        problem: type[Problem],
        values: Values,
        request: Callable[[Request], None],
    ) -> None:
        self._node, self._clock, self._problem = node, clock, problem
        self.plans = ActivePlans()
        self._plant = planned_plant(problem, values)
        names = values['robots'] if self._plant.several else [self._plant.vehicle]
        self.vehicles = {
            name: Vehicle(node, clock, name, self._plant, values, request) for name in names
        }
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)
        self._others: dict[str, Any] = {}  # publishers for vehicles that only the solution names
        self._drawn = False
        self.values_changed(values)

    def values_changed(self, values: Values) -> None:
        """Follow changed parameters; an active plan is drawn as it was made."""
        self._values = values
        for vehicle in self.vehicles.values():
            vehicle.values_changed(values)
        with suppress(InvalidProblem):
            preview = None if self._drawn else self._plant.preview(values)
            if preview is not None:
                self._markers.publish(plan_markers(self._plant.kind.frame, *preview))

    # The state.

    @property
    def measures(self) -> bool:
        """Whether there is anything to measure: otherwise plans are made from parameters."""
        return bool(self._plant.kind.state_names)

    def missing(self) -> list[str]:
        """Return a sentence for every topic on which no state was received yet. Any thread."""
        return [v.label + text for v in self.vehicles.values() for text in v.measured.missing]

    def measured_start(self, values: Values, now: float, start: float) -> dict[str, Any]:
        """
        Return the start.* parameters that the measured state gives for the instant `start`.

        `values` are the parameters of the request. Called in the worker's thread.

        Raise InvalidProblem or NoState naming what is missing or too old, and how old it is.
        """
        plan = self.plans.at(now)
        return self._starts(self._of_all(lambda v: v.predicted(values, now, start, plan)))

    def rests(self, now: float) -> bool:
        """Whether the plant is at rest, so that a late start can be delayed."""
        plan = self.plans.at(now)
        moved = [v.follows(plan, now) for v in self.vehicles.values()] if plan else []
        return self._plant.stays and all(motion is None or motion.end <= now for motion in moved)

    def observations(self, values: Values, now: float) -> dict[str, Observation]:
        """
        Return the newest measured state of every vehicle, and what its tracker does.

        Raise NoState naming what is missing or older than `start.max_age`, and how old it is.
        """
        return self._of_all(lambda vehicle: vehicle.seen(now, values['start.max_age']))

    def ages(self, now: float) -> Mapping[str, float | None]:
        """Age of every measured state [s] by name; None where none was received."""
        vehicles = self.vehicles.values()
        return {topic: age for v in vehicles for topic, age in v.measured.ages(now).items()}

    def _of_all(self, ask: Callable[[Vehicle], T]) -> dict[str, T]:
        """Return the answers of all vehicles; NoState names all that are missing."""
        found, missing = {}, []
        for name, vehicle in self.vehicles.items():
            try:
                found[name] = ask(vehicle)
            except NoState as error:
                missing.append(f'{vehicle.label}{error}')
        if missing:
            raise NoState('; '.join(missing))
        return found

    def _starts(self, states: Mapping[str, Array]) -> dict[str, Any]:
        return {
            f'{name}.start.{key}' if self._plant.several else f'start.{key}': value
            for name, state in states.items()
            for key, value in zip(self._plant.kind.state_names, state.tolist(), strict=True)
        }

    # Plans.

    def publish(self, plan: ActivePlan, stamp: int) -> None:
        """Publish a plan whose motion starts at the instant `stamp` [ns], and draw it."""
        trajectories = plan.solution.trajectories
        for name, trajectory in trajectories.items():
            kind = plan_kind(plan.problem, trajectory)
            besides = self._plant.besides(plan.problem, trajectory)
            message = plan_message(kind, trajectory, to_stamp(stamp), besides)
            self._topic(name, trajectories).publish(message)
            vehicle = self.vehicles.get(name)
            if vehicle is not None and vehicle.path is not None:
                vehicle.path.publish(path_message(kind, trajectory, stamp))
        self.plans.add(plan, self._clock.now())
        self._drawn = True
        view = view_of(plan.problem, next(iter(trajectories.values())))
        paths = [
            DrawnPath(view, motion.states, name if self._plant.several else '')
            for name, motion in trajectories.items()
        ]
        try:
            self._markers.publish(plan_markers(view.kind.frame, view.surroundings(), paths))
        except InvalidProblem as error:  # markers must not cost the plan
            self._node.get_logger().warning(str(error))

    def _topic(self, name: str, motions: Mapping[str, Trajectory]) -> Any:
        """Return the publisher of a motion; vehicles that only a solution names have their own."""
        if name in self.vehicles or len(motions) == 1:
            return self.vehicles.get(name, next(iter(self.vehicles.values()))).trajectory
        if name not in self._others:
            topic = f'{name}/trajectory'
            self._others[name] = self._node.create_publisher(JointTrajectory, topic, LATCHED)
        return self._others[name]

    def forget_plans(self) -> None:
        """Forget the plans: simulated time was set back, and the trackers have dropped them."""
        self.plans = ActivePlans()
        for vehicle in self.vehicles.values():
            vehicle.tracker.forget_plans()

    def recognised(
        self, values: Values, trajectories: Mapping[str, Trajectory], stamp: int
    ) -> ActivePlan:
        """
        Return the plan for parameters `values` that trajectories from the instant [ns] on are.

        Called in the worker's thread.

        Raise TdmError if they are no plan of such a problem.
        """
        starts = self._starts({name: t.states[0] for name, t in trajectories.items()})
        problem = self._problem.from_parameters({**values, **starts})
        solution = problem.recognised(trajectories)
        return ActivePlan(problem, solution, self._clock.instant(stamp))

    # Trackers.

    def execution(self, problem: Any) -> Execution:
        """Return the model of how the trackers execute plans. In the worker's thread."""
        return self._plant.execution(problem, self.tracker_parameters, self._values)

    @property
    def tracker_parameters(self) -> dict[str, Any]:
        """Parameters of the trackers by vehicle, as far as they are known. Any thread."""
        return {
            name: vehicle.tracker.parameters
            for name, vehicle in self.vehicles.items()
            if vehicle.tracker.parameters is not None
        }

    def not_following(self, stamp: int) -> list[str]:
        """Return the vehicles whose trackers do not follow the plan of a start [ns]."""
        return [name for name, v in self.vehicles.items() if v.tracker.rejects(stamp)]

    @property
    def inactive(self) -> list[str]:
        """Return the vehicles whose trackers are inactive, or were heard once and are gone."""
        return [name for name, v in self.vehicles.items() if v.tracker.inactive]

    def warnings(self) -> list[str]:
        """Return a sentence for every plant or tracker of several that is not connected."""
        found = []
        for v in self.vehicles.values() if self._plant.several else ():
            if v.trajectory.get_subscription_count() == 0:
                found.append(f'{v.label}no tracker listens to {v.trajectory.topic_name}')
            if self._node.count_publishers(v.measured.topic) == 0:
                found.append(f'{v.label}no plant publishes {v.measured.topic}')
        return found
