# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A stated plant with a joint and a drawing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from double_integrator import DoubleIntegrator
from tdm_planner.drawing import Box, Disc, Line, Shape


@dataclass(frozen=True)
class Rail(DoubleIntegrator):
    """A cart with a lamp on a rail."""

    name: ClassVar[str] = 'rail'

    def joints(self) -> Mapping[str, tuple[str, str]]:
        return {'cart': ('x', 'v')}

    def drawing(self, x: Sequence[Any]) -> Sequence[Shape]:
        place = x[0]
        return (
            Line(((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)), 'limit'),
            Box((place, 0.0, 0.1), (0.4, 0.2, 0.2)),
            Disc((place, 0.0, 0.3), 0.1, trail=True),
        )


@dataclass(frozen=True)
class Blurred(Rail):
    """The same with a drawing that fails."""

    name: ClassVar[str] = 'blurred'

    def drawing(self, x: Sequence[Any]) -> Sequence[Shape]:
        return (x[7],)
