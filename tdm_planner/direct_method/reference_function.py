# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""What all reference functions have in common, and the bases they are made of."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]


@runtime_checkable
class ReferenceFunction(Protocol):
    """A function x(tau) on the virtual arc [tau_0, tau_f] that meets its boundary conditions.

    It is linear in its parameters (m of them), so that `jacobian` is exact and does not depend on
    their values.
    """

    tau_0: float
    tau_f: float

    def __call__(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the `order`-th derivative at tau (n...,): shape (n..., value shape)."""

    def jacobian(self, tau: ArrayLike, order: int = 0) -> Array:
        """Derivative of `x(tau, order)` with respect to the parameters, (n..., m)."""


@runtime_checkable
class ReferenceBasis(Protocol):
    """A family of reference functions on the unit interval, split by what determines them.

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
        """Return the `derivative`-th derivative at s (...) of the part of every condition."""

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative at s (...) of every free shape."""


def check_arc(tau_0: float, tau_f: float) -> None:
    """Check the ends of a virtual arc.

    Raises
    ------
    InvalidProblem
        If tau_f <= tau_0, or one of them is not finite.
    """
    if not (np.isfinite([tau_0, tau_f]).all() and tau_f > tau_0):
        raise InvalidProblem(
            f'the virtual arc must end after it starts, but tau_0 = {tau_0:g}, tau_f = {tau_f:g}'
        )


def check_orders(where: str, orders: tuple[int, ...]) -> None:
    """Check the orders of the derivatives given at one end.

    Raises
    ------
    InvalidProblem
        If an order is repeated or negative.
    """
    if len(set(orders)) != len(orders) or any(order < 0 for order in orders):
        raise InvalidProblem(
            f'the derivatives given at the {where}, {list(orders)}, must be distinct and >= 0'
        )
