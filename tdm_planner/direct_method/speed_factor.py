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
The speed factor lambda(tau) = dtau/dt > 0 as a reference function of its own.

It gives the speed along a path back its freedom, (5) of Yakimenko (2006). Two forms: `SpeedFactor`
has lambda as a Bernstein polynomial and time by quadrature; `TimeFactor` has mu = dt/ds as one,
and time exactly. Bernstein polynomials with positive coefficients are positive a priori.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.bernstein import bernstein_basis, bernstein_integral
from tdm_planner.direct_method.checks import check_arc, check_derivative, real_array
from tdm_planner.direct_method.reciprocal_integral import ReciprocalIntegral
from tdm_planner.direct_method.virtual_domain import reciprocal
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

_NEWTON_STEPS = 6  # of the inversion of t(tau), which mostly are enough
_MOST_STEPS = 186  # of which 60 halve the bracket
_ROUNDING = 1e-9  # of the arc's length, by which an argument may lie outside


def invert_time(
    time: Callable[[Array], Array],
    speed_factor: Callable[[Array], Array],
    wanted: Array,
    duration: Array | float,
    ends: tuple[float, float] = (0.0, 1.0),
) -> Array:
    """
    Return tau (...) in `ends` at which `time(tau)` is `wanted` (...) s, for many arcs at once.

    `time` runs from 0 at the first end to `duration` at the second; `speed_factor` is dtau/dt.
    Times beyond the arc are clipped to it.
    """
    wanted = np.clip(wanted, 0.0, duration)
    low, high = np.full(wanted.shape, ends[0]), np.full(wanted.shape, ends[1])
    tau = ends[0] + (ends[1] - ends[0]) * wanted / duration
    for step in range(_MOST_STEPS):
        error = time(tau) - wanted
        found = np.abs(error) <= 1e-14 * duration
        if found.all():
            break
        low, high = np.where(error < 0, tau, low), np.where(error < 0, high, tau)
        newton, middle = tau - error * speed_factor(tau), 0.5 * (low + high)
        # Later every third step halves the bracket: Newton's alone can be arbitrarily short.
        inside = (newton >= low) & (newton <= high) & (step < _NEWTON_STEPS or step % 3 < 2)
        tau = np.where(found, tau, np.where(inside, newton, middle))
    return np.asarray(tau)


