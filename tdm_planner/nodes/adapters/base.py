# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What stands between a problem and ROS: its state topics, its messages, its picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from tdm_planner.exceptions import NoState
from tdm_planner.nodes.adapters.active_plans import predicted_start
from tdm_planner.nodes.adapters.tracker_watch import TrackerWatch
from tdm_planner.nodes.adapters.vehicle import Vehicle
from tdm_planner.nodes.messages import plan_message, to_stamp
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.replanning import Execution, Mode, Observation
from tdm_planner.trajectory import NANOSECOND, TimedTrajectory, Trajectory

Array = NDArray[np.float64]
T = TypeVar('T')


class PlanRequest(Protocol):
    """Asks the planner node for a plan with some parameters changed."""

    def __call__(
        self, changes: Mapping[str, Any], purpose: str, done: Callable[[str], None]
    ) -> None:
        """
        Plan with `changes`, parameters by name; they are set if there is a plan.

        `purpose` names the request in the log. `done` is called with '' when the plan is
        published, or with the reason why there is none; parameters and active plan then stay
        as they are.
        """


class Found(Protocol):
    """Takes the plan that the trackers follow."""

    def __call__(self, trajectories: Mapping[str, Trajectory], start: int) -> None:
        """Take trajectories by vehicle, starting at `start` [ns]; none where none is followed."""


