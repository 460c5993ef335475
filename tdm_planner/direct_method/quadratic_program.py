# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Small dense convex quadratic programs, solved by the library DAQP.

min d'H d / 2 + g'd  subject to  A d >= b,  lower <= d <= upper,  H positive definite.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_INFINITE = 1e30


@dataclass(frozen=True)
class QuadraticSolution:
    """The minimiser d (n,) and the multipliers (>= 0) of the rows A d >= b, (m,)."""

    step: Array
    multipliers: Array


def solve_quadratic_program(
    hessian: Array, gradient: Array, rows: Array, least: Array, lower: Array, upper: Array
) -> QuadraticSolution | None:
    """
    Solve the program of this module's docstring; None if it is infeasible or ill conditioned.

    Shapes: `hessian` (n, n), `gradient` (n,), `rows` A (m, n), `least` b (m,), bounds (n,).
    """
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
