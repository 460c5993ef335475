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

"""Checks of what users pass in: numbers, orders of derivatives, ends of an arc."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

HIGHEST_ORDER = 60  # of a derivative
_LARGEST = 1e100  # its cube can still be computed


def shown(value: Any, longest: int = 60) -> str:
    """Return a value as an error message shows it: on one line, not too long."""
    text = ' '.join(repr(value).split())
    return text if len(text) <= longest else text[: longest - 3] + '...'


def number(value: Any, what: str, *, positive: bool = False) -> float:
    """
    Return a finite real number.

    Raises
    ------
    InvalidProblem
        Naming `what`, if the value is not one, or not positive where it must be.

    """
    allowed = 'a positive number' if positive else 'a finite number'
    try:
        found = float(value) if np.ndim(value) == 0 and not isinstance(value, str) else np.nan
    except (TypeError, ValueError, OverflowError):
        found = np.nan
    if not abs(found) <= _LARGEST or (positive and found <= 0):
        raise InvalidProblem(f'{what} = {shown(value)} is not allowed: must be {allowed}')
    return found


def whole(value: Any, what: str, least: int, most: int) -> int:
    """
    Return an integer in [least, most].

    Raises
    ------
    InvalidProblem
        Naming `what`, if the value is not one.

    """
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (is_whole and least <= value <= most):
        raise InvalidProblem(
            f'{what} = {shown(value)} is not allowed: must be an integer from {least} to {most}'
        )
    return int(value)


def real_array(value: Any, what: str) -> Array:
    """
    Return finite real numbers of any shape.

    Raises
    ------
    InvalidProblem
        Naming `what`, if they are not, or not all of one shape.

    """
    try:
        found = np.asarray(value)
        numeric = found.dtype.kind in 'iuf' or (found.size == 0 and found.dtype.kind in 'biuf')
    except ValueError:  # nested sequences of several lengths
        numeric = False
    if not numeric:
        raise InvalidProblem(f'{what} = {shown(value)} must be real numbers')
    found = found.astype(float)
    if not np.isfinite(found).all():
        wrong = found[~np.isfinite(found)][0]
        raise InvalidProblem(f'{what} has an element {wrong}, which is not a finite number')
    return found


def common_shape(values: Iterable[Any], what: str) -> Array:
    """
    Return finite real values, broadcast to one shape and stacked, (m, ...).

    Raises
    ------
    InvalidProblem
        Naming `what`, if they are not, or cannot share a shape.

    """
    arrays = [real_array(value, what) for value in values]
    try:
        return np.array(np.broadcast_arrays(*arrays), dtype=float)
    except ValueError:
        raise InvalidProblem(
            f'{what} must share a shape, but have '
            + ', '.join(sorted({str(array.shape) for array in arrays}))
        ) from None


def check_derivative(order: Any) -> int:
    """
    Return the order of a derivative to be computed.

    Raises
    ------
    InvalidProblem
        If it is not an integer from 0 to 60.

    """
    if type(order) is int and 0 <= order <= HIGHEST_ORDER:
        return order
    return whole(order, 'the order of a derivative', 0, HIGHEST_ORDER)


def check_arc(tau_0: Any, tau_f: Any) -> tuple[float, float]:
    """
    Return the ends of a virtual arc.

    Raises
    ------
    InvalidProblem
        If tau_f <= tau_0, or one of them is not a finite number.

    """
    first, last = number(tau_0, 'tau_0'), number(tau_f, 'tau_f')
    if not last > first:
        raise InvalidProblem(
            f'the virtual arc must end after it starts, but tau_0 = {first:g}, tau_f = {last:g}'
        )
    return first, last


def arc_power(span: float, order: int) -> float:
    """
    Return the length of an arc to the power of a derivative's order.

    Raises
    ------
    InvalidProblem
        If the arc is too long or too short for that derivative to be computed.

    """
    with np.errstate(all='ignore'):
        power = float(np.float64(span) ** order)
    if not 0.0 < power < np.inf:
        raise InvalidProblem(
            f'derivative {order} cannot be computed on a virtual arc of length {span:g}: '
            'tau_f - tau_0 is too many orders of magnitude from 1'
        )
    return power


def scaled_values(values: Array, scales: Array) -> Array:
    """
    Return boundary values by s on the unit interval from those by tau.

    Raises
    ------
    InvalidProblem
        If one of them leaves the range of numbers.

    """
    with np.errstate(all='ignore'):
        found = values * scales
    if not np.isfinite(found).all():
        raise InvalidProblem(
            f'the boundary values, up to {np.abs(values).max():g}, cannot be computed with on a '
            'virtual arc of this length: they are too large'
        )
    return np.asarray(found)


def check_orders(where: str, orders: Iterable[Any]) -> tuple[int, ...]:
    """
    Return the orders of the derivatives given at one end.

    Raises
    ------
    InvalidProblem
        If an order is not an integer from 0 to 60, or repeated.

    """
    what = f'the order of a derivative given at the {where}'
    found = tuple(whole(order, what, 0, HIGHEST_ORDER) for order in orders)
    if len(set(found)) != len(found):
        raise InvalidProblem(
            f'the derivatives given at the {where}, {list(found)}, must be distinct'
        )
    return found


def check_conditions(where: str, given: Any) -> None:
    """
    Check that boundary values at one end are a mapping from order to value.

    Raises
    ------
    InvalidProblem
        If they are not, or an order is not allowed.

    """
    if not hasattr(given, 'keys') or not hasattr(given, 'values'):
        raise InvalidProblem(
            f'the boundary values at the {where}, {shown(given)}, must be a mapping from the '
            'order of the derivative to its value, such as {0: 1.0, 1: 0.0}'
        )
    check_orders(where, given)
