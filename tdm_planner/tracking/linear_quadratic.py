# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Linear-quadratic regulators: at an equilibrium, and along a trajectory.

About a motion x(t), u(t) the deviation obeys dx' = A(t) dx + B(t) du. The feedback du = -K dx that
minimises the integral of dx'Q dx + du'R du, under controls held over steps of h, follows from the
discrete Riccati recursion (Anderson and Moore, "Optimal Control: Linear Quadratic Methods", 1990)

    K_k = (h R + B'P_{k+1} B)^-1 B'P_{k+1} A,   P_k = h Q + A'P_{k+1} (A - B K_k),

with A, B of the step (`discretise`); dx'P_k dx is the cost still to come.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

Array = NDArray[np.float64]

# |A| h is halved until it is below this, where the series reaches rounding within its terms.
_SERIES_NORM = 0.25
_SERIES_TERMS = 10
_LARGEST_NORM = 1e6  # beyond it the squarings leave few digits


@dataclass(frozen=True, eq=False)
class Regulator:
    """Feedback u = -gain x, gain (nu, nx), with cost to go x' cost_to_go x, (nx, nx)."""

    gain: Array
    cost_to_go: Array


@dataclass(frozen=True, eq=False)
class TimeVaryingRegulator:
    """Feedback of every step: `gains` (n, nu, nx); `costs_to_go` (n+1, nx, nx), the last given."""

    gains: Array
    costs_to_go: Array


def discrete_regulator(a: Array, b: Array, q: Array, r: Array, step: float) -> Regulator:
    """
    Regulate x' = a x + b u, u held over steps of `step` s, by step times the sum of the cost.

    Raises
    ------
    numpy.linalg.LinAlgError
        If (a, b) cannot be stabilised.

    """
    a, b = discretise(a, b, step)
    q, r = q * step, r * step
    try:
        cost_to_go = np.asarray(solve_discrete_are(a, b, q, r), dtype=float)
    except (np.linalg.LinAlgError, ValueError) as error:  # where its pencil cannot be ordered
        raise np.linalg.LinAlgError(
            f'the Riccati equation has no stabilising solution: {error}'
        ) from None
    gain = np.linalg.solve(r + b.T @ cost_to_go @ b, b.T @ cost_to_go @ a)
    return Regulator(np.asarray(gain), cost_to_go)


def discretise(a: Array, b: Array, step: float) -> tuple[Array, Array]:
    """
    Transition over `step` s under a held control: exp(a step), and its integral times b.

    (..., nx, nx), (..., nx, nu) -> the same shapes; the exponential of [[a, b], [0, 0]] by its
    series, scaled and squared.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrices are not finite, or so large that the exponential is not.

    """
    nx, nu = b.shape[-2:]
    # The result is linear in b: in units of its largest entry no large number of it overflows.
    unit = float(np.abs(b).max(initial=0.0)) * step or 1.0
    block = np.zeros((*b.shape[:-2], nx + nu, nx + nu))
    block[..., :nx, :nx] = a * step
    block[..., :nx, nx:] = b * (step / unit)
    largest = float(np.abs(block).sum(axis=-1).max(initial=0.0))
    if not largest < _LARGEST_NORM:
        raise np.linalg.LinAlgError(
            f'no transition over {step:g} s can be computed: the rates are too large'
        )
    halvings = max(0, math.ceil(math.log2(max(largest, 1e-300) / _SERIES_NORM)))
    block /= 2.0**halvings
    identity = np.eye(nx + nu)
    exponential = identity + block / _SERIES_TERMS
    for order in range(_SERIES_TERMS - 1, 0, -1):
        exponential = identity + block @ exponential / order
    with np.errstate(over='ignore', invalid='ignore'):
        for _ in range(halvings):
            exponential = exponential @ exponential
    if not np.isfinite(exponential).all():
        raise np.linalg.LinAlgError(f'the transition over {step:g} s is not finite')
    return exponential[..., :nx, :nx], unit * exponential[..., :nx, nx:]


def time_varying_regulator(
    a: Array, b: Array, q: Array, r: Array, terminal: Array, step: float
) -> TimeVaryingRegulator:
    """
    Regulate along a trajectory whose deviation obeys dx' = a_k dx + b_k du in step k.

    `a` (n, nx, nx) and `b` (n, nx, nu) are continuous-time Jacobians, one a step of `step` s;
    `terminal` (nx, nx) weighs the deviation at the end.
    """
    transitions, inputs = discretise(a, b, step)
    q, r = q * step, r * step
    n, nx, nu = inputs.shape
    gains = np.empty((n, nu, nx))
    costs_to_go = np.empty((n + 1, nx, nx))
    costs_to_go[n] = cost = terminal
    for k in range(n - 1, -1, -1):
        a_k, b_k = transitions[k], inputs[k]
        weighed = b_k.T @ cost
        gains[k] = np.linalg.solve(r + weighed @ b_k, weighed @ a_k)
        cost = q + a_k.T @ cost @ (a_k - b_k @ gains[k])
        # Rounding must not make the symmetric matrix drift off symmetry.
        costs_to_go[k] = cost = 0.5 * (cost + cost.T)
    return TimeVaryingRegulator(gains, costs_to_go)
