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

"""
What a user states, called with care: what goes wrong in there is said in one sentence.

A user's function may raise, return too many or too few components, other shapes or types than it
should, numbers that are not finite, or mix candidates that are computed at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.checks import shown
from tdm_planner.direct_method.formulation import (
    components,
    Duration,
    Formulation,
    Integrated,
    Output,
    Outputs,
    stack,
)
from tdm_planner.exceptions import InvalidProblem, TdmError

Array = NDArray[np.float64]
# Real, or complex where derivatives are taken by complex step.
Values = NDArray[Any]


class CheckedFormulation:
    """
    The functions of a formulation on arrays (B, K, n) of states and controls.

    Every method raises `InvalidProblem`, naming the function and what is wrong with it; an error
    of the user's function is its cause.
    """

    def __init__(self, formulation: Formulation) -> None:
        self.formulation = formulation
        self.state_names = self._names('state')
        self.control_names = self._names('control')
        self._margin_names: list[str] | None = None

    @property
    def margin_names(self) -> list[str]:
        """Names of the limits, once they have been asked for."""
        return self._margin_names or []

    def outputs(self) -> dict[str, Output]:
        """Return the reference functions by name, at least one."""
        found = self._mapping('outputs', Output)
        if not found:
            raise InvalidProblem('a formulation needs at least one output')
        return found

    def integrated(self) -> dict[str, Integrated]:
        """Return the integrated states by name."""
        found = self._mapping('integrated', Integrated)
        for name in found:
            if name not in self.state_names:
                raise InvalidProblem(
                    f"integrated state '{name}' is not one of the states "
                    + ', '.join(self.state_names)
                )
        return found

    def duration(self) -> Duration:
        """Return the time for the arc."""
        found = self._call('duration')
        if not isinstance(found, Duration):
            raise InvalidProblem(f'duration returns {shown(found)}, expected a Duration')
        return found

    def invert(self, y: Outputs, z: Mapping[str, Values]) -> tuple[Values, Values]:
        """Return states and controls, (..., nx) and (..., nu), from outputs of shape (...)."""
        shape = next(iter(y.values()))[0].shape
        found = self._call('invert', y, z)
        if not isinstance(found, tuple | list) or len(found) != 2:
            raise InvalidProblem(
                f'invert returns {shown(found)}, expected a pair: states and controls'
            )
        is_complex = any(np.iscomplexobj(value) for jet in y.values() for value in jet)
        values = []
        for kind, names, part in zip(
            ('state', 'control'), (self.state_names, self.control_names), found, strict=True
        ):
            what = f'what invert returns as {kind}s'
            stacked = self._stacked(part, len(names), what, shape)
            _check_real(what, stacked, is_complex)
            values.append(stacked)
        return values[0], values[1]

    def start(self) -> Array:
        """
        Return the state at which the motion is to begin, (nx,), NaN where that is free.

        It is what `invert` makes of the boundary values at the start.
        """
        y: dict[str, list[Values]] = {}
        for name, output in self.outputs().items():
            given = output.conditions('start')
            orders = range(output.derivatives + 1)
            y[name] = [np.full((1, 1), given.get(order, np.nan)) for order in orders]
        z = {name: np.full((1, 1), float(s.start)) for name, s in self.integrated().items()}
        states, _ = self.invert(y, z)
        return np.asarray(states[0, 0], dtype=float)

    def derivative(self, states: Values, controls: Values) -> Values:
        """Return the rates of all states, (..., nx)."""
        found = self._call('derivative', components(states), components(controls))
        what = 'what derivative returns'
        stacked = self._stacked(found, len(self.state_names), what, states.shape[:-1])
        _check_real(what, stacked, np.iscomplexobj(states) or np.iscomplexobj(controls))
        return stacked

    def slopes(self, y: Outputs, z: Mapping[str, Values], index: Sequence[int]) -> Values:
        """
        Return the rates of the states `index` at one point of the arc, (B, len(index)).

        For the integration, step after step: shapes are not checked again.
        """
        function = 'invert'
        try:
            states, controls = self.formulation.invert(y, z)
            function = 'derivative'
            slopes = self.formulation.derivative(states, controls)
        except TdmError:
            raise
        except Exception as error:  # noqa: B902
            raise self._raised(function, error) from error
        first = next(iter(z.values()))
        found = np.empty((first.shape[0], len(index)), dtype=first.dtype)
        for column, component in enumerate(index):
            found[:, column] = slopes[component]
        return found

    def margins(self, times: Values, states: Values, controls: Values) -> dict[str, Values]:
        """Return what is left to every limit, (B, K) by name."""
        found = self._call('margins', times, components(states), components(controls))
        if not isinstance(found, Mapping):
            raise InvalidProblem(
                f'margins returns {shown(found)}, expected a mapping from names to margins'
            )
        names = list(found)
        if self._margin_names is None:
            if not all(isinstance(name, str) for name in names):
                raise InvalidProblem(f'margins has names {shown(names)}, which must be strings')
            self._margin_names = names
        if names != self._margin_names:
            raise InvalidProblem(
                f'margins names {names}, but named {self._margin_names} before: the limits must '
                'always be the same, in the same order'
            )
        real = _are_real(times, states, controls)
        return {
            name: self._shaped(f"margins gives '{name}'", value, times.shape, real)
            for name, value in found.items()
        }

    def running_cost(self, times: Values, states: Values, controls: Values) -> Values:
        """Return the integrand of J, (B, K)."""
        found = self._call('running_cost', times, components(states), components(controls))
        real = _are_real(times, states, controls)
        return self._shaped('running_cost gives J', found, times.shape, real)

    def final_cost(self, times: Values, states: Values) -> Values:
        """Return the part of J that the end determines, (B,), from (B,) and (B, nx)."""
        found = self._call('final_cost', times, components(states))
        return self._shaped('final_cost gives J', found, times.shape, _are_real(times, states))

    def end_conditions(self, times: Values, states: Values) -> list[Values]:
        """Return what must vanish at the end, (B,) each, from (B,) and (B, nx)."""
        found = self._call('end_conditions', times, components(states))
        if isinstance(found, str | Mapping) or not hasattr(found, '__iter__'):
            raise InvalidProblem(f'end_conditions returns {shown(found)}, expected a sequence')
        real = _are_real(times, states)
        return [
            self._shaped(f'end_conditions gives number {index}', value, times.shape, real)
            for index, value in enumerate(found)
        ]

    def _call(self, function: str, *arguments: Any) -> Any:
        try:
            with np.errstate(all='ignore'):
                return getattr(self.formulation, function)(*arguments)
        except TdmError:
            raise
        except Exception as error:  # noqa: B902
            raise self._raised(function, error) from error

    def _raised(self, function: str, error: Exception) -> InvalidProblem:
        return InvalidProblem(
            f'{function} of {type(self.formulation).__name__} raises '
            f'{type(error).__name__}: {error}'
        )

    def _names(self, kind: str) -> tuple[str, ...]:
        found = getattr(self.formulation, f'{kind}_names', None)
        if isinstance(found, str) or not isinstance(found, tuple | list) or not found:
            raise InvalidProblem(
                f'{kind}_names = {shown(found)} must be a tuple of names, such as '
                + ("('x', 'v')" if kind == 'state' else "('force',)")
            )
        if not all(isinstance(name, str) for name in found):
            raise InvalidProblem(f'{kind}_names = {shown(found)} must be strings')
        if len(set(found)) != len(found):
            raise InvalidProblem(f'{kind}_names = {shown(found)} has the same name twice')
        return tuple(found)

    def _mapping(self, function: str, kind: type) -> dict[str, Any]:
        found = self._call(function)
        if not isinstance(found, Mapping):
            raise InvalidProblem(f'{function} returns {shown(found)}, expected a mapping by name')
        for name, value in found.items():
            if not isinstance(value, kind):
                raise InvalidProblem(
                    f"{function} gives '{name}' = {shown(value)}, expected an {kind.__name__}"
                )
        return dict(found)

    @staticmethod
    def _stacked(values: Any, count: int, what: str, shape: tuple[int, ...]) -> Values:
        stacked = stack(values, count, what)
        try:
            return np.broadcast_to(stacked, (*shape, count))
        except ValueError:
            raise InvalidProblem(
                f'{what} has components of shape {stacked.shape[:-1]}, expected {shape}'
            ) from None

    @staticmethod
    def _shaped(what: str, value: Any, shape: tuple[int, ...], real: bool) -> Values:
        try:
            found = np.asarray(value)
        except ValueError:
            found = np.asarray(None)
        if found.dtype.kind not in 'biufc':
            raise InvalidProblem(f'{what} = {shown(value)}, which is not a number')
        _check_real(what, found, not real)
        try:
            return np.broadcast_to(found, shape)
        except ValueError:
            raise InvalidProblem(
                f'{what} of shape {found.shape}, expected {shape}: one number '
                + ('at every node' if len(shape) == 2 else 'for every candidate')
            ) from None


def _are_real(*values: Values) -> bool:
    return not any(np.iscomplexobj(value) for value in values)


def _check_real(what: str, found: Values, may_be_complex: bool) -> None:
    if np.iscomplexobj(found) and not may_be_complex:
        raise InvalidProblem(f'{what}: complex numbers, though the motion is real')