class ArcTime(ABC):
    """
    Relation of time t and virtual arc tau in [tau_0, tau_f], t(tau_0) = 0.

    There is no lambda beyond the ends of the arc: it would not stay positive. An argument outside
    is refused, unless by rounding.

    Raises
    ------
    InvalidProblem
        If tau_f <= tau_0, a coefficient is not a positive number, or an argument tau lies outside
        [tau_0, tau_f].

    """

    def __init__(self, coefficients: ArrayLike, tau_f: float, tau_0: float = 0.0) -> None:
        self.tau_0, self.tau_f = check_arc(tau_0, tau_f)
        values = np.atleast_1d(
            real_array(coefficients, 'a coefficient of the speed factor')
        ).copy()
        if values.ndim != 1 or values.size == 0:
            raise InvalidProblem(
                f'the coefficients of a speed factor have shape {values.shape}, expected (n,)'
            )
        if not (values > 0).all():
            worst = int(np.argmin(values))
            raise InvalidProblem(
                f'coefficient {worst} of the speed factor is {values[worst]:g}: all must be '
                'positive, for time to run forward'
            )
        values.flags.writeable = False
        self.coefficients = values

    @property
    def degree(self) -> int:
        """Degree of the Bernstein polynomial."""
        return self.coefficients.size - 1

    @property
    def duration(self) -> float:
        """Time for the whole arc [s]."""
        return float(self.time(self.tau_f))

    @abstractmethod
    def __call__(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the `order`-th derivative of lambda by tau, at tau (...)."""

    @abstractmethod
    def jacobian(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the derivative of `lambda(tau, order)` by the coefficients, (..., n)."""

    @abstractmethod
    def time(self, tau: ArrayLike) -> Array:
        """Return the time [s] at which tau (...) is reached."""

    def derivatives(self, tau: ArrayLike, count: int) -> list[Array]:
        """Return lambda, lambda', ..., `count` of them, as `virtual_domain` takes them."""
        return [self(tau, order) for order in range(count)]

    def arc_at(self, time: ArrayLike) -> Array:
        """Return tau (...) at the time(s) [s], clipped to the arc: the inverse of `time`."""
        wanted = real_array(time, 'the time')
        return invert_time(self.time, self, wanted, self.duration, (self.tau_0, self.tau_f))

    def _unit(self, tau: ArrayLike) -> Array:
        return self._places(tau)[0]

    def _places(self, tau: ArrayLike) -> tuple[Array, Array]:
        """Return the shares of the arc before and after tau (...), each to its last bits."""
        at, span = real_array(tau, 'tau'), self.tau_f - self.tau_0
        before, after = (at - self.tau_0) / span, (self.tau_f - at) / span
        outside = np.minimum(before, after) < -_ROUNDING
        if outside.any():
            raise InvalidProblem(
                f'tau = {at[outside].flat[0]:g} is not allowed: must be in '
                f'[{self.tau_0:g}, {self.tau_f:g}], the arc of the speed factor'
            )
        return np.clip(before, 0.0, 1.0), np.clip(after, 0.0, 1.0)


class SpeedFactor(ArcTime):
    """lambda(tau) = sum_i c_i B_i(s), s = (tau - tau_0)/(tau_f - tau_0); all c_i > 0."""

    def __call__(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the `order`-th derivative of lambda by tau, at tau (...)."""
        return np.asarray(self.jacobian(tau, order) @ self.coefficients)

    def jacobian(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the derivative of `lambda(tau, order)` by the coefficients, (..., n)."""
        order = check_derivative(order)
        basis = bernstein_basis(self.degree, self._unit(tau), order)
        return np.asarray(basis / (self.tau_f - self.tau_0) ** order)

    def time(self, tau: ArrayLike) -> Array:
        """
        Return the time [s], by adaptive quadrature of 1/lambda, to 1e-12 of itself.

        Raises
        ------
        InvalidProblem
            If it is not finite, the coefficients lying too many orders of magnitude apart.

        """
        return np.asarray((self.tau_f - self.tau_0) * self._slowness.to(*self._places(tau)))

    @cached_property
    def _slowness(self) -> ReciprocalIntegral:
        return ReciprocalIntegral(self.coefficients)


class TimeFactor(ArcTime):
    """mu(s) = dt/ds = sum_i c_i B_i(s) [s], all c_i > 0; lambda = (tau_f - tau_0)/mu."""

    def __call__(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the `order`-th derivative of lambda by tau, at tau (...)."""
        s, order = self._unit(tau), check_derivative(order)
        rates = [bernstein_basis(self.degree, s, k) @ self.coefficients for k in range(order + 1)]
        span = self.tau_f - self.tau_0
        return np.asarray(reciprocal(rates)[order] * span ** (1 - order))

    def jacobian(self, tau: ArrayLike, order: int = 0) -> Array:
        """
        Return the derivative of `lambda(tau, order)` by the coefficients, (..., n).

        It is exact, but lambda is not linear in these coefficients (1/lambda is): the derivative
        depends on them. From dlambda = -(tau_f - tau_0) dmu / mu^2, differentiated by Leibniz.
        """
        s, order = self._unit(tau), check_derivative(order)
        basis = [bernstein_basis(self.degree, s, k) for k in range(order + 1)]
        inverse = reciprocal([values @ self.coefficients for values in basis])
        squared = [_product_derivative(inverse, inverse, k)[..., None] for k in range(order + 1)]
        span = self.tau_f - self.tau_0
        return np.asarray(-_product_derivative(squared, basis, order) * span ** (1 - order))

    def time(self, tau: ArrayLike) -> Array:
        """Return the time [s], exactly: the integral of a polynomial."""
        return np.asarray(bernstein_integral(self.degree, self._unit(tau)) @ self.coefficients)


def _product_derivative(f: Sequence[Array], g: Sequence[Array], order: int) -> Array:
    """Return the `order`-th derivative of a product from the derivatives of its factors."""
    terms = [math.comb(order, j) * f[j] * g[order - j] for j in range(order + 1)]
    return np.asarray(sum(terms[1:], terms[0]))
