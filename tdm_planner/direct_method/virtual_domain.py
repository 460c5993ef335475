# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Derivatives by time from derivatives along the virtual arc, and back, exactly.

With the speed factor lambda = dtau/dt, d/dt = lambda d/dtau, so that

    x. = lambda x',   x.. = lambda^2 x'' + lambda lambda' x',   and so on to any order.

Yakimenko (2006) has only the first terms ((20)-(22) leave out lambda'). The maps are linear in
the derivatives of x and triangular, which is what makes the way back exact. All functions accept
whatever can be multiplied and added: numbers, arrays, symbols.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any


def time_derivatives(jet: Sequence[Any], factor: Sequence[Any]) -> list[Any]:
    """
    Return x, x., x.., ... from x, x', x'', ... and lambda, lambda', ...

    As many as `jet` has; one element less of `factor` is needed.
    """
    found, left = [jet[0]], list(jet)
    while len(left) > 1:
        left = _product(factor, left[1:])
        found.append(left[0])
    return found


def arc_derivatives(wanted: Sequence[Any], factor: Sequence[Any]) -> list[Any]:
    """Return x, x', x'', ... from x, x., x.., ... and lambda, lambda', ...: the way back."""
    found = [wanted[0]]
    for order in range(1, len(wanted)):
        lower = time_derivatives([*found, 0.0 * found[0]], factor[:order])[-1]
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


def _product(first: Sequence[Any], second: Sequence[Any]) -> list[Any]:
    """Return the derivatives of a product, as many as the shorter factor has (Leibniz' rule)."""
    count = min(len(first), len(second))
    return [
        sum(math.comb(n, j) * first[j] * second[n - j] for j in range(n + 1)) for n in range(count)
    ]
