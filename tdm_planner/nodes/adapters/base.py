# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""What stands between a problem and ROS: its state topics, its messages, its picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from rclpy.node import Node

from tdm_planner.problems.base import Problem, Solution


class Adapter(ABC):
    """Gathers measured states for a kind of problem, and publishes its solutions.

    Made once by the planner node, with the values of its parameters. Every method but
    `measured_start` is called in the executor's thread.
    """

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        self.node = node

    @abstractmethod
    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Follow changed parameters, where topics or pictures depend on them."""

    @abstractmethod
    def measured_start(self, values: Mapping[str, Any], now: int, start: int) -> dict[str, Any]:
        """Return the start.* parameters that the measured state gives for the instant `start`.

        `now` and `start` [ns] are of the node's clock; `values` are the parameters of the request,
        among them `start.max_age`. Called in the worker's thread.

        Raises
        ------
        NoState
            Naming what is missing or too old, and how old it is.
        """

    @abstractmethod
    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish a plan whose motion starts at the instant `start` [ns]."""

    def warnings(self) -> list[str]:
        """Return a sentence for every plant or tracker that is not connected."""
        return []

    @abstractmethod
    def ages(self, now: int) -> Mapping[str, float | None]:
        """Age of every measured state [s] by name; None where none was received."""
