# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The plant of a stated problem, from the statement itself and from its trace."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.flight import Integrator
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.graphs import Call
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.exceptions import NotFinite
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Flight

Array = NDArray[np.float64]

_SAME = 1e-7  # share by which traced rates may differ from numpy's along a plan


@dataclass(frozen=True)
class DirectPlant:
    """The plant of a formulation, as its `derivative` says."""

    formulation: Formulation

    @cached_property
    def stated(self) -> CheckedFormulation:
        """Return the functions of the formulation, checked."""
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
        stacked = self.stated.derivative(state, control)
        if not np.isfinite(stacked).all():
            index = np.unravel_index(int(np.argmin(np.isfinite(stacked))), stacked.shape)
            raise NotFinite(
                f"derivative gives the rate of '{self.state_names[index[-1]]}' = {stacked[index]} "
                f'in state {state[index[:-1]]} under control {control[index[:-1]]}'
            )
        return stacked


class TracedPlant(DirectPlant):
    """
    The same, quick at one state and with derivatives: by the trace.

    `agrees` compares it with the statement along a whole plan.
    """

    def __init__(self, formulation: Formulation, trace: Trace | None = None) -> None:
        super().__init__(formulation)
        trace = trace or Trace.of(self.stated)
        object.__setattr__(self, '_trace', trace)
        object.__setattr__(self, '_numbers', trace.values(formulation))
        object.__setattr__(self, '_one', Call(trace.rates))

    _trace: Trace
    _numbers: Array
    _one: Call

    @cached_property
    def _slopes(self) -> Any:
        """Return the Jacobians by states and controls, column by column, as a CasADi function."""
        rates = self._trace.rates

        def make() -> Any:
            x, u, p = (ca.SX.sym(name, rates.size1_in(i)) for i, name in enumerate('xup'))
            slopes = ca.jacobian(rates(x, u, p), ca.vertcat(x, u))
            return ca.Function('slopes', [x, u, p], [ca.vec(ca.densify(slopes))])

        return self._trace.once('slopes', make)

    @cached_property
    def _one_slope(self) -> Call:
        return Call(self._slopes)

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (..., nx), (..., nu) -> (..., nx)."""
        if state.ndim > 1:
            return super().derivative(state, control)
        rates: Array = self._one(state, control, self._numbers)[0].copy()
        return rates if np.isfinite(rates).all() else super().derivative(state, control)

    def fly(self, trajectory: Trajectory, until: Budget | None) -> Flight | None:
        """Integrate along linear controls; None: with others, or where it cannot go on."""
        if trajectory.interpolation != 'linear':
            return None
        given = trajectory.times, trajectory.controls, trajectory.states[0]
        flown = Integrator.of(self._trace)(*given, self._numbers, until)
        return None if flown is None else Flight([flown], trajectory.states.shape[1])

    def jacobians(self, state: Array, control: Array) -> tuple[Array, Array]:
        """Return df/dx (..., nx, nx) and df/du (..., nx, nu), at one state or at many (N, ..)."""
        nx, nu = state.shape[-1], control.shape[-1]
        call = self._one_slope if state.ndim == 1 else Call(self._slopes, len(state))
        flat = call(state, control, self._numbers)[0]
        slopes = np.swapaxes(flat.reshape(*state.shape[:-1], nx + nu, nx), -1, -2).copy()
        return slopes[..., :nx], slopes[..., nx:]

    @cached_property
    def _one_margin(self) -> Call:
        return Call(self._trace.margins)

    def control_margins(self, time: float, state: Array, control: Array) -> Array:
        """Return what is left to the limits in which the controls have a part, (nm,)."""
        margins = self._one_margin(time, state, control, self._numbers)[0]
        found: Array = margins[self._trace.of_controls]
        return found

    def agrees(self, states: Array, controls: Array) -> bool:
        """Whether the trace gives what numpy gives at states (N, nx) and controls (N, nu)."""
        stated = super().derivative(states, controls)
        traced = np.array([self.derivative(x, u) for x, u in zip(states, controls, strict=True)])
        size = 1.0 + np.abs(stated).max(axis=0)
        return bool((np.abs(stated - traced) <= _SAME * size).all())
