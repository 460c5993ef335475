# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Names and units of states and controls, in the order of their arrays; the units are SI."""

from __future__ import annotations

from typing import Protocol


class Named(Protocol):
    """What has named states and controls."""

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
