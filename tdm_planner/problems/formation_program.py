# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The nonlinear program of section 4.2: performance index (28) under the limits of (17)-(19).

Varied parameters: of every robot the time (or speed factor) and the shapes of its reference
functions, see `ReferenceMotion`. With Y = (X_ss - X_s mu_s / mu) / mu, so that X'' = Y / mu along
the arc, a robot's gas is the integral of |Y_xy| ds, by Clenshaw-Curtis quadrature on Chebyshev
nodes, and its limits there are |Y_xy| <= F_max mu and |Y_yaw| <= T_max mu.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.problems.reference_motion import Motion, powers, ReferenceMotion
from tdm_planner.problems.separation import CircleSeparation, PairSeparation
from tdm_planner.problems.thruster_rows import ThrusterRows

Array = NDArray[np.float64]

_GAS_SMOOTHING = 0.03  # share of F_max by which |F| is rounded off at zero
_THRUST_SHARE = 0.99  # of F_max planned with: what lies between nodes, and repairs, need the rest
_CURVATURE_FLOOR = 1e-3  # smallest eigenvalue of a robot's Hessian, relative to its largest
_NEAR = 0.6  # approaches within this share beyond the clearance become rows
_ACTIVE_THRUST, _ACTIVE_TORQUE, _ACTIVE_WALL = 0.35, 0.5, 1.0


def clenshaw_curtis(count: int) -> tuple[Array, Array]:
    """Chebyshev-Lobatto nodes on [0, 1] and the weights of Clenshaw-Curtis quadrature."""
    last = count - 1
    angle = np.pi * np.arange(count) / last
    moments = np.zeros(count)
    even = np.arange(0, count, 2)
    moments[even] = 2.0 / (1.0 - even**2)
    cosines = np.cos(np.outer(np.arange(count), angle))
    cosines[[0, -1]] *= 0.5
    weights = (moments @ cosines) * 2.0 / last
    weights[[0, -1]] *= 0.5
    return 0.5 * (1.0 - np.cos(angle)), weights / 2.0


@dataclass(frozen=True)
class _Values:
    """What `evaluate` found and `linearise` needs; K nodes, Y (n, 3, K) of x, y, yaw."""

    motion: Motion
    mu: Array
    mu_slope: Array
    first: Array
    second: Array
    y: Array
    force: Array
    smooth: Array
    gas: Array
    thrust_rows: Array
    torque_rows: Array
    wall_rows: Array
    pairs: tuple[NDArray[np.intp], Array]
    pair_values: tuple[Array, Array]
    circles: tuple[NDArray[np.intp], NDArray[np.intp], Array]
    circle_values: tuple[Array, Array]


