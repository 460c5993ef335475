# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""What the method needs to know of a plant: its equations of motion x' = f(x, u)."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Plant(Protocol):
    """Equations of motion in time, vectorised over leading axes.

    `state_units` and `control_units` are SI, in the order of the names.
    """

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the nx states."""

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of the nx states."""

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the nu controls."""

    @property
    def control_units(self) -> tuple[str, ...]:
        """Units of the nu controls."""

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (..., nx), (..., nu) -> (..., nx)."""
