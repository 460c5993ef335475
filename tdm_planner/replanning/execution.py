# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""How plans are carried out: where the trackers will have brought the plant when a plan begins."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.base import Problem
from tdm_planner.replanning.decision import Outlook
from tdm_planner.replanning.plan_in_force import PlanInForce

Array = NDArray[np.float64]


class Mode(str, Enum):
    """What a tracker does with its plant."""

    FOLLOWING = 'following'  # the plan in force, or holding its goal
    RECOVERING = 'recovering'  # the plan was given up, the plant is brought to rest
    IDLE = 'idle'  # nothing is commanded


@dataclass(frozen=True, eq=False)
class Observation:
    """A vehicle's newest measured state (nx,), its instant `stamp` [s], what its tracker does."""

    state: Array
    stamp: float
    mode: Mode


@dataclass(frozen=True, eq=False)
class Foreseen:
    """State (nx,) of a vehicle at a later instant, and the controls (nu,) in force there.

    `arrived` is the time [s] since the plan's arrival at its goal, 0 on the way.
    """

    state: Array
    control: Array
    mode: Mode
    arrived: float = 0.0


class Execution(ABC):
    """What the trackers of one kind of problem make of a plan, by the same laws as theirs."""

    @abstractmethod
    def adopt(self, plan: PlanInForce) -> None:
        """Do what can be done before a plan is carried out (its gains)."""

    @abstractmethod
    def foresee(
        self, plan: PlanInForce, observations: Mapping[str, Observation], at: float
    ) -> dict[str, Foreseen]:
        """States at the instant `at` [s], by vehicle: measured, then moved under the feedback."""

    @abstractmethod
    def outlook(self, plan: PlanInForce, foreseen: Mapping[str, Foreseen], at: float) -> Outlook:
        """Return what becomes of the plan in force if it is carried on from the instant `at`."""

    @abstractmethod
    def problem_from(self, problem: Any, foreseen: Mapping[str, Foreseen]) -> Problem:
        """Return the same problem with the foreseen states to start from.

        Raises
        ------
        InvalidProblem
            If they contradict the limits.
        """

    @abstractmethod
    def same_question(self, problem: Any, other: Any) -> bool:
        """Whether two problems differ in nothing but their start (and how they are solved)."""
