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
Compiled: derivatives of a formation's gas and margins at tau = t, see `formation_kernels`.

With respect to Z they count T first, then the shapes of x, y and yaw.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.formation_kernels import FormationTables, KernelValues, taylor

Array = NDArray[np.float64]


@compiled
def derivatives(
    t: FormationTables, values: KernelValues, weight: float, dual: Array, size: int
) -> tuple[Array, Array]:
    """
    Gradient (n, P) of `weight` times the gas, and Hessian (n, P, P) of the Lagrangian.

    `dual` (n, K) holds the multipliers of the margins of thrust; P is `size`. See
    `GasAndThrust.derivatives` and `InverseDynamics.curvature`.
    """
    n, count, nf = values.durations.size, t.weights.size, t.shapes.shape[1]
    own = 1 + 2 * nf  # yaw uses no gas
    gradient, hessian = np.zeros((n, size)), np.zeros((n, size, size))
    bend = t.bent_shapes
    a, s = np.zeros((2, own)), np.zeros((2, own))
    along, limited, by_second = np.empty(own), np.empty(own), np.empty(own)
    for i in range(n):
        mu, h = values.durations[i], hessian[i]
        dmu = t.time_scale
        for k in range(count):
            by_time_x, by_time_y, twice_x, twice_y = _by_time(t, mu, i, k)
            x, y = values.second[i, 0, k], values.second[i, 1, k]
            for q in range(nf):
                a[0, 1 + q] = a[1, 1 + nf + q] = bend[k, q]
                s[0, 1 + q] = s[1, 1 + nf + q] = bend[k, q] / mu
            a[0, 0], a[1, 0] = by_time_x * dmu, by_time_y * dmu
            s[0, 0], s[1, 0] = (by_time_x - x / mu) * dmu / mu, (by_time_y - y / mu) * dmu / mu
            x, y = x / mu, y / mu
            force = math.hypot(x, y)
            smooth = math.sqrt(force**2 + (t.rest * mu) ** 2)
            part = weight * t.weights[k]
            pull_x, pull_y = part * x / smooth, part * y / smooth
            gas, both, cross = part / smooth, part / smooth, 0.0
            shortened, unit_x, unit_y = 0.0, 0.0, 0.0
            if dual[i, k] != 0.0:
                force = max(force, 1e-6 * t.limit * mu)
                factor = dual[i, k] / (t.limit * mu)
                unit_x, unit_y = x / force, y / force
                shortened, cross = factor / force, factor / mu
                both += shortened
                h[0, 0] += 2.0 * factor * force / mu**2 * dmu**2
                pull_x += factor * unit_x
                pull_y += factor * unit_y
            for p in range(own):
                along[p] = (x * s[0, p] + y * s[1, p]) / smooth
                limited[p] = unit_x * s[0, p] + unit_y * s[1, p]
                by_second[p] = (pull_x * a[0, p] + pull_y * a[1, p]) / mu**2
            along[0] += t.rest * mu / smooth * t.rest * dmu
            for p in range(own):
                gradient[i, p] += part * along[p]
                for r in range(p + 1):
                    h[p, r] += (
                        both * (s[0, p] * s[0, r] + s[1, p] * s[1, r])
                        - gas * along[p] * along[r]
                        - shortened * limited[p] * limited[r]
                    )
                h[p, 0] -= (cross * limited[p] + by_second[p]) * dmu
            # The first column counts once more on the diagonal, where both factors are dmu.
            h[0, 0] += gas * (t.rest * dmu) ** 2 - (cross * limited[0] + by_second[0]) * dmu
            h[0, 0] += 2.0 * (pull_x * x + pull_y * y) / mu**2 * dmu**2
            h[0, 0] += (pull_x * twice_x + pull_y * twice_y) / mu * dmu**2
        for p in range(own):
            for r in range(p):
                h[r, p] = h[p, r]
    return gradient, hessian


@compiled
def _by_time(t: FormationTables, mu: float, i: int, k: int) -> tuple[float, float, float, float]:
    """X_ss of x and y at node k differentiated with respect to T, once and twice."""
    x, y, twice_x, twice_y = 0.0, 0.0, 0.0, 0.0
    for j in range(t.bend.shape[1]):
        x += t.bend[k, j] * (t.given[1, i, 0, j] + 2.0 * mu * t.given[2, i, 0, j])
        y += t.bend[k, j] * (t.given[1, i, 1, j] + 2.0 * mu * t.given[2, i, 1, j])
        twice_x += 2.0 * t.bend[k, j] * t.given[2, i, 0, j]
        twice_y += 2.0 * t.bend[k, j] * t.given[2, i, 1, j]
    return x, y, twice_x, twice_y


@compiled
def rows(
    t: FormationTables, values: KernelValues, thrust: float, torque: float, wall: float, size: int
) -> tuple[Array, Array]:
    """Margins (r,) below `thrust`, `torque`, `wall`, and of approaches; their slopes (r, n P)."""
    n, near = values.durations.size, values.pair.size + values.robot.size
    most = near + int((values.thrust < thrust).sum()) + int((values.torque < torque).sum())
    most += int((values.walls < wall).sum())
    margins, slopes = np.empty(most), np.zeros((most, n, size))
    first = _thrust_rows(t, values, thrust, margins, slopes)
    first = _torque_rows(t, values, torque, first, margins, slopes)
    first = _wall_rows(t, values, wall, first, margins, slopes)
    _separation_rows(t, values, first, margins, slopes)
    return margins, slopes.reshape(most, n * size)


