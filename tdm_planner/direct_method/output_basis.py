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

"""Bases of outputs: what their boundary conditions determine, and well scaled free shapes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
import math

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.formulation import Output
from tdm_planner.direct_method.polynomial import PolynomialBasis
from tdm_planner.direct_method.reference_function import ReferenceBasis
from tdm_planner.direct_method.shapes import product_derivative, Shapes
from tdm_planner.direct_method.taranenko import TaranenkoBasis
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VariedPolynomials:
    """
    Polynomials with some end derivatives given and `free` further ones varied.

    The further derivatives are the lowest that are not given, alternately at the start and at
    the end; which they are does not matter for the set of polynomials that results.
    """

    start: tuple[int, ...]
    end: tuple[int, ...]
    basis: PolynomialBasis

    @classmethod
    def of(cls, start: tuple[int, ...], end: tuple[int, ...], free: int) -> VariedPolynomials:
        """Return the basis; `free` >= 0."""
        ends: tuple[list[int], list[int]] = (list(start), list(end))
        for _ in range(free):
            lowest = [min(set(range(len(o) + 1)) - set(o)) for o in ends]
            side = 0 if lowest[0] <= lowest[1] else 1
            ends[side].append(lowest[side])
        return cls(start, end, PolynomialBasis.of(tuple(ends[0]), tuple(ends[1])))

    def given(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the part of every condition, (..., mg)."""
        return self._values(s, derivative)[0]

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return every free shape, (..., mv)."""
        return self._values(s, derivative)[1]

    def _values(self, s: ArrayLike, derivative: int) -> tuple[Array, Array]:
        values = self.basis.values(s, derivative)
        at_start, split = len(self.start), len(self.basis.start)
        at_end = split + len(self.end)
        given = [values[..., :at_start], values[..., split:at_end]]
        free = [values[..., at_start:split], values[..., at_end:]]
        return np.concatenate(given, axis=-1), np.concatenate(free, axis=-1)


@dataclass(frozen=True, eq=False)
class LegendrePolynomials:
    """
    The polynomials of `VariedPolynomials` where no lower derivative is left out at an end.

    The free shapes are s^a (s - 1)^b P_j(2 s - 1), j < `free`, with a and b the numbers of
    conditions: well conditioned whatever the order, where end derivatives of high order are not.
    """

    start: tuple[int, ...]
    end: tuple[int, ...]
    free: int

    def given(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the part of every condition, (..., mg)."""
        if not self.start and not self.end:
            return np.zeros((*np.shape(s), 0))
        return PolynomialBasis.of(self.start, self.end).values(s, derivative)

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return every free shape, (..., mv)."""
        at = np.asarray(s, dtype=float)
        total = np.zeros((*at.shape, self.free))
        for k in range(min(derivative, self.free - 1) + 1):
            weight = product_derivative(at, len(self.start), len(self.end), derivative - k)
            coefficients = legendre.legder(np.eye(self.free), k, scl=2.0)
            factors = legendre.legvander(2.0 * at - 1.0, self.free - k - 1) @ coefficients
            factors = factors.reshape(total.shape)  # numpy makes scalars vectors
            total += math.comb(derivative, k) * weight[..., None] * factors
        return total


@dataclass(frozen=True, eq=False)
class OrthonormalBasis:
    """A basis with orthonormal free shapes, by default in the mean of f g + f'' g''."""

    basis: ReferenceBasis
    transformation: Array

    @classmethod
    def of(cls, basis: ReferenceBasis, derivatives: tuple[int, ...] = (0, 2)) -> OrthonormalBasis:
        """Make the free shapes orthonormal in the mean of these derivatives' products."""
        count = len(basis.start) + len(basis.end) + basis.varied(0.0).size
        points, weights = np.polynomial.legendre.leggauss(max(64, count + 8))
        root = np.sqrt(weights / 2.0)[:, None]
        at = (points + 1.0) / 2.0
        sampled = np.concatenate([root * basis.varied(at, k) for k in derivatives])
        sizes = np.linalg.norm(sampled, axis=0)
        _, triangle = np.linalg.qr(sampled / sizes)
        return cls(basis, np.linalg.inv(triangle) / sizes[:, None])

    @property
    def start(self) -> tuple[int, ...]:
        """Orders of the derivatives given at s = 0."""
        return self.basis.start

    @property
    def end(self) -> tuple[int, ...]:
        """Orders of the derivatives given at s = 1."""
        return self.basis.end

    @property
    def size(self) -> int:
        """Return the number of free shapes."""
        return int(self.transformation.shape[0])

    def given(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the part of every condition, (..., mg)."""
        return self.basis.given(s, derivative)

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return every free shape, (..., mv)."""
        return np.asarray(self.basis.varied(s, derivative) @ self.transformation)


def output_basis(name: str, output: Output, speed_factor_order: int) -> OrthonormalBasis:
    """
    Return the basis of an output.

    Raises
    ------
    InvalidProblem
        Naming the output, if its conditions contradict each other, leave no
        function, or cannot be converted to the virtual arc.

    """
    start, end = output.conditions('start'), output.conditions('end')
    for where, given in (('start', start), ('end', end)):
        positive = [order for order in given if order > 0]
        if speed_factor_order and positive and set(positive) != set(range(1, max(positive) + 1)):
            raise InvalidProblem(
                f"output '{name}' has derivatives {sorted(given)} given at the {where}: with a "
                'speed factor all lower ones must be given too'
            )
    try:
        return _orthonormal(output.shapes, tuple(start), tuple(end), output.free)
    except InvalidProblem as error:
        raise InvalidProblem(f"output '{name}': {error}") from None


@lru_cache(maxsize=64)
def _orthonormal(
    shapes: Shapes | None, start: tuple[int, ...], end: tuple[int, ...], free: int
) -> OrthonormalBasis:
    if shapes is None:
        return OrthonormalBasis.of(_polynomials(start, end, free))
    return OrthonormalBasis.of(_taranenko(shapes, start, end))


def _polynomials(start: tuple[int, ...], end: tuple[int, ...], free: int) -> ReferenceBasis:
    complete = all(sorted(orders) == list(range(len(orders))) for orders in (start, end))
    if free and complete:
        return LegendrePolynomials(start, end, free)
    return VariedPolynomials.of(start, end, free)


def _taranenko(shapes: Shapes, start: tuple[int, ...], end: tuple[int, ...]) -> TaranenkoBasis:
    basis = TaranenkoBasis.of(shapes, start, end)
    if not basis.unconditional:
        raise InvalidProblem(
            f'{shapes.size} shapes cannot meet derivatives {list(start)} at the start and '
            f'{list(end)} at the end; take more, or others'
        )
    return basis
