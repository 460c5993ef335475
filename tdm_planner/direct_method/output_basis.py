# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Bases of outputs: what their boundary conditions determine, and well scaled free shapes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
import math
from typing import Protocol

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.bases import PolynomialBasis, product_derivative, Shapes
from tdm_planner.direct_method.formulation import Output
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

_DEPENDENT = 1e-9  # share of a shape, or of a condition, that the others leave of it


class ReferenceBasis(Protocol):
    """
    A family of reference functions on the unit interval, split by what determines them.

    x(s) = given(s) @ b + varied(s) @ a, where b holds the derivatives of orders `start` at s = 0,
    then those of orders `end` at s = 1, and a is free: whatever a is, the conditions hold.
    """

    @property
    def start(self) -> tuple[int, ...]:
        """Orders of the derivatives given at s = 0."""

    @property
    def end(self) -> tuple[int, ...]:
        """Orders of the derivatives given at s = 1."""

    def given(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivative at s (...) of the part of every condition, (..., mg)."""

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivative at s (...) of every free shape, (..., mv)."""


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
    The polynomials of `VariedPolynomials` where no lower derivative is omitted at an end.

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
class TaranenkoShapes:
    """
    Functions (1) of Yakimenko (2006): linear interpolation plus shapes Phi.

    Derivatives that are given at the ends fix some combinations of the coefficients A_k
    (`by_given` (m, mg) @ b), the others (`free` (m, mv) @ a) are varied.
    """

    shapes: Shapes
    start: tuple[int, ...]
    end: tuple[int, ...]
    by_given: Array
    free: Array

    @classmethod
    def of(cls, shapes: Shapes, start: tuple[int, ...], end: tuple[int, ...]) -> TaranenkoShapes:
        """
        Return the basis for derivatives of these orders at the ends.

        Raises
        ------
        InvalidProblem
            If the value itself is missing at an end, or the shapes cannot meet the conditions.

        """
        for where, orders in (('start', start), ('end', end)):
            if 0 not in orders:
                raise InvalidProblem(
                    f'the value at the {where} is missing: shapes are added to a line between '
                    'both ends'
                )
        count = len(start) + len(end)
        plain = cls(shapes, start, end, np.zeros((shapes.size, count)), np.eye(shapes.size))
        slopes = [(i, 0.0, k) for i, k in enumerate(start) if k]
        slopes += [(len(start) + i, 1.0, k) for i, k in enumerate(end) if k]
        # Rows of different orders are made comparable.
        rows = [shapes.values(at, order) / np.pi**order for _, at, order in slopes]
        missing = [(np.eye(count)[i] - plain.given(at, k)) / np.pi**k for i, at, k in slopes]
        matrix = np.array(rows).reshape(len(slopes), shapes.size)
        wanted = np.array(missing).reshape(len(slopes), count)
        by_given = np.linalg.pinv(matrix, rcond=_DEPENDENT) @ wanted
        if np.abs(matrix @ by_given - wanted).max(initial=0.0) > _DEPENDENT:
            raise InvalidProblem(
                f'{shapes.size} shapes cannot meet derivatives {list(start)} at the start and '
                f'{list(end)} at the end; take more, or others'
            )
        _, sizes, directions = np.linalg.svd(matrix)
        rank = int((sizes > _DEPENDENT * sizes.max(initial=0.0)).sum())
        return cls(shapes, start, end, by_given, directions[rank:].T)

    def given(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the part of every condition, (..., mg)."""
        at = np.asarray(s, dtype=float)
        line = np.zeros((*at.shape, len(self.start) + len(self.end)))
        if derivative < 2:
            line[..., self.start.index(0)] = -1.0 if derivative else 1.0 - at
            line[..., len(self.start) + self.end.index(0)] = 1.0 if derivative else at
        return np.asarray(line + self.shapes.values(at, derivative) @ self.by_given)

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return every free combination of shapes, (..., mv)."""
        return np.asarray(self.shapes.values(s, derivative) @ self.free)


@dataclass(frozen=True, eq=False)
class OrthonormalBasis:
    """A basis with orthonormal free shapes, by default in the mean of f g + f'' g''."""

    basis: ReferenceBasis
    transformation: Array

    @classmethod
    def of(cls, basis: ReferenceBasis, derivatives: tuple[int, ...] = (0, 2)) -> OrthonormalBasis:
        """
        Make the free shapes orthonormal in the mean of these derivatives' products.

        Raises
        ------
        InvalidProblem
            If they depend on one another.

        """
        count = len(basis.start) + len(basis.end) + basis.varied(0.0).size
        points, weights = np.polynomial.legendre.leggauss(max(64, count + 8))
        root = np.sqrt(weights / 2.0)[:, None]
        at = (points + 1.0) / 2.0
        sampled = np.concatenate([root * basis.varied(at, k) for k in derivatives])
        sizes = np.linalg.norm(sampled, axis=0)
        _, triangle = np.linalg.qr(sampled / sizes)
        if np.abs(np.diag(triangle)).min(initial=1.0) < 1e-3 * _DEPENDENT:
            raise InvalidProblem('some shapes are sums of others: take fewer, or others')
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
    if shapes is not None:
        return OrthonormalBasis.of(TaranenkoShapes.of(shapes, start, end))
    complete = all(sorted(orders) == list(range(len(orders))) for orders in (start, end))
    if free and complete:
        return OrthonormalBasis.of(LegendrePolynomials(start, end, free))
    return OrthonormalBasis.of(VariedPolynomials.of(start, end, free))
