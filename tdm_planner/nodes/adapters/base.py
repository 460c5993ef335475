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

"""What stands between a problem and ROS: its state topics, its messages, its picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from rclpy.node import Node
from tdm_planner.nodes.adapters.tracker_watch import TrackerWatch
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.replanning import Execution, Observation
from tdm_planner.trajectory import Trajectory


class PlanRequest(Protocol):
    """Asks the planner node for a plan with some parameters changed."""

    def __call__(
        self, changes: Mapping[str, Any], purpose: str, done: Callable[[str], None]
    ) -> None:
        """
        Plan with `changes`, parameters by name; they are set if there is a plan.

        `purpose` names the request in the log. `done` is called with '' when the plan is
        published, or with the reason why there is none; parameters and plan in force then stay
        as they are.
        """


class Found(Protocol):
    """Takes the plan that the trackers follow."""

    def __call__(self, trajectories: Mapping[str, Trajectory], start: int) -> None:
        """Take trajectories by vehicle, starting at `start` [ns]; none where none is followed."""


class Adapter(ABC):
    """
    Gathers measured states for a kind of problem, and publishes its solutions.

    `trackers` are listened to, by vehicle, where they are of a kind known.
    Made once by the planner node, with the values of its parameters. Methods are called in the
    executor's thread, but for those that say otherwise.
    """

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        self.node = node
        self.trackers: dict[str, TrackerWatch] = {}

    @abstractmethod
    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Follow changed parameters, where topics or pictures depend on them."""

    @property
    def measures(self) -> bool:
        """Whether there is anything to measure: otherwise plans are made from parameters."""
        return True

    def missing(self) -> list[str]:
        """Return a sentence for every topic on which no state was received yet. Any thread."""
        return []

    @abstractmethod
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

    def next_start(self, now: int) -> int | None:
        """
        Instant [ns] at which the newest published plan begins; None where it has begun at `now`.

        Until then `measured_start` reckons with the one before. Called in the worker's thread.
        """
        del now
        return None

    @abstractmethod
    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish a plan whose motion starts at the instant `start` [ns]."""

    def clock_was_set(self, step: int | None) -> None:
        """
        Take note that instants of the node's clock are `step` [ns] more than they were.

        The plans in force go on. With None simulated time began anew: trackers have given them up.
        """
        for watch in self.trackers.values():
            watch.clock_was_set(step)

    def accept_requests(self, request: PlanRequest) -> None:
        """Begin to ask for plans, where the adapter has topics that ask for them."""
        del request

    def watch_plans_followed(self, found: Found) -> None:
        """Begin to listen to what the trackers say they follow, where they do."""
        del found

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
        problem = problem_class.from_parameters({**values, **self.start_of(trajectories)})
        return problem, problem.recognised(trajectories)

    def start_of(self, trajectories: Mapping[str, Trajectory]) -> dict[str, Any]:
        """Return the start.* parameters with which trajectories, by vehicle, begin."""
        raise NotImplementedError

    @property
    def replans(self) -> bool:
        """Whether `execution` and `observations` are there: plans are reviewed on the way."""
        return False

    def execution(self, problem: Problem) -> Execution:
        """Return what the trackers of these parameters make of plans. In the worker's thread."""
        raise NotImplementedError

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
        raise NotImplementedError

    def warnings(self) -> list[str]:
        """Return a sentence for every plant or tracker that is not connected."""
        return []

    @abstractmethod
    def ages(self, now: int) -> Mapping[str, float | None]:
        """Age of every measured state [s] by name; None where none was received."""