class FormationProgram(NonlinearProgram):
    """The program of one manoeuvre, in the scaled varied parameters that are free, Xi (m,).

    Staying robots have only their times (and attitudes) varied. Constraints that are violated
    count relative to their limits. Group 0 holds all but the thruster's rate; with
    `limit_thruster_rate` group 1 holds that.
    """

    def __init__(
        self,
        model: ReferenceMotion,
        nodes: int | None = None,
        common_instants: int = 32,
        limit_thruster_rate: bool = False,
    ) -> None:
        self.model, task = model, model.task
        n = task.n
        count = nodes or max(21, 5 * model.order - 14)
        s, self.weights = clenshaw_curtis(count)
        self.nodes = s
        self.basis = [powers(s, d, model.order) for d in range(3)]
        self.yaw_basis = [powers(s, d, model.yaw_order) for d in range(3)]
        self.speed = [model.speed_basis(s, d) for d in range(2)]
        wall_count = 2 * model.order - 1
        self.wall_arcs = np.arange(1, wall_count + 1) / (wall_count + 1)
        self.wall_basis = powers(self.wall_arcs, 0, model.order)
        self.wall_clearances = task.wall_clearances()
        interval = 1.5 * model.time_scale / common_instants
        self.pairs = PairSeparation(model, interval, _NEAR)
        self.circles = CircleSeparation(model, common_instants, _NEAR)
        self.thruster = ThrusterRows(model, s) if limit_thruster_rate else None
        self.evaluations = 0
        self.groups = 2 if limit_thruster_rate else 1
        self.rest = _GAS_SMOOTHING * task.thrust
        self.scale = self._typical_cost()
        self._fixed_jacobian = self._shape_jacobian()
        self._set_bounds(n)

    def _typical_cost(self) -> float:
        task, time = self.model.task, 1.5 * self.model.time_scale
        way = np.linalg.norm(task.goal - task.departure, axis=1).sum()
        gas = 2.4 * way / time + np.linalg.norm(task.velocity, axis=1).sum()
        w = task.weights
        return float(max(w[0] * time + w[2] * gas + 0.1 * w[1] * time, 1e-9))

    def _set_bounds(self, n: int) -> None:
        model, task = self.model, self.model.task
        free = np.ones((n, model.size), dtype=bool)
        free[task.staying, model.nb : model.nb + 2 * model.nf] = False
        self.free = np.flatnonzero(free.ravel())
        lower, upper = np.full((n, model.size), -np.inf), np.full((n, model.size), np.inf)
        shortest = 0.05 if model.degree == 0 else 0.4
        lower[:, : model.nb] = shortest
        lower[task.staying, : model.nb] = 0.02
        latest = np.maximum(task.longest - task.coast, 0.1) / model.time_scale
        upper[:, : model.nb] = latest[:, None]
        lower = np.minimum(lower, 0.9 * upper)
        self.lower, self.upper = lower.ravel()[self.free], upper.ravel()[self.free]

    def full(self, xi: Array) -> Array:
        """Scaled varied parameters of every robot (n, P), those not varied being zero."""
        z = np.zeros(self.model.task.n * self.model.size)
        z[self.free] = xi
        return z.reshape(self.model.task.n, -1)

    def reduce(self, z: Array) -> Array:
        """Take the free ones of the varied parameters (n, P), within their bounds."""
        return np.asarray(np.clip(z.ravel()[self.free], self.lower, self.upper))

    def motion(self, xi: Array) -> Motion:
        """Return the motions at Xi."""
        return self.model.unpack(self.full(xi))

    def evaluate(self, xi: Array) -> Point:
        """Performance index, relative to a typical one, and violations; see the base class."""
        task = self.model.task
        self.evaluations += 1
        motion = self.model.unpack(self.full(xi))
        values = self._values(motion)
        arrivals = task.coast + motion.durations
        cost = sum(task.cost_terms(arrivals, values.gas).values()) / self.scale
        worst = max(
            0.0,
            -values.thrust_rows.min(),
            -values.torque_rows.min(),
            -values.wall_rows.min(),
            -values.pair_values[0].min(initial=0.0),
            -values.circle_values[0].min(initial=0.0),
        )
        violations = [worst]
        rate_cache = None
        if self.thruster is not None:
            rate_cache = self.thruster.values(motion)
            violations.append(max(0.0, -rate_cache.margins.min()))
        return Point(np.asarray(xi), cost, np.array(violations), (values, rate_cache))

    def binding(self, point: Point) -> str:
        """Name the constraint that is violated most at `point`, in words."""
        values: _Values = point.cache[0]
        names = self.model.task.names

        def robot(rows: Array) -> str:
            return f"'{names[int(np.argmin(rows.reshape(len(names), -1).min(axis=1)))]}'"

        def pair() -> str:
            worst = values.pairs[0][int(np.argmin(values.pair_values[0]))]
            first, second = self.pairs.first[worst], self.pairs.second[worst]
            return f"'{names[first]}' and '{names[second]}'"

        margins = {
            f'limits.thrust of {robot(values.thrust_rows)}': values.thrust_rows.min(),
            f'limits.torque of {robot(values.torque_rows)}': values.torque_rows.min(),
            f'the distance of {robot(values.wall_rows)} from the walls': values.wall_rows.min(),
        }
        if values.pair_values[0].size:
            label = f'arena.minimum_separation of {pair()}'
            margins[label] = values.pair_values[0].min()
        if values.circle_values[0].size:
            worst = names[values.circles[0][int(np.argmin(values.circle_values[0]))]]
            label = f"the distance of '{worst}' from keep-out zones or staying robots"
            margins[label] = values.circle_values[0].min()
        return min(margins, key=lambda label: float(margins[label]))

    def _values(self, motion: Motion) -> _Values:
        task = self.model.task
        mu = motion.rates @ self.speed[0].T
        mu_slope = motion.rates @ self.speed[1].T
        first = np.concatenate(
            [motion.position @ self.basis[1].T, (motion.yaw @ self.yaw_basis[1].T)[:, None]],
            axis=1,
        )
        second = np.concatenate(
            [motion.position @ self.basis[2].T, (motion.yaw @ self.yaw_basis[2].T)[:, None]],
            axis=1,
        )
        y = (second - first * (mu_slope / mu)[:, None]) / mu[:, None]
        force = np.sqrt(y[:, 0] ** 2 + y[:, 1] ** 2)
        smooth = np.sqrt(force**2 + (self.rest * mu) ** 2)
        at_walls = motion.position @ self.wall_basis.T
        low = at_walls - self.wall_clearances[:, :, 0, None]
        high = task.sides[:, None] - self.wall_clearances[:, :, 1, None] - at_walls
        near = self.pairs.nearest(motion)
        circles = self.circles.nearest(motion)
        return _Values(
            motion=motion,
            mu=mu,
            mu_slope=mu_slope,
            first=first,
            second=second,
            y=y,
            force=force,
            smooth=smooth,
            gas=smooth @ self.weights,
            thrust_rows=1.0 - force / (_THRUST_SHARE * task.thrust * mu),
            torque_rows=1.0 - np.abs(y[:, 2]) / (task.torque * mu),
            wall_rows=np.stack([low, high], axis=1) / task.separation,
            pairs=near,
            pair_values=self.pairs.values(motion, *near),
            circles=circles,
            circle_values=self.circles.values(motion, *circles),
        )

    def _shape_jacobian(self) -> tuple[Array, Array]:
        """X_s and X_ss differentiated with respect to the scaled shapes: (3, K, P) each."""
        model, count = self.model, self.nodes.size
        slopes = []
        for derivative in (1, 2):
            slope = np.zeros((3, count, model.size))
            shapes = self.basis[derivative] @ model.basis.free * model.length_scale
            for axis in range(2):
                begin = model.nb + axis * model.nf
                slope[axis, :, begin : begin + model.nf] = shapes
            if model.ny:
                yaw = self.yaw_basis[derivative] @ model.yaw_basis.free * model.yaw_scale
                slope[2, :, model.nb + 2 * model.nf :] = yaw
            slopes.append(slope)
        return slopes[0], slopes[1]

    def _slopes(self, values: _Values) -> tuple[Array, Array, Array]:
        """X_s, X_ss (n, 3, K, P) and Y (n, 3, K, P) differentiated with respect to Z."""
        model, motion = self.model, values.motion
        n, nb = model.task.n, model.nb
        first = np.broadcast_to(
            self._fixed_jacobian[0], (n, *self._fixed_jacobian[0].shape)
        ).copy()
        second = np.broadcast_to(self._fixed_jacobian[1], first.shape).copy()
        for target, d in ((first, 1), (second, 2)):
            if model.moving_start:
                slope = motion.position_slope @ self.basis[d].T * model.time_scale
                target[:, :2, :, :nb] = np.swapaxes(slope, 2, 3)
            slope = motion.yaw_slope @ self.yaw_basis[d].T * model.time_scale
            target[:, 2, :, :nb] = np.swapaxes(slope, 1, 2)
        mu, ratio = values.mu[:, None, :, None], (values.mu_slope / values.mu)[:, None, :, None]
        y = (second - first * ratio) / mu if model.degree else second / mu
        by_mu = -(values.y - values.first * (values.mu_slope / values.mu**2)[:, None])
        by_mu = by_mu / values.mu[:, None]
        y[..., :nb] += by_mu[..., None] * self.speed[0] * model.time_scale
        if model.degree:
            by_slope = -values.first / values.mu[:, None] ** 2
            y[..., :nb] += by_slope[..., None] * self.speed[1] * model.time_scale
        return first, second, y

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Exact first derivatives; Hessian of gas and thrust rows, see the base class."""
        values: _Values = point.cache[0]
        task, model = self.model.task, self.model
        n, size = task.n, model.size
        first, second, y_slope = self._slopes(values)
        rows, numbers, groups = self._rows(values, y_slope)
        if self.thruster is not None:
            margins, jacobian = self.thruster.rows(values.motion, point.cache[1])
            rows.append(jacobian)
            numbers.append(margins)
            groups.append(np.ones(margins.size, dtype=np.intp))
        durations = np.zeros((n, n, size))
        durations[np.arange(n), np.arange(n), : model.nb] = model.time_scale / model.nb
        durations = durations.reshape(n, -1)[:, self.free]
        gradient, hessian = self._cost_derivatives(values, first, second, y_slope, multipliers)
        gradient = gradient + task.weights[0] / self.scale * durations[0]
        late = np.diff(task.coast + values.motion.durations) - task.interval
        return Linearisation(
            gradient=gradient,
            hessian=hessian,
            equalities=np.zeros(0),
            equality_jacobian=np.zeros((0, self.free.size)),
            inequalities=np.concatenate(numbers),
            inequality_jacobian=np.concatenate(rows).reshape(-1, n * size)[:, self.free],
            inequality_groups=np.concatenate(groups),
            terms=late / model.time_scale,
            terms_jacobian=np.diff(durations, axis=0) / model.time_scale,
            term_weights=np.full(n - 1, task.weights[1] * model.time_scale / self.scale),
            tags=np.nonzero(values.thrust_rows < _ACTIVE_THRUST),
        )

    def _rows(
        self, values: _Values, y_slope: Array
    ) -> tuple[list[Array], list[Array], list[NDArray[np.intp]]]:
        """Rows near active, as (r, n, P), with their values and groups; thrust rows first."""
        task, model, nb = self.model.task, self.model, self.model.nb
        rows, numbers = [], []
        mu_slope = self.speed[0] * model.time_scale

        def add(robots: NDArray[np.intp], number: Array, jacobian: Array) -> None:
            row = np.zeros((robots.size, task.n, model.size))
            row[np.arange(robots.size), robots] = jacobian
            rows.append(row)
            numbers.append(number)

        i, k = np.nonzero(values.thrust_rows < _ACTIVE_THRUST)
        limit = _THRUST_SHARE * task.thrust * values.mu[i, k]
        unit = values.y[i, :2, k] / np.maximum(values.force[i, k], 1e-9)[:, None]
        jacobian = -np.einsum('rd,rdp->rp', unit, y_slope[i, :2, k]) / limit[:, None]
        share = (1.0 - values.thrust_rows[i, k]) / values.mu[i, k]
        jacobian[:, :nb] += share[:, None] * mu_slope[k]
        add(i, values.thrust_rows[i, k], jacobian)

        i, k = np.nonzero(values.torque_rows < _ACTIVE_TORQUE)
        sign = np.sign(values.y[i, 2, k]) / (task.torque * values.mu[i, k])
        jacobian = -sign[:, None] * y_slope[i, 2, k]
        share = (1.0 - values.torque_rows[i, k]) / values.mu[i, k]
        jacobian[:, :nb] += share[:, None] * mu_slope[k]
        add(i, values.torque_rows[i, k], jacobian)

        i, side, axis, k = np.nonzero(values.wall_rows < _ACTIVE_WALL)
        sign = np.where(side == 0, 1.0, -1.0) / task.separation
        _, slope = model.points(values.motion, i, self.wall_arcs[k], at_fixed_time=False)
        add(i, values.wall_rows[i, side, axis, k], sign[:, None] * slope[np.arange(i.size), axis])

        for near in (
            self.pairs.rows(values.motion, *values.pairs, *values.pair_values),
            self.circles.rows(values.motion, *values.circles, *values.circle_values),
        ):
            rows.append(near.jacobian)
            numbers.append(near.values)
        return rows, numbers, [np.zeros(len(number), dtype=np.intp) for number in numbers]

    def _cost_derivatives(
        self,
        values: _Values,
        first: Array,
        second: Array,
        y_slope: Array,
        multipliers: Multipliers | None,
    ) -> tuple[Array, Array]:
        """Gradient of the gas and Hessian of gas plus multipliers times thrust rows."""
        task, model, nb = self.model.task, self.model, self.model.nb
        n, size, mu = task.n, model.size, values.mu
        weight = task.weights[2] / self.scale * self.weights
        scaled = np.zeros((n, 3, self.nodes.size, size))
        scaled[:, :2] = y_slope[:, :2]
        mu_slope = np.zeros((self.nodes.size, size))
        mu_slope[:, :nb] = self.speed[0] * model.time_scale
        scaled[:, 2] = self.rest * mu_slope
        unit = np.stack([values.y[:, 0], values.y[:, 1], self.rest * mu], axis=1)
        unit = unit / values.smooth[:, None]
        along = np.einsum('ndk,ndkp->nkp', unit, scaled)
        gradient = np.einsum('k,nkp->np', weight, along)
        hessian = _norm_hessian(scaled, along, weight / values.smooth)
        pull = weight * unit[:, :2]
        dual = self._thrust_multipliers(multipliers)
        if dual is not None:
            force = np.maximum(values.force, 1e-6 * task.thrust * mu)
            unit2 = values.y[:, :2] / force[:, None]
            along2 = np.einsum('ndk,ndkp->nkp', unit2, y_slope[:, :2])
            factor = dual / (_THRUST_SHARE * task.thrust * mu)
            hessian += _norm_hessian(y_slope[:, :2], along2, factor / force)
            cross = np.einsum('nk,nkp,kr->npr', factor / mu, along2, mu_slope)
            hessian -= cross + np.swapaxes(cross, 1, 2)
            twice = np.einsum('nk,kp,kr->npr', 2 * factor * force / mu**2, mu_slope, mu_slope)
            hessian += twice
            pull = pull + factor[:, None] * unit2
        hessian += self._curvature_of_y(values, first, second, pull, mu_slope)
        return gradient.ravel()[self.free], self._definite(hessian)

    def _curvature_of_y(
        self, values: _Values, first: Array, second: Array, pull: Array, mu_slope: Array
    ) -> Array:
        """Sum of `pull` (n, 2, K) times the second derivatives of Y_x and Y_y (n, P, P)."""
        model, mu = self.model, values.mu[:, None]
        by_second = np.einsum('ndk,ndkp->nkp', pull / mu**2, second[:, :2])
        half = -np.einsum('nkp,kr->npr', by_second, mu_slope)
        whole = 2 * (pull * values.second[:, :2] / mu**3).sum(axis=1)
        if model.degree:
            slope_slope = np.zeros_like(mu_slope)
            slope_slope[:, : model.nb] = self.speed[1] * model.time_scale
            ratio = values.mu_slope[:, None] / mu
            by_first = np.einsum('ndk,ndkp->nkp', pull / mu**2, first[:, :2])
            half -= np.einsum('nkp,kr->npr', by_first, slope_slope)
            by_first = np.einsum('ndk,ndkp->nkp', 2 * pull * ratio / mu**2, first[:, :2])
            half += np.einsum('nkp,kr->npr', by_first, mu_slope)
            mixed = 2 * (pull * values.first[:, :2] / mu**3).sum(axis=1)
            half += np.einsum('nk,kp,kr->npr', mixed, slope_slope, mu_slope)
            whole -= 6 * (pull * values.first[:, :2] * ratio / mu**3).sum(axis=1)
        total = half + np.swapaxes(half, 1, 2)
        total += np.einsum('nk,kp,kr->npr', whole, mu_slope, mu_slope)
        if model.moving_start and not model.vary_ends:
            bend = self.basis[2] - 0.0
            if model.degree:
                bend = bend[None] - self.basis[1] * (values.mu_slope / values.mu)[..., None]
            given = bend @ model.basis.given[:, 2] / values.mu
            twice = 2 * model.task.acceleration[..., None] * given[:, None]
            total[:, 0, 0] += model.time_scale**2 * (pull * twice).sum(axis=(1, 2))
        return np.asarray(total)

    def _thrust_multipliers(self, multipliers: Multipliers | None) -> Array | None:
        if multipliers is None:
            return None
        robots, nodes = multipliers.tags
        dual = np.zeros((self.model.task.n, self.nodes.size))
        dual[robots, nodes] = multipliers.inequalities[: robots.size]
        return dual if dual.any() else None

    def _definite(self, blocks: Array) -> Array:
        """Block-diagonal Hessian of the free parameters, with eigenvalues lifted above zero."""
        n, size = self.model.task.n, self.model.size
        values, vectors = np.linalg.eigh(blocks)
        floor = _CURVATURE_FLOOR * np.maximum(1e-3, values[:, -1:])
        lifted = (vectors * np.maximum(values, floor)[:, None]) @ np.swapaxes(vectors, 1, 2)
        hessian = np.zeros((n, size, n, size))
        hessian[np.arange(n), :, np.arange(n), :] = lifted
        return hessian.reshape(n * size, n * size)[np.ix_(self.free, self.free)]


def _norm_hessian(slope: Array, along: Array, weight: Array) -> Array:
    """Sum over nodes of weight (S'S - ss'); S: `slope` (n, d, K, P), s: `along` (n, K, P)."""
    n, d, count, size = slope.shape
    flat = slope.reshape(n, d * count, size)
    weighted = (slope * weight[:, None, :, None]).reshape(n, d * count, size)
    outer = np.swapaxes(along * weight[..., None], 1, 2) @ along
    return np.asarray(np.swapaxes(weighted, 1, 2) @ flat - outer)
