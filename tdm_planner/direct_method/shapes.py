# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Taranenko's shapes Phi of section 2 of Yakimenko (2006): functions that vanish at both ends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.checks import shown, whole
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

_MOST = 100  # terms, and exponents: more cannot be told apart in floating point


class Shapes(ABC):
    """
    Functions phi_k(s) on the unit interval with phi_k(0) = phi_k(1) = 0; Phi = sum A_k phi_k.

    Families can be combined: `SineSeries(3) + symmetric_powers(2)`.
    """

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the number of shapes m."""

    @abstractmethod
    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative of every shape at s (...), (..., m)."""

    def __add__(self, other: Shapes) -> Shapes:
        """Return the shapes of both families."""
        if not isinstance(other, Shapes):
            return NotImplemented
        return CombinedShapes((self, other))


@dataclass(frozen=True)
class CombinedShapes(Shapes):
    """The shapes of several families, one after the other."""

    families: tuple[Shapes, ...]

    @property
    def size(self) -> int:
        """Return the number of shapes."""
        return sum(family.size for family in self.families)

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m)."""
        return np.concatenate([f.values(s, derivative) for f in self.families], axis=-1)


@dataclass(frozen=True)
class SineSeries(Shapes):
    """sin(k pi s), k = 1..`terms`. All even derivatives vanish at the ends."""

    terms: int

    def __post_init__(self) -> None:
        """Check the number of terms."""
        whole(self.terms, 'the number of terms of a sine series', 1, _MOST)

    @property
    def size(self) -> int:
        """Return the number of shapes."""
        return self.terms

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m)."""
        k = np.arange(1, self.terms + 1)
        at = np.asarray(s, dtype=float)[..., None]
        # From the nearer end, so that the values at both ends are exact.
        beyond = at > 0.5
        angle = k * np.pi * np.where(beyond, 1.0 - at, at)
        parity = np.where(beyond, (-1.0) ** k, 1.0)
        wave = np.cos(angle) if derivative % 2 else np.where(beyond, -np.sin(angle), np.sin(angle))
        sign = -1.0 if derivative % 4 in (2, 3) else 1.0
        return np.asarray(sign * (k * np.pi) ** derivative * parity * wave)


@dataclass(frozen=True)
class PowerProducts(Shapes):
    """
    s^m1 (s - 1)^m2 for every pair (m1, m2) of `exponents`, both at least 1.

    In the paper's argument these are (tau - tau_0)^m1 (tau - tau_f)^m2; their coefficients here
    are the paper's times (tau_f - tau_0)^(m1 + m2), in the unit of x.
    """

    exponents: Any  # kept as a tuple of pairs

    def __post_init__(self) -> None:
        """Check the exponents."""
        try:
            pairs = tuple((first, second) for first, second in self.exponents)
        except (TypeError, ValueError):
            pairs = ()
        if not pairs:
            raise InvalidProblem(
                f'exponents = {shown(self.exponents)} must be pairs, such as [(1, 2), (2, 2)]'
            )
        for pair in pairs:
            for exponent in pair:  # at least 1, for the product to vanish at both ends
                whole(exponent, f'an exponent of {shown(pair)}', 1, _MOST)
        object.__setattr__(self, 'exponents', pairs)

    @property
    def size(self) -> int:
        """Return the number of shapes."""
        return len(self.exponents)

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m), by Leibniz' rule."""
        at = np.asarray(s, dtype=float)
        shapes = [product_derivative(at, a, b, derivative) for a, b in self.exponents]
        return np.stack(shapes, axis=-1)


def product_derivative(s: Array, first: int, second: int, derivative: int) -> Array:
    """Return the `derivative`-th derivative of s^first (s - 1)^second, exponents >= 0."""
    total = np.zeros_like(s)
    for j in range(max(0, derivative - second), min(derivative, first) + 1):
        factor = math.comb(derivative, j) * math.perm(first, j) * math.perm(second, derivative - j)
        total = total + factor * s ** (first - j) * (s - 1.0) ** (second - derivative + j)
    return total


def symmetric_powers(terms: int) -> PowerProducts:
    """Return s^k (s - 1)^k, k = 1..`terms`: symmetric about the middle of the arc."""
    count = whole(terms, 'the number of terms of a series of powers', 1, _MOST)
    return PowerProducts(tuple((k, k) for k in range(1, count + 1)))