class Adapter(ABC):
    """
    Gathers measured states for a kind of problem, and publishes its solutions.

    Made once by the planner node, with its plants and the values of its parameters. Methods are
    called in the executor's thread, but for those that say otherwise.
    """

    def __init__(self, node: Node, vehicles: Iterable[Vehicle]) -> None:
        self.node = node
        self.vehicles = {vehicle.name: vehicle for vehicle in vehicles}

    @property
    def trackers(self) -> dict[str, TrackerWatch]:
        """Return what is known of the trackers, by vehicle."""
        return {v.name: v.tracker for v in self.vehicles.values() if v.tracker is not None}

    # What a kind of problem must say.

    @abstractmethod
    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Follow changed parameters, where topics or pictures depend on them."""

    @abstractmethod
    def tracked(self, vehicle: Vehicle, plan: Trajectory) -> Array:
        """Return the largest deviations (nx,) of a plant that follows its plan."""

    @abstractmethod
    def free(self, values: Mapping[str, Any], state: Array, duration: float) -> Array:
        """
        Return a state (nx,) `duration` s later, no plan being followed.

        Raises
        ------
        InvalidProblem, NoState
            If nothing can be said about it.

        """

    def carried(self, away: Array, duration: float) -> Array:
        """Return what is left of a deviation (nx,) from a plan that is followed, `duration` s."""
        del duration
        return np.zeros_like(away)  # the feedback takes it away

    @abstractmethod
    def execution(self, problem: Any) -> Execution:
        """Return what the trackers of these parameters make of plans. In the worker's thread."""

    def with_rates(self, problem: Any, trajectory: Trajectory) -> Trajectory:
        """Return a planned motion with the rates of its states."""
        del problem
        return trajectory

    def publish_motion(
        self, problem: Any, vehicle: Vehicle, trajectory: Trajectory, start: int
    ) -> None:
        """Publish a motion that starts at the instant `start` [ns], on all its topics."""
        del problem
        vehicle.trajectory.publish(plan_message(vehicle.kind, trajectory, to_stamp(start)))

    def draw(self, problem: Any, solution: Solution) -> None:
        """Show a plan, where it has a picture."""
        del problem, solution

    def accept_requests(self, request: PlanRequest) -> None:
        """Begin to ask for plans, where the adapter has topics that ask for them."""
        del request

    # What all have in common.

    @property
    def measures(self) -> bool:
        """Whether there is anything to measure: otherwise plans are made from parameters."""
        return True

    @property
    def replans(self) -> bool:
        """Whether plans are reviewed on the way, by `execution` and `observations`."""
        return self.measures

    def missing(self) -> list[str]:
        """Return a sentence for every topic on which no state was received yet. Any thread."""
        return [v.label + text for v in self.vehicles.values() for text in v.measured.missing]

    def measured_start(self, values: Mapping[str, Any], now: int, start: int) -> dict[str, Any]:
        """
        Return the start.* parameters that the measured state gives for the instant `start`.

        `now` and `start` [ns] are of the node's clock; `values` are the parameters of the request,
        among them `start.max_age`. Called in the worker's thread.

        Raises
        ------
        NoState
            Naming what is missing or too old, and how old it is.

        """
        return self._starts(self._of_all(lambda v: self._predicted(v, values, now, start)))

    def _predicted(
        self, vehicle: Vehicle, values: Mapping[str, Any], now: int, start: int
    ) -> Array:
        state, measured = vehicle.measured.fresh(now, values['start.max_age'])
        plan = self._followed(vehicle, now)
        return predicted_start(
            plan,
            state,
            (measured - now) * NANOSECOND,
            (start - now) * NANOSECOND,
            vehicle.angles,
            tracked=np.zeros(0) if plan is None else self.tracked(vehicle, plan.trajectory),
            free=lambda state, duration: self.free(values, state, duration),
            carried=self.carried,
        )

    def _followed(self, vehicle: Vehicle, now: int) -> TimedTrajectory | None:
        """Return the plan that a plant follows, its instants [s] from `now`; None without one."""
        following = vehicle.mode(now) is Mode.FOLLOWING
        return vehicle.plans.at(now) if following else None

    def rests(self, now: int) -> bool:
        """Whether `measured_start` says the same for every start: a late one can be put off."""
        del now
        return False

    def _of_all(self, ask: Callable[[Vehicle], T]) -> dict[str, T]:
        """Return the answers of all vehicles; NoState names all that are missing."""
        found: dict[str, T] = {}
        missing: list[str] = []
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
            self.vehicles[name].parameter(key): value
            for name, state in states.items()
            for key, value in zip(
                self.vehicles[name].kind.state_names, state.tolist(), strict=True
            )
        }

    def next_start(self, now: int) -> int | None:
        """
        Instant [ns] at which the newest published plan begins; None where it has begun at `now`.

        Until then `measured_start` reckons with the one before. Called in the worker's thread.
        """
        first = next(iter(self.vehicles.values()))  # all begin at once
        return first.plans.next_start(now)

    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish a plan whose motion starts at the instant `start` [ns], and draw it."""
        for name, planned in solution.trajectories.items():
            vehicle, trajectory = self.vehicles[name], self.with_rates(problem, planned)
            self.publish_motion(problem, vehicle, trajectory, start)
            self.note(vehicle, trajectory, start)
        self.draw(problem, solution)

    def note(self, vehicle: Vehicle, trajectory: Trajectory, start: int) -> None:
        """Take note of a plan of instant `start` [ns], along which starts are predicted."""
        vehicle.plans.add(trajectory, start, int(self.node.get_clock().now().nanoseconds))

    def clock_was_set(self, step: int | None) -> None:
        """
        Take note that instants of the node's clock are `step` [ns] more than they were.

        The active plans go on. With None simulated time began anew: trackers have given them up.
        """
        for vehicle in self.vehicles.values():
            vehicle.plans.clock_was_set(step)
            if vehicle.tracker is not None:
                vehicle.tracker.clock_was_set(step)

    def watch_plans_followed(self, found: Found) -> None:
        """
        Begin to listen to what the trackers say they follow.

        `found` gets a plan when all follow parts of it, that is, of one stamp, and none when they
        have given it up.
        """
        newest: dict[str, tuple[Trajectory | None, int]] = {}

        def on_news(name: str, trajectory: Trajectory | None, start: int) -> None:
            newest[name] = trajectory, start
            if len(newest) < len(self.vehicles) or len({s for _, s in newest.values()}) > 1:
                return
            told = {name: followed for name, (followed, _) in newest.items()}
            whole = {name: followed for name, followed in told.items() if followed is not None}
            found(whole if len(whole) == len(told) else {}, start)

        for vehicle in self.vehicles.values():
            vehicle.listen(partial(on_news, vehicle.name))

    def not_following(self, start: int) -> list[str]:
        """Return the vehicles whose trackers do not follow the plan of instant `start` [ns]."""
        return [name for name, watch in self.trackers.items() if watch.rejects(start)]

    @property
    def inactive(self) -> list[str]:
        """Vehicles whose trackers are there, or were, but execute nothing."""
        return [name for name, watch in self.trackers.items() if watch.inactive]

    @property
    def tracker_parameters(self) -> dict[str, Any]:
        """Parameters of the trackers by vehicle, as far as they are known. Any thread."""
        return {
            name: watch.parameters
            for name, watch in self.trackers.items()
            if watch.parameters is not None
        }

    def recognised(
        self,
        problem_class: type[Problem],
        values: Mapping[str, Any],
        trajectories: Mapping[str, Trajectory],
    ) -> tuple[Problem, Solution]:
        """
        Return the problem with parameters `values` that trajectories solve, and the plan.

        Called in the worker's thread.

        Raises
        ------
        TdmError
            If they are no plan of such a problem.

        """
        starts = self._starts({name: t.states[0] for name, t in trajectories.items()})
        problem = problem_class.from_parameters({**values, **starts})
        return problem, problem.recognised(trajectories)

    def observations(
        self, values: Mapping[str, Any], now: int, seconds: Callable[[int], float]
    ) -> dict[str, Observation]:
        """
        Return the newest measured state of every vehicle, and what its tracker does.

        `now` [ns] is the present instant, `seconds` turns instants into those of observations.

        Raises
        ------
        NoState
            Naming what is missing or older than `start.max_age`, and how old it is.

        """

        def seen(vehicle: Vehicle) -> Observation:
            state, instant = vehicle.measured.fresh(now, values['start.max_age'])
            start = None if vehicle.tracker is None else vehicle.tracker.followed(now)
            followed = None if start is None else seconds(start)
            return Observation(state, seconds(instant), vehicle.mode(now), followed)

        return self._of_all(seen)

    def warnings(self) -> list[str]:
        """Return a sentence for every one of several plants or trackers that is not connected."""
        found = []
        for vehicle in self.vehicles.values():
            if not vehicle.prefix:
                continue
            if vehicle.trajectory.get_subscription_count() == 0:
                found.append(
                    f'{vehicle.label}no tracker listens to {vehicle.trajectory.topic_name}'
                )
            if self.node.count_publishers(vehicle.measured.topic) == 0:
                found.append(f'{vehicle.label}no plant publishes {vehicle.measured.topic}')
        return found

    def ages(self, now: int) -> Mapping[str, float | None]:
        """Age of every measured state [s] by name; None where none was received."""
        return {
            topic: age
            for vehicle in self.vehicles.values()
            for topic, age in vehicle.measured.ages(now).items()
        }
