# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nodes along the virtual arc, and the weights that integrate over them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.interpolate import CubicSpline
from tdm_planner.direct_method.checks import whole

Array = NDArray[np.float64]

_MOST_NODES = 100_000


def chebyshev_nodes(count: int) -> Array:
    """
    Return `count` Chebyshev-Lobatto nodes on the unit interval, at least 3.

    Raises
    ------
    InvalidProblem
        If `count` is not allowed.

    """
    last = whole(count, 'the number of nodes', 3, _MOST_NODES) - 1
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(last + 1) / last))


def quadrature_weights(nodes: Array) -> Array:
    """
    Return weights (K,) that integrate functions given at `nodes` (K,) from 0 to 1.

    On Chebyshev-Lobatto nodes those of Clenshaw and Curtis, which are exact for polynomials up to
    order K - 1; on others those of the cubic spline through the values.
    """
    count = nodes.size
    if np.abs(nodes - chebyshev_nodes(count)).max() > 1e-12:
        return np.asarray(CubicSpline(nodes, np.eye(count)).integrate(0.0, 1.0))
    k = np.arange(count)
    moments = np.where(k % 2 == 0, 1.0 / (1.0 - np.where(k % 2 == 0, k, 0) ** 2.0), 0.0)
    weights = np.asarray(dct(moments, type=1)) / (count - 1)
    weights[[0, -1]] *= 0.5
    return weights
