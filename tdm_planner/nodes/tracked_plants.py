# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The plants that a tracker can be told to track: their joints, parameters and feedback laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.stated_plants import problem_from, stated_problem, with_parameters_of
from tdm_planner.parameters import shown, to_mapping
from tdm_planner.plant_kind import kind_of, PENDULUM, PlantKind, ROBOT
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_planner.problems.registry import problem_names
from tdm_planner.tracking import TrajectoryTracker
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker
from tdm_planner.tracking.stated_tracking import StatedTracker
from tdm_planner.tracking.tracker_parameters import TrackerParameters


@dataclass(frozen=True)
class TrackedPlant:
    """
    A plant as its tracker knows it.

    `make_tracker` returns the feedback law for parameters of the class `parameters`; it raises
    InvalidProblem for such as do not fit.
    """

    kind: PlantKind
    parameters: type[TrackerParameters]
    make_tracker: Callable[[Any], TrajectoryTracker]


def _pendulum_tracker(parameters: PendulumTrackerParameters) -> PendulumTracker:
    tracker = PendulumTracker(parameters)
    tracker.prepare_hold()
    return tracker


_BUILT_IN: Mapping[str, TrackedPlant] = MappingProxyType(
    {
        'pendulum': TrackedPlant(PENDULUM, PendulumTrackerParameters, _pendulum_tracker),
        'robot': TrackedPlant(ROBOT, RobotTrackerParameters, RobotTracker),
    }
)


# The problems whose plants they are, by the names that planner and plant have for them.
_OF_PROBLEM: Mapping[str, str] = MappingProxyType(
    {'pendulum_swing_up': 'pendulum', 'robot_formation': 'robot'}
)


def tracked_problem(problem: type[DirectProblem]) -> TrackedPlant:
    """Return the plant of a stated problem; its tracker has the problem's parameters as well."""

    def make_tracker(parameters: Any) -> TrajectoryTracker:
        return StatedTracker(problem_from(problem, to_mapping(parameters)), parameters)

    kind = kind_of(problem())
    return TrackedPlant(kind, with_parameters_of(TrackerParameters, problem), make_tracker)


def tracked_plant(kind: str) -> TrackedPlant:
    """
    Return the plant of a kind: pendulum, robot, or the problem of that name.

    Raises
    ------
    InvalidProblem
        If there is none of that name.

    """
    kind = _OF_PROBLEM.get(kind, kind)
    if kind in _BUILT_IN:
        return _BUILT_IN[kind]
    if ':' not in kind and kind not in problem_names():
        raise InvalidProblem(
            f"parameter 'kind' = '{shown(kind)}' is not allowed: must be one of "
            f'{", ".join(_BUILT_IN)}, or a stated problem such as my_module:MyProblem'
        )
    return tracked_problem(stated_problem(kind))
