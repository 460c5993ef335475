# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The speed factor lambda(tau) = dtau/dt > 0 as a reference function of its own.

It gives the speed along a path back its freedom, (5) of Yakimenko (2006). Two forms: `SpeedFactor`
has lambda as a Bernstein polynomial and time by quadrature; `TimeFactor` has mu = dt/ds as one,
and time exactly. Bernstein polynomials with positive coefficients are positive a priori.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.bernstein import bernstein_basis, bernstein_integral
from tdm_planner.direct_method.checks import check_arc, check_derivative, real_array
from tdm_planner.direct_method.virtual_domain import reciprocal
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

_PANELS, _POINTS = 16, 12  # of the Gauss-Legendre quadrature of 1/lambda


class ArcTime(ABC):
    """Relation of time t and virtual arc tau in [tau_0, tau_f], t(tau_0) = 0.

    Raises
    ------
    InvalidProblem
        If tau_f <= tau_0, or a coefficient is not a positive number.
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
    def time(self, tau: ArrayLike) -> Array:
        """Return the time [s] at which tau (...) is reached."""

    def derivatives(self, tau: ArrayLike, count: int) -> list[Array]:
        """Return lambda, lambda', ..., `count` of them, as `virtual_domain` takes them."""
        return [self(tau, order) for order in range(count)]

    def arc_at(self, time: ArrayLike) -> Array:
        """Return tau (...) at the time(s) [s], clipped to the arc: the inverse of `time`."""
        wanted = np.clip(real_array(time, 'the time'), 0.0, self.duration)
        low = np.full(wanted.shape, self.tau_0)
        high = np.full(wanted.shape, self.tau_f)
        tau = self.tau_0 + (self.tau_f - self.tau_0) * wanted / self.duration
        for _ in range(60):  # Newton, kept inside a bracket that always shrinks
            error = self.time(tau) - wanted
            if np.abs(error).max(initial=0.0) <= 1e-14 * self.duration:
                break
            low, high = np.where(error < 0, tau, low), np.where(error < 0, high, tau)
            step = tau - error * self(tau)
            tau = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        return np.asarray(tau)

    def _unit(self, tau: ArrayLike) -> Array:
        return (real_array(tau, 'tau') - self.tau_0) / (self.tau_f - self.tau_0)


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
        """Return the time [s], by composite Gauss-Legendre quadrature of 1/lambda."""
        s = self._unit(tau)
        points, weights = np.polynomial.legendre.leggauss(_POINTS)
        panels = (np.arange(_PANELS)[:, None] + 0.5 * (points + 1.0)) / _PANELS
        at = s[..., None] * panels.ravel()
        slowness = 1.0 / (bernstein_basis(self.degree, at) @ self.coefficients)
        mean = slowness @ np.tile(weights / (2.0 * _PANELS), _PANELS)
        return np.asarray((self.tau_f - self.tau_0) * s * mean)


class TimeFactor(ArcTime):
    """mu(s) = dt/ds = sum_i c_i B_i(s) [s], all c_i > 0; lambda = (tau_f - tau_0)/mu."""

    def __call__(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the `order`-th derivative of lambda by tau, at tau (...)."""
        s, order = self._unit(tau), check_derivative(order)
        rates = [bernstein_basis(self.degree, s, k) @ self.coefficients for k in range(order + 1)]
        span = self.tau_f - self.tau_0
        return np.asarray(reciprocal(rates)[order] * span ** (1 - order))

    def time(self, tau: ArrayLike) -> Array:
        """Return the time [s], exactly: the integral of a polynomial."""
        return np.asarray(bernstein_integral(self.degree, self._unit(tau)) @ self.coefficients)
