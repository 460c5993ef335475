# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A figure of the summary, planned and achieved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal['duration', 'cost', 'landing', 'margin', 'distance', 'tracking', 'planner']

ROUNDING = 1e-6  # of a margin, in its unit


@dataclass(frozen=True)
class Entry:
    """A figure, planned and achieved; None: there is none. '' as vehicle: of all together.

    `planned_at` and `achieved_at` are instants since the mission's origin [s]. `mark` is a word on
    the achieved value.
    """

    kind: Kind
    name: str
    unit: str
    planned: float | None = None
    achieved: float | None = None
    planned_at: float | None = None
    achieved_at: float | None = None
    vehicle: str = ''
    note: str = ''
    mark: str = ''

    @property
    def violated(self) -> bool:
        """Whether this is a margin that was not kept, as planned or as achieved."""
        known = [value for value in (self.planned, self.achieved) if value is not None]
        return self.kind == 'margin' and any(value < -ROUNDING for value in known)
