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
The integral of 1/p of a positive Bernstein polynomial p: time from the speed factor.

Where p nearly vanishes 1/p varies over as many orders of magnitude as p does. The interval is
halved until, on every panel, p varies little and the Gauss-Legendre quadrature of the panel agrees
with that of its halves. Panels have Bernstein coefficients of their own, by de Casteljau's
subdivision, in which only positive numbers are added: however small p is, it is known to the last
bits, and panels may be as narrow as they must.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bernstein import bernstein_basis
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

_POINTS = 20  # of the Gauss-Legendre quadrature on a panel
_SPREAD = 8.0  # largest ratio of the coefficients on a panel
_AGREEMENT = 1e-13  # relative, of a panel's quadrature with that of its halves
_MOST_PANELS = 5000


@dataclass(frozen=True, eq=False)
class ReciprocalIntegral:
    """
    Integrals of 1/p from 0, p(s) = sum_i c_i B_i(s) with positive `coefficients` (n,).

    The relative error is some 1e-13.

    Raises
    ------
    InvalidProblem
        If the integral cannot be computed: the coefficients lie too far apart.

    """

    coefficients: Array

    @cached_property
    def total(self) -> float:
        """Return the integral from 0 to 1."""
        return float(self._panels.before[-1])

    def to(self, s: Array, rest: Array) -> Array:
        """Return the integral from 0 to s (...), where `rest` = 1 - s, to its own last bits."""
        panels = self._panels
        early = s <= 0.5
        index = np.where(
            early,
            np.searchsorted(panels.start, s, side='right') - 1,
            np.searchsorted(-panels.rest, -rest, side='right') - 1,
        )
        index = np.clip(index, 0, panels.width.size - 1)
        inside = np.where(early, s - panels.start[index], panels.rest[index] - rest)
        share = np.clip(inside / panels.width[index], 0.0, 1.0)
        points, weights = _gauss()
        basis = bernstein_basis(self.coefficients.size - 1, share[..., None] * points)
        values = np.einsum('...pi,...i->...p', basis, panels.coefficients[index])
        return np.asarray(
            panels.before[index] + panels.width[index] * share * ((1.0 / values) @ weights)
        )

    @cached_property
    def _panels(self) -> _Panels:
        left, right = _halving(self.coefficients.size - 1)
        found: list[tuple[float, float, float, float, Array]] = []
        # Start, distance of the start from the end, width, coefficients: each exact.
        waiting = [
            (0.5, 0.5, 0.5, right @ self.coefficients),
            (0.0, 1.0, 0.5, left @ self.coefficients),
        ]
        with np.errstate(all='ignore'):
            while waiting:
                start, rest, width, c = waiting.pop()
                halves = left @ c, right @ c
                whole, half = _mean(c), 0.5 * sum(_mean(part) for part in halves)
                if c.max() <= _SPREAD * c.min() and abs(whole - half) <= _AGREEMENT * half:
                    found.append((start, rest, width, width * half, c))
                    continue
                width *= 0.5
                if len(found) + len(waiting) > _MOST_PANELS or width == 0.0:
                    raise self._beyond_reach()
                waiting.append((start + width, rest - width, width, halves[1]))
                waiting.append((start, rest, width, halves[0]))
            before = np.cumsum([0.0, *(panel[3] for panel in found)])
        if not math.isfinite(before[-1]):
            raise self._beyond_reach()
        starts, rests, widths = (np.array([panel[i] for panel in found]) for i in range(3))
        return _Panels(starts, rests, widths, before, np.array([panel[4] for panel in found]))

    def _beyond_reach(self) -> InvalidProblem:
        return InvalidProblem(
            f'the coefficients of the speed factor, from {self.coefficients.min():g} to '
            f'{self.coefficients.max():g}, cannot be computed with: the time is not finite, or '
            'they lie too many orders of magnitude apart'
        )


@dataclass(frozen=True, eq=False)
class _Panels:
    """Panels in order: start (n,), 1 - start, width, integral before (n + 1,), coefficients."""

    start: Array
    rest: Array
    width: Array
    before: Array
    coefficients: Array


@lru_cache(maxsize=1)
def _gauss() -> tuple[Array, Array]:
    """Points and weights of the quadrature on the unit interval."""
    points, weights = np.polynomial.legendre.leggauss(_POINTS)
    return 0.5 * (points + 1.0), 0.5 * weights


def _mean(coefficients: Array) -> float:
    """Mean of 1/p over the unit interval."""
    points, weights = _gauss()
    values = bernstein_basis(coefficients.size - 1, points) @ coefficients
    return float((1.0 / values) @ weights)


def _halving(degree: int) -> tuple[Array, Array]:
    """Matrices that give the coefficients on both halves of the interval."""
    left = np.array(
        [[math.comb(k, i) / 2.0**k for i in range(degree + 1)] for k in range(degree + 1)]
    )
    return left, left[::-1, ::-1]
