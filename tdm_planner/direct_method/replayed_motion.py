# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A motion that DOP853 has integrated: polynomials between its steps, and how these are chosen.

Hairer, Norsett, Wanner, *Solving Ordinary Differential Equations I*, II.10. The coefficients are
scipy's, and so is the choice of the steps. What integrates is `integrator.Integrator`, for every
plant whose right-hand side can be traced, and a compiled kernel for the rotary pendulum.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import DOP853
from scipy.interpolate import PPoly
from tdm_planner.arrays import Array

TOLERANCES = 1e-9, 1e-11  # relative and absolute, of a step
_SAFETY, _SMALLEST, _LARGEST = 0.9, 0.2, 10.0  # of the factor from a step to the next
_EXPONENT = -1.0 / 8.0  # of the error: the error estimate is of order 7
LEAST_STEP = 1e-12  # share of a piece; where it would take less scipy says what is wrong
MOST_REPLAYED = 100_000  # steps
# Of more than `_FEW` pieces the tolerance is less, as what follows magnifies their errors.
_FEW, _STRICTEST = 30, 100.0


def stricter(pieces: int) -> float:
    """Return the factor of the errors where a motion has so many pieces."""
    return float(min(max(pieces / _FEW, 1.0) ** 2, _STRICTEST))


def step_factor(error: float) -> float:
    """Return the factor from a step to the next, by its error: from 1 on it is tried again."""
    if not error > 0.0:
        return _LARGEST
    return float(min(max(_SAFETY * error**_EXPONENT, _SMALLEST), _LARGEST))


def _dense_output() -> Array:
    """Return the powers of the share of a step (8, 16) that its slopes have in the states."""
    share, left, term = np.poly1d([1.0, 0.0]), np.poly1d([-1.0, 1.0]), np.poly1d([1.0])
    change, (first, last) = np.append(DOP853.B, np.zeros(4)), np.eye(16)[[0, 12]]
    powers = np.zeros((8, 16))
    rows = [change, first - change, 2.0 * change - last - first, *DOP853.D]
    for index, row in enumerate(rows):
        term = term * (left if index % 2 else share)
        powers[: term.order + 1] += np.outer(term.coeffs[::-1], row)
    return powers


_DENSE = _dense_output()


class ReplayedMotion:
    """
    A motion as it was integrated: polynomials between the instants `steps` (m + 1,) [s].

    `begins` (m, nx) are the states there, `slopes` (m, 16, nx) those of every stage.
    """

    def __init__(self, steps: Array, begins: Array, slopes: Array) -> None:
        self.steps = steps
        length = np.diff(steps)
        powers = np.tensordot(_DENSE, slopes, axes=(1, 1))
        powers *= length[:, None] ** (1.0 - np.arange(8)[:, None, None])
        powers[0] = begins
        self._motion = PPoly(powers[::-1], steps)

    def states(self, times: Array) -> Array:
        """States at `times` (n,), (n, nx)."""
        return np.asarray(self._motion(np.array(times)))
