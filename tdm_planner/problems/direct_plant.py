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

"""The plant of a stated problem, from the statement itself and from its trace."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.tracing import Call, Trace
from tdm_planner.exceptions import NotFinite

Array = NDArray[np.float64]

_SAME = 1e-7  # share by which traced rates may differ from numpy's along a plan


@dataclass(frozen=True)
class DirectPlant:
    """The plant of a formulation, as its `derivative` says."""

    formulation: Formulation

    @cached_property
    def _stated(self) -> CheckedFormulation:
        return CheckedFormulation(self.formulation)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.formulation.state_names

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of the states."""
        return self.formulation.state_units

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the controls."""
        return self.formulation.control_names

    @property
    def control_units(self) -> tuple[str, ...]:
        """Units of the controls."""
        return self.formulation.control_units

    def derivative(self, state: Array, control: Array) -> Array:
        """
        Time derivative of the states: (..., nx), (..., nu) -> (..., nx).

        Raises
        ------
        NotFinite
            Naming the state, if a rate is not a finite number.

        """
        stacked = self._stated.derivative(state, control)
        if not np.isfinite(stacked).all():
            index = np.unravel_index(int(np.argmin(np.isfinite(stacked))), stacked.shape)
            raise NotFinite(
                f"derivative gives the rate of '{self.state_names[index[-1]]}' = {stacked[index]} "
                f'in state {state[index[:-1]]} under control {control[index[:-1]]}'
            )
        return stacked


class TracedPlant(DirectPlant):
    """The same, quick at one state: by the trace, which `agrees` compares along a whole plan."""

    def __init__(self, formulation: Formulation, trace: Trace) -> None:
        super().__init__(formulation)
        numbers, call = trace.values(formulation), Call(trace.rates)
        object.__setattr__(self, '_one', lambda x, u: call(x, u, numbers)[0])

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (..., nx), (..., nu) -> (..., nx)."""
        if state.ndim > 1:
            return super().derivative(state, control)
        rates: Array = self._one(state, control).copy()  # type: ignore[attr-defined]
        return rates if np.isfinite(rates).all() else super().derivative(state, control)

    def agrees(self, states: Array, controls: Array) -> bool:
        """Whether the trace gives what numpy gives at states (N, nx) and controls (N, nu)."""
        stated = super().derivative(states, controls)
        traced = np.array([self.derivative(x, u) for x, u in zip(states, controls, strict=True)])
        size = 1.0 + np.abs(stated).max(axis=0)
        return bool((np.abs(stated - traced) <= _SAME * size).all())
