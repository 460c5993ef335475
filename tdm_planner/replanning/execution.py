# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How plans are executed: the plant's state under the trackers, predicted at a plan's start."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning.active_plan import ActivePlan
from tdm_planner.replanning.decision import Outlook
from tdm_planner.trajectory import Sample

Array = NDArray[np.float64]

_SAME_START = 1e-6  # s; instants are told in nanoseconds


class Mode(str, Enum):
    """What a tracker does with its plant."""

    FOLLOWING = 'following'  # the active plan, or holding its goal
    RECOVERING = 'recovering'  # the plan was aborted, the plant is brought to rest
    IDLE = 'idle'  # nothing is commanded


@dataclass(frozen=True, eq=False)
class Observation:
    """
    A vehicle's newest measured state (nx,), its instant `stamp` [s], what its tracker does.

    `followed` is the start [s] of the plan that the tracker says it follows; None where it follows
    none, or does not tell.
    """

    state: Array
    stamp: float
    mode: Mode
    followed: float | None = None


@dataclass(frozen=True, eq=False)
class Predicted:
    """
    State (nx,) of a vehicle at a later instant, and the controls (nu,) that act there.

    `arrived` is the time [s] since the plan's arrival at its goal, 0 on the way; `planned` what
    the plan has there, given where the vehicle is to be taken to be on it.
    """

    state: Array
    control: Array
    mode: Mode
    arrived: float = 0.0
    planned: Sample | None = None


class Execution(ABC):
    """
    What the trackers of one kind of problem make of a plan, by the same laws as theirs.

    `holds_goal` says that the goal is held after a plan's end, so that it is active until the
    next.
    """

    holds_goal: ClassVar[bool] = True

    @abstractmethod
    def adopt(self, plan: ActivePlan) -> None:
        """Prepare the execution of a plan (compute its gains)."""

    @abstractmethod
    def predict(
        self, plan: ActivePlan, observations: Mapping[str, Observation], at: float
    ) -> dict[str, Predicted]:
        """States at the instant `at` [s], by vehicle: measured, then moved under the feedback."""

    @abstractmethod
    def outlook(self, plan: ActivePlan, predicted: Mapping[str, Predicted], at: float) -> Outlook:
        """Return what becomes of the active plan if it is carried on from the instant `at`."""

    def keeping(
        self, earlier: ActivePlan, newer: ActivePlan, observations: Mapping[str, Observation]
    ) -> list[str]:
        """
        Return the vehicles whose trackers tell that they follow `earlier`, and not `newer`.

        Trackers reject plans that begin too far from where the plant is.
        """
        return [
            name
            for name, seen in observations.items()
            if seen.followed is not None
            and abs(seen.followed - earlier.start) < _SAME_START < newer.start - earlier.start
        ]

    @abstractmethod
    def problem_from(self, problem: Any, predicted: Mapping[str, Predicted]) -> Problem:
        """
        Return the same problem, with the predicted states as its start.

        Raises
        ------
        InvalidProblem
            If they contradict the limits.

        """

    @abstractmethod
    def same_question(self, problem: Any, other: Any) -> bool:
        """Whether two problems differ in nothing but their start (and how they are solved)."""
