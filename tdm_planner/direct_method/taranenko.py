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
Taranenko's reference functions, (1) of Yakimenko (2006): linear interpolation plus Phi.

Derivatives prescribed at the ends fix as many coefficients A_k of Phi, by default the first ones
that can; the others are varied.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.checks import (
    arc_power,
    check_arc,
    check_conditions,
    check_derivative,
    check_orders,
    common_shape,
    real_array,
    scaled_values,
    shown,
)
from tdm_planner.direct_method.shapes import Shapes
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

_DEPENDENT = 1e-9  # share of a column left of it by projection, below which it adds nothing
_CONTRADICTION = 1e-9


@dataclass(frozen=True, eq=False)
class TaranenkoBasis:
    """
    Linear interpolation and shapes on the unit interval, solved for the end conditions.

    `fixed` (c,) and `free` (m - c,) are the indices of the coefficients that the conditions
    determine and of those that are left; A_fixed = `by_given` @ b + `by_free` @ A_free, with the
    boundary values b as in `ReferenceBasis`. `remainder` @ b is what no coefficient can meet: it
    must vanish.
    """

    shapes: Shapes
    start: tuple[int, ...]
    end: tuple[int, ...]
    fixed: tuple[int, ...]
    free: tuple[int, ...]
    by_given: Array
    by_free: Array
    remainder: Array

    @classmethod
    def of(cls, shapes: Shapes, start: tuple[int, ...], end: tuple[int, ...]) -> TaranenkoBasis:
        """
        Return the basis for derivatives of these orders at the ends (cached).

        Raises
        ------
        InvalidProblem
            If an order is repeated or negative, or the value itself is missing at an end.

        """
        if not isinstance(shapes, Shapes):
            raise InvalidProblem(
                f'{shown(shapes)} is not a family of shapes, such as SineSeries(3)'
            )
        return _basis(shapes, check_orders('start', start), check_orders('end', end))

    @property
    def unconditional(self) -> bool:
        """Whether the conditions can be met whatever their values."""
        return not self.remainder.any()

    def given(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivative at s (...) of the part of every condition, (..., mg)."""
        at = np.asarray(s, dtype=float)
        line = _line(at, derivative, self.start, self.end)
        fixed = self.shapes.values(at, derivative)[..., list(self.fixed)]
        return np.asarray(line + fixed @ self.by_given)

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivative at s (...) by every free coefficient, (..., mv)."""
        values = self.shapes.values(s, derivative)
        return np.asarray(
            values[..., list(self.free)] + values[..., list(self.fixed)] @ self.by_free
        )


def _line(s: Array, derivative: int, start: tuple[int, ...], end: tuple[int, ...]) -> Array:
    """Linear interpolation by every boundary value, (..., mg)."""
    line = np.zeros((*s.shape, len(start) + len(end)))
    if derivative < 2:
        line[..., start.index(0)] = 1.0 - s if derivative == 0 else -1.0
        line[..., len(start) + end.index(0)] = s if derivative == 0 else 1.0
    return line


@lru_cache(maxsize=128)
def _basis(shapes: Shapes, start: tuple[int, ...], end: tuple[int, ...]) -> TaranenkoBasis:
    for where, orders in (('start', start), ('end', end)):
        if 0 not in orders:
            raise InvalidProblem(
                f'the value at the {where} is missing: linear interpolation (1) needs both ends'
            )
    rows, wanted = [], []
    for at, orders, offset in ((0.0, start, 0), (1.0, end, len(start))):
        for index, order in enumerate(orders):
            if order > 0:
                scale = np.pi**order  # keeps rows of different orders comparable
                rows.append(shapes.values(at, order) / scale)
                unit = np.zeros(len(start) + len(end))
                unit[offset + index] = 1.0
                wanted.append((unit - _line(np.asarray(at), order, start, end)) / scale)
    matrix = np.array(rows).reshape(len(rows), shapes.size)
    right = np.array(wanted).reshape(len(rows), len(start) + len(end))
    fixed = _independent(matrix)
    free = [k for k in range(shapes.size) if k not in fixed]
    inverse = np.linalg.pinv(matrix[:, fixed]) if fixed else np.zeros((0, len(rows)))
    remainder = right - matrix[:, fixed] @ (inverse @ right)
    remainder[np.abs(remainder) < _CONTRADICTION] = 0.0
    by_free = -inverse @ matrix[:, free]
    return TaranenkoBasis(
        shapes, start, end, tuple(fixed), tuple(free), inverse @ right, by_free, remainder
    )


def _independent(matrix: Array) -> list[int]:
    """Return the first columns, from the left, that span all of them."""
    chosen: list[int] = []
    directions = np.zeros((matrix.shape[0], 0))
    for index, column in enumerate(matrix.T):
        rest = column - directions @ (directions.T @ column)
        rest = rest - directions @ (directions.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > _DEPENDENT * max(float(np.linalg.norm(column)), 1e-300):
            chosen.append(index)
            directions = np.column_stack([directions, rest / size])
        if len(chosen) == matrix.shape[0]:
            break
    return chosen


class TaranenkoReference:
    """
    A reference function (1) on [tau_0, tau_f]: linear interpolation plus shapes.

    `start` and `end` map the order of a derivative d^k x / d tau^k to its value at tau_0 and at
    tau_f, order 0 among them; a value is a number or an array (...,), the same shape for all.
    `varied` (mv, ...) are the coefficients A_k that the conditions leave free, zero unless given;
    `varied_indices` says which.

    Beyond the ends of the arc the function goes on as it is, and can be evaluated there.

    Raises
    ------
    InvalidProblem
        If tau_f <= tau_0, a condition is missing or not finite, there are too few shapes for the
        conditions or the shapes cannot meet them, or `varied` has the wrong shape.

    """

    def __init__(
        self,
        shapes: Shapes,
        start: Mapping[int, ArrayLike],
        end: Mapping[int, ArrayLike],
        tau_f: float,
        tau_0: float = 0.0,
        varied: ArrayLike | None = None,
    ) -> None:
        self.tau_0, self.tau_f = check_arc(tau_0, tau_f)
        for where, given in (('start', start), ('end', end)):
            check_conditions(where, given)
        self.basis = TaranenkoBasis.of(shapes, tuple(start), tuple(end))
        values = common_shape([*start.values(), *end.values()], 'the boundary values')
        self._span = self.tau_f - self.tau_0
        scales = np.array([arc_power(self._span, k) for k in (*start, *end)])
        self._given = scaled_values(values, scales.reshape(-1, *(1,) * (values.ndim - 1)))
        self._check_conditions()
        self.varied = self._checked(varied)

    @property
    def varied_indices(self) -> tuple[int, ...]:
        """Return the indices k of the coefficients A_(k+1) that are varied."""
        return self.basis.free

    def with_varied(self, varied: ArrayLike) -> TaranenkoReference:
        """Return the function with other varied coefficients, (mv, ...)."""
        other = object.__new__(TaranenkoReference)
        other.__dict__.update(self.__dict__)
        other.varied = self._checked(varied)
        return other

    def __call__(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the `order`-th derivative at tau (n...,): shape (n..., value shape)."""
        s, order = self._unit(tau), check_derivative(order)
        value = np.tensordot(self.basis.given(s, order), self._given, axes=(-1, 0))
        value = value + np.tensordot(self.basis.varied(s, order), self.varied, axes=(-1, 0))
        return np.asarray(value / arc_power(self._span, order))

    def jacobian(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the derivative of `x(tau, order)` by the varied coefficients, (n..., mv)."""
        order = check_derivative(order)
        shapes = self.basis.varied(self._unit(tau), order)
        return np.asarray(shapes / arc_power(self._span, order))

    def _unit(self, tau: ArrayLike) -> Array:
        return (real_array(tau, 'tau') - self.tau_0) / self._span

    def _check_conditions(self) -> None:
        basis = self.basis
        unmet = np.tensordot(basis.remainder, self._given, axes=(-1, 0))
        size = np.abs(self._given).max(initial=0.0)
        if np.abs(unmet).max(initial=0.0) <= 1e-9 * size:
            return
        conditions = len(basis.start) + len(basis.end) - 2
        if basis.shapes.size < conditions:
            raise InvalidProblem(
                f'{conditions} derivatives are given at the ends, but there are only '
                f'{basis.shapes.size} shapes to meet them with'
            )
        raise InvalidProblem(
            f'derivatives {list(basis.start)} at the start and {list(basis.end)} at the end '
            'contradict each other for these shapes: no coefficients give them all'
        )

    def _checked(self, varied: ArrayLike | None) -> Array:
        shape = (len(self.basis.free), *self._given.shape[1:])
        values = np.zeros(shape) if varied is None else real_array(varied, 'a varied coefficient')
        if values.shape != shape:
            raise InvalidProblem(
                f'the varied coefficients have shape {values.shape}, expected {shape}'
            )
        return values
