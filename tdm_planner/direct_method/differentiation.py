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
First derivatives of a vectorised function, where its author gives none.

By complex step (Squire and Trapp 1998), exact to the last bits, where the function is analytic
and written so that complex numbers pass through it; else by central differences.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal
import warnings

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]
Scheme = Literal['complex_step', 'central']

_TINY = 1e-40
_STEP = 2e-6
_DIRECTIONS = 4


def jacobians(function: Callable[[Any], Any], points: Array, scheme: Scheme) -> Array:
    """Return derivatives at points (B, n) of `function`, (b, n) -> (b, m) for any b: (B, m, n)."""
    count, size = points.shape
    identity = np.eye(size)
    if scheme == 'complex_step':
        moved = (points[:, None, :] + 1j * _TINY * identity).reshape(-1, size)
        slopes = function(moved).imag / _TINY
    else:
        forward = (points[:, None, :] + _STEP * identity).reshape(-1, size)
        backward = (points[:, None, :] - _STEP * identity).reshape(-1, size)
        slopes = (function(forward) - function(backward)) / (2.0 * _STEP)
    return np.swapaxes(slopes.reshape(count, size, -1), 1, 2)


def choose_scheme(function: Callable[[Any], Any], point: Array) -> Scheme:
    """
    Return the better scheme that works at `point` (n,).

    The two are compared there, in a few directions at random, in which every argument has a part.
    """
    generator = np.random.default_rng(0)
    directions = generator.normal(size=(_DIRECTIONS, point.size)) / np.sqrt(point.size)

    def along(lengths: Any) -> Any:
        return function((point + lengths[:, :, None] * directions).reshape(-1, point.size))

    with np.errstate(all='ignore'), warnings.catch_warnings():
        warnings.simplefilter('ignore')  # a complex number made real is what is looked for
        both = np.array([[_STEP], [-_STEP]]) * np.ones(_DIRECTIONS)
        values = along(both).reshape(2, _DIRECTIONS, -1)
        differences = (values[0] - values[1]) / (2.0 * _STEP)
        try:
            exact = along(1j * _TINY * np.ones((1, _DIRECTIONS))).imag / _TINY
        except (TypeError, ValueError, InvalidProblem):
            return 'central'
    scale = 1.0 + np.abs(differences)
    agree = np.abs(exact - differences) <= 1e-4 * scale
    return 'complex_step' if bool(agree.all()) else 'central'


def arctan2(y: Any, x: Any) -> Any:
    """numpy.arctan2, which a complex step may pass through."""
    angle = np.arctan2(np.real(y), np.real(x))
    if not (np.iscomplexobj(x) or np.iscomplexobj(y)):
        return angle
    turned = np.real(x) * np.imag(y) - np.real(y) * np.imag(x)
    return angle + 1j * turned / (np.real(x) ** 2 + np.real(y) ** 2)


def absolute(x: Any) -> Any:
    """numpy.abs of real numbers, which a complex step may pass through."""
    return np.where(np.real(x) < 0, -1.0, 1.0) * x