@compiled
def _thrust_rows(
    t: FormationTables, values: KernelValues, below: float, margins: Array, rows: Array
) -> int:
    nf, r = t.shapes.shape[1], 0
    bend = t.bent_shapes
    for i in range(values.durations.size):
        mu = values.durations[i]
        for k in range(t.weights.size):
            if not values.thrust[i, k] < below:
                continue
            x, y = values.second[i, 0, k], values.second[i, 1, k]
            by_time_x, by_time_y, _, _ = _by_time(t, mu, i, k)
            force = max(math.hypot(x, y), 1e-9 * mu)
            scale = 1.0 / (force * t.limit * mu**2)
            row = rows[r, i]
            for q in range(nf):
                row[1 + q] = -x * bend[k, q] * scale
                row[1 + nf + q] = -y * bend[k, q] * scale
            # By T: of |X_ss| / T^2.
            change = x * by_time_x + y * by_time_y - 2.0 * (x * x + y * y) / mu
            row[0] = -change * scale * t.time_scale
            margins[r] = values.thrust[i, k]
            r += 1
    return r


@compiled
def _torque_rows(
    t: FormationTables,
    values: KernelValues,
    below: float,
    r: int,
    margins: Array,
    rows: Array,
) -> int:
    nf, ny = t.shapes.shape[1], t.yaw_shapes.shape[1]
    for i in range(values.durations.size):
        mu = values.durations[i]
        for k in range(t.weights.size):
            if not values.torque[i, k] < below:
                continue
            turn, by_time = values.second[i, 2, k], 0.0
            scale = np.sign(turn) / (t.torque * mu**2)
            for j in range(t.turn.shape[1]):
                by_time += t.turn[k, j] * (t.turning[1, i, j] + 2.0 * mu * t.turning[2, i, j])
            row = rows[r, i]
            for q in range(ny):
                bent = 0.0
                for j in range(t.turn.shape[1]):
                    bent += t.turn[k, j] * t.yaw_shapes[j, q]
                row[1 + 2 * nf + q] = -scale * bent
            row[0] = -scale * (by_time - 2.0 * turn / mu) * t.time_scale
            margins[r] = values.torque[i, k]
            r += 1
    return r


@compiled
def _wall_rows(
    t: FormationTables,
    values: KernelValues,
    below: float,
    r: int,
    margins: Array,
    rows: Array,
) -> int:
    nf, m = t.shapes.shape[1], t.shapes.shape[0]
    for i in range(values.durations.size):
        mu = values.durations[i]
        for side in range(2):
            sign = (1.0 if side == 0 else -1.0) / t.separation
            for axis in range(2):
                for k in range(t.wall_places.shape[0]):
                    if not values.walls[i, side, axis, k] < below:
                        continue
                    row = rows[r, i]
                    for j in range(m):
                        value = sign * t.wall_places[k, j]
                        for q in range(nf):
                            row[1 + axis * nf + q] += value * t.shapes[j, q]
                        by_time = t.given[1, i, axis, j] + 2.0 * mu * t.given[2, i, axis, j]
                        row[0] += value * by_time * t.time_scale
                    margins[r] = values.walls[i, side, axis, k]
                    r += 1
    return r


@compiled
def _separation_rows(
    t: FormationTables, values: KernelValues, r: int, margins: Array, rows: Array
) -> None:
    expansions = taylor(t, values.ends)
    for a in range(values.pair.size):
        for end in range(2):
            i = t.pairs[values.pair[a], end]
            scale = (1.0 - 2.0 * end) / t.pair_clearances[values.pair[a]]
            s = (values.pair_times[a] - t.coast[i]) / values.durations[i]
            row = rows[r, i]
            _add_slope(t, values, expansions, i, s, scale, values.pair_units[a], True, row)
        margins[r] = values.pair_margins[a]
        r += 1
    for a in range(values.robot.size):
        i, s = values.robot[a], values.circle_arcs[a]
        scale = 1.0 / t.circle_clearances[i, values.circle[a]]
        row = rows[r, i]
        _add_slope(t, values, expansions, i, s, scale, values.circle_units[a], False, row)
        margins[r] = values.circle_margins[a]
        r += 1


@compiled
def _add_slope(
    t: FormationTables,
    values: KernelValues,
    expansions: Array,
    i: int,
    s: float,
    scale: float,
    unit: Array,
    at_fixed_time: bool,
    row: Array,
) -> None:
    """Add `scale` times the slope along `unit` (2,) of robot i's place at the arc s to `row`."""
    nf, m, mu = t.shapes.shape[1], t.shapes.shape[0], values.durations[i]
    under_way = 0.0 < s < 1.0
    s = min(max(s, 0.0), 1.0)
    side, u = (0, s) if s <= 0.5 else (1, s - 1.0)
    for j in range(m):
        value = 0.0
        for k in range(m - 1, -1, -1):
            value = value * u + t.taylor[side, k, j]
        value *= scale
        for axis in range(2):
            by_time = t.given[1, i, axis, j] + 2.0 * mu * t.given[2, i, axis, j]
            row[0] += value * unit[axis] * by_time * t.time_scale
            for q in range(nf):
                row[1 + axis * nf + q] += value * unit[axis] * t.shapes[j, q]
    if at_fixed_time and under_way:
        speed = unit[0] * _slope(expansions[side, i, 0], u)
        speed += unit[1] * _slope(expansions[side, i, 1], u)
        row[0] -= scale * speed * s / mu * t.time_scale


@compiled
def _slope(coefficients: Array, u: float) -> float:
    value = 0.0
    for k in range(coefficients.size - 1, 0, -1):
        value = value * u + k * coefficients[k]
    return value
