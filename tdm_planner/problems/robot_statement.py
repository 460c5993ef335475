# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What holds for one robot at one arc s, stated once: `with_slopes` and `with_curvature` derive it.

Time runs as dt/ds = mu. A derivative by s of x, y or yaw is what is free of it, linear in the
varied parameters, and what the start adds: with `departing` = (mu, mu_s) there, velocity v and
acceleration a, a polynomial begins with X_s = mu v, X_ss = mu^2 a + mu_s v, and `at` holds what
either contributes at s. With N = X_ss mu - X_s mu_s the exact inverse is X'' = N / mu^3, in place
of (21) and (27), which lose the speed factor's slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Numbers = Sequence[Any]

GAS_SMOOTHING = 0.03  # share of F_max by which |F| is rounded off at zero
THRUST_SHARE = 0.99  # of F_max planned with: what lies between nodes, and repairs, need the rest
_ROUNDED = 1e-6  # of F_max, by which the margin of thrust is rounded off at zero


def _along(free: Numbers, departing: Numbers, given: Numbers, at: Numbers) -> list[Any]:
    """Return derivatives by s from what is free of them and `given`: the start's v and a."""
    (mu, slope), (v, a) = departing, given
    second = mu**2 * a + slope * v
    return [x + at[2 * d] * mu * v + at[2 * d + 1] * second for d, x in enumerate(free)]


def acceleration(mu: Any, mu_s: Any, first: Any, second: Any) -> Any:
    """Return X'' from derivatives by s."""
    return (second * mu - first * mu_s) / (mu * mu**2)


def push(local: Numbers, at: Numbers, robot: Numbers) -> tuple[Any, ...]:
    """
    Return the gas per arc [m/s], rounded off at zero, and the margin of thrust, 1 - F / F_max.

    `local`: mu, mu_s, those at the start, x_s, x_ss, y_s, y_ss; `robot`: v_x, a_x, v_y, a_y,
    F_max.
    """
    mu, mu_s = local[:2]
    x = acceleration(mu, mu_s, *_along(local[4:6], local[2:4], robot[0:2], at))
    y = acceleration(mu, mu_s, *_along(local[6:8], local[2:4], robot[2:4], at))
    square, thrust = x**2 + y**2, robot[4]
    limit = THRUST_SHARE * thrust
    gas = np.sqrt(square + (GAS_SMOOTHING * thrust) ** 2) * mu
    return gas, 1.0 - np.sqrt(square + (_ROUNDED * limit) ** 2) / limit


def turn(local: Numbers, at: Numbers, robot: Numbers) -> tuple[Any, ...]:
    """
    Return the margin of torque, 1 - |T| / T_max.

    `local`: mu, mu_s, those at the start, yaw_s, yaw_ss; `robot`: yaw rate, acceleration, T_max.
    """
    yaw = _along(local[4:], local[2:4], robot[:2], at)
    return (1.0 - np.abs(acceleration(*local[:2], *yaw)) / robot[2],)
