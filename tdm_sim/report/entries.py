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

"""A figure of the summary, planned and achieved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal['duration', 'cost', 'landing', 'margin', 'distance', 'tracking', 'planner']

ROUNDING = 1e-6  # of a margin, in its unit


@dataclass(frozen=True)
class Entry:
    """
    A figure, planned and achieved; None: there is none. '' as vehicle: of all together.

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
