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
Small dense convex quadratic programs, solved by a library: DAQP, or scipy's NNLS without it.

min d'H d / 2 + g'd  subject to  A d >= b,  lower <= d <= upper,  H positive definite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
import scipy.linalg
import scipy.optimize

try:
    import daqp
except ImportError:  # the scipy path below needs nothing else
    daqp = None

Array = NDArray[np.float64]
Backend = Literal['daqp', 'nnls']

_INFINITE = 1e30
_UNBOUNDED = 1e9  # bounds beyond this are no rows at all for NNLS


@dataclass(frozen=True)
class QuadraticSolution:
    """The minimiser d (n,) and the multipliers (>= 0) of the rows A d >= b, (m,)."""

    step: Array
    multipliers: Array


def default_backend() -> Backend:
    """Return `daqp` where that library can be imported, else `nnls`."""
    return 'nnls' if daqp is None else 'daqp'


def solve_quadratic_program(
    hessian: Array,
    gradient: Array,
    rows: Array,
    least: Array,
    lower: Array,
    upper: Array,
    backend: Backend | None = None,
) -> QuadraticSolution | None:
    """
    Solve the program of this module's docstring; None if it is infeasible or ill conditioned.

    Shapes: `hessian` (n, n), `gradient` (n,), `rows` A (m, n), `least` b (m,), bounds (n,).
    """
    if (backend or default_backend()) == 'daqp':
        return _solve_daqp(hessian, gradient, rows, least, lower, upper)
    return _solve_nnls(hessian, gradient, rows, least, lower, upper)


def _solve_daqp(
    hessian: Array, gradient: Array, rows: Array, least: Array, lower: Array, upper: Array
) -> QuadraticSolution | None:
    n, m = gradient.size, least.size
    step, _, flag, info = daqp.solve(
        np.ascontiguousarray(hessian),
        np.ascontiguousarray(gradient),
        np.ascontiguousarray(rows),
        np.concatenate([np.minimum(upper, _INFINITE), np.full(m, _INFINITE)]),
        np.concatenate([np.maximum(lower, -_INFINITE), least]),
        np.zeros(n + m, dtype=np.int32),
    )
    if flag < 1 or not np.isfinite(step).all():
        return None
    multipliers = np.abs(np.asarray(info['lam'])[n:])
    return QuadraticSolution(np.asarray(step), multipliers)


def _solve_nnls(
    hessian: Array, gradient: Array, rows: Array, least: Array, lower: Array, upper: Array
) -> QuadraticSolution | None:
    """
    Solve the dual as a least-distance problem (Lawson and Hanson 1974, chapter 23).

    With H = L L' and d = L'^-1 (z - L^-1 g) the program becomes min |z| over G z >= h, and the
    nonnegative least-squares residual of [G'; h'] u = e_last gives z.
    """
    n = gradient.size
    try:
        factor = np.linalg.cholesky(hessian)
    except np.linalg.LinAlgError:
        return None
    identity = np.eye(n)
    inverse = scipy.linalg.solve_triangular(factor, identity, lower=True, check_finite=False)
    shift = inverse @ gradient
    below, above = lower > -_UNBOUNDED, upper < _UNBOUNDED
    matrix = np.concatenate([rows, identity[below], -identity[above]]) @ inverse.T
    right = np.concatenate([least, lower[below], -upper[above]]) + matrix @ shift
    norms = np.maximum(np.linalg.norm(matrix, axis=1), 1e-12)
    matrix, right = matrix / norms[:, None], right / norms
    if right.size == 0:
        return QuadraticSolution(-inverse.T @ shift, np.zeros(0))
    target = np.zeros(n + 1)
    target[n] = 1.0
    stacked = np.vstack([matrix.T, right])
    try:
        dual, _ = scipy.optimize.nnls(stacked, target, maxiter=20 * (n + right.size))
    except RuntimeError:
        return None
    residual = stacked @ dual - target
    if residual[n] > -1e-13:
        return None
    step = inverse.T @ (-residual[:n] / residual[n] - shift)
    return QuadraticSolution(step, (dual / -residual[n] / norms)[: least.size])
