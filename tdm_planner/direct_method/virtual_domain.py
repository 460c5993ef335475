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
Derivatives by time from derivatives along the virtual arc, and back, exactly.

With the speed factor lambda = dtau/dt, d/dt = lambda d/dtau, so that

    x. = lambda x',   x.. = lambda^2 x'' + lambda lambda' x',   and so on to any order.

Yakimenko (2006) has only the first terms ((20)-(22) leave out lambda'). The maps are linear in
the derivatives of x and triangular, which is what makes the way back exact. All functions accept
arrays of any (common) shape.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.checks import shown
from tdm_planner.exceptions import InvalidProblem

Values = NDArray[Any]


def time_derivatives(derivatives: Sequence[ArrayLike], speed: Sequence[ArrayLike]) -> list[Values]:
    """
    Return x, x., x.., ... from x, x', x'', ... and lambda, lambda', ...

    As many as `derivatives` has; one element less of `speed` is needed.

    Raises
    ------
    InvalidProblem
        If a number is not finite, `speed` has too few derivatives or is not positive, or shapes do
        not match.

    """
    return [np.asarray(v) for v in candidate_time_derivatives(*_checked(derivatives, speed))]


def candidate_time_derivatives(jet: Sequence[Any], factor: Sequence[Any]) -> list[Any]:
    """Do the same unchecked, for anything that can be multiplied and added: arrays, symbols."""
    found, left = [jet[0]], list(jet)
    while len(left) > 1:
        left = _product(factor, left[1:])
        found.append(left[0])
    return found


def arc_derivatives(derivatives: Sequence[ArrayLike], speed: Sequence[ArrayLike]) -> list[Values]:
    """
    Return x, x', x'', ... from x, x., x.., ... and lambda, lambda', ...: the way back.

    Raises
    ------
    InvalidProblem
        If a number is not finite, `speed` has too few derivatives or is not positive, or shapes do
        not match.

    """
    return [np.asarray(v) for v in candidate_arc_derivatives(*_checked(derivatives, speed))]


def candidate_arc_derivatives(wanted: Sequence[Any], factor: Sequence[Any]) -> list[Any]:
    """Do the same unchecked, for anything that can be multiplied and added: arrays, symbols."""
    found = [wanted[0]]
    for order in range(1, len(wanted)):
        lower = candidate_time_derivatives([*found, 0.0 * found[0]], factor[:order])[-1]
        found.append((wanted[order] - lower) / factor[0] ** order)
    return found


def reciprocal(jet: Sequence[Any]) -> list[Any]:
    """Return 1/f and its derivatives from f and its derivatives: lambda from dt/dtau."""
    found = [1.0 / jet[0]]
    for order in range(1, len(jet)):
        terms: Any = sum(
            math.comb(order, j) * jet[j] * found[order - j] for j in range(1, order + 1)
        )
        found.append(-terms / jet[0])
    return found


def _jets(
    derivatives: Sequence[ArrayLike], speed: Sequence[ArrayLike], size: int | None = None
) -> tuple[list[Values], list[Values]]:
    """Return both as arrays, `size` of the speed factor, by default one less."""
    jet = _numbers(derivatives, 'the derivatives')
    if not jet:
        raise InvalidProblem('no derivatives are given: at least the value itself is needed')
    size = len(jet) - 1 if size is None else size
    factor = _numbers(speed, 'the speed factor and its derivatives')
    if len(factor) < size:
        raise InvalidProblem(
            f'{size} time derivatives need the speed factor and {size - 1} of its derivatives, '
            f'but only {len(factor)} are given'
        )
    factor = factor[:size]
    if factor and not (factor[0].real > 0).all():
        wrong = factor[0].real[~(factor[0].real > 0)].flat[0]
        raise InvalidProblem(
            f'the speed factor is {wrong:g} somewhere: it must be positive, for time to run '
            'forward'
        )
    try:
        np.broadcast_shapes(*(value.shape for value in [*jet, *factor]))
    except ValueError:
        shapes = ', '.join(sorted({str(value.shape) for value in [*jet, *factor]}))
        raise InvalidProblem(
            f'derivatives and speed factor must share a shape, but have {shapes}'
        ) from None
    return jet, factor


def _checked(
    derivatives: Sequence[ArrayLike], speed: Sequence[ArrayLike]
) -> tuple[list[Values], list[Values]]:
    both = _jets(derivatives, speed)
    for values, of in zip(both, ('', ' of the speed factor'), strict=True):
        for order, value in enumerate(values):
            if not np.isfinite(value).all():
                wrong = value[~np.isfinite(value)].flat[0]
                raise InvalidProblem(f'derivative {order}{of} is {wrong}, not a finite number')
    return both


def _numbers(values: Sequence[ArrayLike], what: str) -> list[Values]:
    try:
        found = [np.asarray(value) for value in values]
    except (TypeError, ValueError):
        found = [np.asarray(None)]
    if any(value.dtype.kind not in 'iufc' for value in found):
        raise InvalidProblem(f'{what}, {shown(values)}, must be a sequence of numbers or arrays')
    return found


def _product(first: Sequence[Any], second: Sequence[Any]) -> list[Any]:
    """Return the derivatives of a product, as many as the shorter factor has (Leibniz' rule)."""
    count = min(len(first), len(second))
    return [
        sum(math.comb(n, j) * first[j] * second[n - j] for j in range(n + 1)) for n in range(count)
    ]
