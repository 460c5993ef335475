# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Bernstein polynomials on the unit interval: positive wherever their coefficients are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def bernstein_basis(degree: int, s: ArrayLike, derivative: int = 0) -> Array:
    """Return the `derivative`-th derivative of B_0..B_degree at s (...), (..., degree + 1)."""
    at = np.asarray(s, dtype=float)
    if derivative > degree:
        return np.zeros((*at.shape, degree + 1))
    reduced = degree - derivative
    powers = [
        math.comb(reduced, i) * at**i * (1.0 - at) ** (reduced - i) for i in range(reduced + 1)
    ]
    differences = np.diff(np.eye(degree + 1), n=derivative, axis=0)
    return np.asarray(math.perm(degree, derivative) * (np.stack(powers, axis=-1) @ differences))


def bernstein_integral(degree: int, s: ArrayLike) -> Array:
    """Return the integral of B_0..B_degree from 0 to s (...), (..., degree + 1)."""
    above = bernstein_basis(degree + 1, s)
    tails = np.cumsum(above[..., ::-1], axis=-1)[..., ::-1]
    return np.asarray(tails[..., 1:] / (degree + 1))
