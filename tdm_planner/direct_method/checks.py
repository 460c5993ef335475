# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Checks of what users pass in: numbers, orders of derivatives, ends of an arc."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from tdm_planner.exceptions import InvalidProblem

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
