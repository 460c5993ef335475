# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The nonlinear program of section 4.2: performance index (28) under the limits of (17)-(19).

Varied parameters: of every robot the time (or speed factor) and the shapes of its reference
functions, see `ReferenceMotion`; thrust, torque and gas by `InverseDynamics` at Chebyshev nodes.
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
from tdm_planner.problems.formation_cost import GasAndThrust
from tdm_planner.problems.inverse_dynamics import clenshaw_curtis, InverseDynamics, NodeValues
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion
from tdm_planner.problems.separation import (
    CircleApproaches,
    CircleSeparation,
    PairApproaches,
    PairSeparation,
)
from tdm_planner.problems.thruster_rows import HodographValues, ThrusterRows

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_CURVATURE_FLOOR = 1e-3  # smallest eigenvalue of a robot's Hessian, relative to its largest
_NEAR = 0.6  # approaches within this share beyond the clearance become rows
_ACTIVE_THRUST, _ACTIVE_TORQUE, _ACTIVE_WALL = 0.35, 0.5, 1.0


@dataclass(frozen=True)
class FormationValues:
    """What is known at one Xi; margins are relative to their limits, negative if violated.

    `thrust`, `torque` (n, K) at the nodes, `walls` (n, 2, 2, W) [robot, side, axis, arc].
    """

    motion: FormationMotion
    nodes: NodeValues
    thrust: Array
    torque: Array
    walls: Array
    pairs: PairApproaches
    circles: CircleApproaches
    hodograph: HodographValues | None


class FormationProgram(NonlinearProgram):
    """The program of one manoeuvre, in the scaled varied parameters that are free, Xi (m,).

    Staying robots have only their times (and attitudes) varied. Constraints that are violated
    count relative to their limits. Group 0 holds all but the thruster's rate; with
    `limit_thruster_rate` group 1 holds that. `scale` is a typical J, by which the cost is divided.
    """

    def __init__(
        self,
        model: ReferenceMotion,
        nodes: int | None = None,
        common_instants: int = 32,
        limit_thruster_rate: bool = False,
    ) -> None:
        self.model = model
        s, weights = clenshaw_curtis(nodes or max(21, 5 * model.order - 14))
        self.dynamics = InverseDynamics(model, s)
        self.gas = GasAndThrust(self.dynamics, weights)
        wall_count = 2 * model.order - 1
        self.wall_arcs = np.arange(1, wall_count + 1) / (wall_count + 1)
        self.wall_basis = model.values(self.wall_arcs)
        self.wall_clearances = model.task.wall_clearances()
        interval = 1.5 * model.time_scale / common_instants
        self.pairs = PairSeparation(model, interval, _NEAR)
        self.circles = CircleSeparation(model, common_instants, _NEAR)
        self.thruster = ThrusterRows(model, s) if limit_thruster_rate else None
        self.groups = 2 if limit_thruster_rate else 1
        self.evaluations = 0
        self.scale = self._typical_cost()
        self._set_bounds()

    def _typical_cost(self) -> float:
        task, time = self.model.task, 1.5 * self.model.time_scale
        way = np.linalg.norm(task.goal - task.departure, axis=1).sum()
        gas = 2.4 * way / time + np.linalg.norm(task.velocity, axis=1).sum()
        w = task.weights
        return float(max(w[0] * time + w[2] * gas + 0.1 * w[1] * time, 1e-9))

    def _set_bounds(self) -> None:
        model, task = self.model, self.model.task
        shape, nb = (task.n, model.size), model.nb
        free = np.ones(shape, dtype=bool)
        free[task.staying, slice(nb, nb + 2 * model.nf)] = False
        self.free = np.flatnonzero(free.ravel())
        lower, upper = np.full(shape, -np.inf), np.full(shape, np.inf)
        # The speed factor's coefficients must stay positive, and well so.
        lower[:, :nb] = 0.05 if model.degree == 0 else 0.4
        lower[task.staying, :nb] = 0.02
        latest = np.maximum(task.longest - task.coast, 0.1) / model.time_scale
        upper[:, :nb] = latest[:, None]
        upper[task.staying & (task.arrived > 0.0), :nb] = 0.03  # they are there already
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

    def motion(self, xi: Array) -> FormationMotion:
        """Return the motions at Xi."""
        return self.model.unpack(self.full(xi))

    def evaluate(self, xi: Array) -> Point:
        """Return the performance index, relative to a typical one, and the violations."""
        task = self.model.task
        self.evaluations += 1
        values = self.values(xi)
        gas = self.gas.gas(values.nodes)
        terms = task.cost_terms(task.coast + values.motion.durations, gas)
        worst = min(
            values.thrust.min(),
            values.torque.min(),
            values.walls.min(),
            values.pairs.margins.min(initial=0.0),
            values.circles.margins.min(initial=0.0),
        )
        violations = [max(0.0, -worst)]
        if values.hodograph is not None:
            violations.append(max(0.0, -values.hodograph.margins.min()))
        return Point(
            np.asarray(xi), sum(terms.values()) / self.scale, np.array(violations), values
        )

    def values(self, xi: Array) -> FormationValues:
        """Motions and margins at Xi."""
        task, motion = self.model.task, self.motion(xi)
        nodes = self.dynamics.at(motion)
        places = motion.position @ self.wall_basis.T
        low = places - self.wall_clearances[:, :, 0, None]
        high = task.sides[:, None] - self.wall_clearances[:, :, 1, None] - places
        return FormationValues(
            motion=motion,
            nodes=nodes,
            thrust=self.gas.margins(nodes),
            torque=1.0 - np.abs(nodes.y[:, 2]) / (task.torque * nodes.mu),
            walls=np.stack([low, high], axis=1) / task.separation,
            pairs=self.pairs.nearest(motion),
            circles=self.circles.nearest(motion),
            hodograph=None if self.thruster is None else self.thruster.values(motion),
        )

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Exact first derivatives; Hessian of gas and thrust rows, see the base class."""
        values: FormationValues = point.cache
        task, model = self.model.task, self.model
        n, size = task.n, model.size
        slopes = self.dynamics.slopes(values.motion, values.nodes)
        gradient, hessian = self.gas.derivatives(
            values.nodes, slopes, task.weights[2] / self.scale, self._thrust_dual(multipliers)
        )
        durations = np.zeros((n, n, size))
        durations[np.arange(n), np.arange(n), : model.nb] = model.time_scale / model.nb
        durations = durations.reshape(n, -1)[:, self.free]
        first = task.weights[0] / self.scale * durations[0]
        arrivals = task.coast + values.motion.durations - task.arrived
        late = np.diff(arrivals) - task.interval
        numbers, rows = self._rows(values, slopes.y)
        groups = [np.zeros(len(number), dtype=np.intp) for number in numbers]
        if self.thruster is not None and values.hodograph is not None:
            margins, jacobian = self.thruster.rows(values.motion, values.hodograph)
            numbers.append(margins)
            rows.append(jacobian)
            groups.append(np.ones(margins.size, dtype=np.intp))
        return Linearisation(
            gradient=gradient.ravel()[self.free] + first,
            hessian=self.definite(hessian),
            equalities=np.zeros(0),
            equality_jacobian=np.zeros((0, self.free.size)),
            inequalities=np.concatenate(numbers),
            inequality_jacobian=np.concatenate(rows).reshape(-1, n * size)[:, self.free],
            inequality_groups=np.concatenate(groups),
            terms=late / model.time_scale,
            terms_jacobian=np.diff(durations, axis=0) / model.time_scale,
            term_weights=np.full(n - 1, task.weights[1] * model.time_scale / self.scale),
            tags=np.nonzero(values.thrust < _ACTIVE_THRUST),
        )

    def _rows(self, values: FormationValues, y_slope: Array) -> tuple[list[Array], list[Array]]:
        """Margins near active and their slopes (r, n, P), thrust first."""
        task, model, nodes = self.model.task, self.model, values.nodes
        numbers, rows = [], []

        def add(robots: Indices, margins: Array, slopes: Array) -> None:
            row = np.zeros((robots.size, task.n, model.size))
            row[np.arange(robots.size), robots] = slopes
            numbers.append(margins)
            rows.append(row)

        i, k = np.nonzero(values.thrust < _ACTIVE_THRUST)
        add(i, values.thrust[i, k], self.gas.margin_rows(nodes, y_slope, i, k))

        i, k = np.nonzero(values.torque < _ACTIVE_TORQUE)
        sign = np.sign(nodes.y[i, 2, k]) / (task.torque * nodes.mu[i, k])
        share = (1.0 - values.torque[i, k]) / nodes.mu[i, k]
        slopes = share[:, None] * self.dynamics.mu_jacobian[k] - sign[:, None] * y_slope[i, 2, k]
        add(i, values.torque[i, k], slopes)

        i, side, axis, k = np.nonzero(values.walls < _ACTIVE_WALL)
        sign = np.where(side == 0, 1.0, -1.0) / task.separation
        _, places = model.points(values.motion, i, self.wall_arcs[k], at_fixed_time=False)
        slopes = sign[:, None] * places[np.arange(i.size), axis]
        add(i, values.walls[i, side, axis, k], slopes)

        numbers += [values.pairs.margins, values.circles.margins]
        rows += [
            self.pairs.rows(values.motion, values.pairs),
            self.circles.rows(values.motion, values.circles),
        ]
        return numbers, rows

    def _thrust_dual(self, multipliers: Multipliers | None) -> Array | None:
        """Multipliers of the thrust rows at every node (n, K)."""
        if multipliers is None:
            return None
        robots, nodes = multipliers.tags
        dual = np.zeros((self.model.task.n, self.dynamics.nodes.size))
        dual[robots, nodes] = multipliers.inequalities[: robots.size]
        return dual if dual.any() else None

    def definite(self, blocks: Array) -> Array:
        """Hessian (m, m) of the free parameters from the robots' blocks (n, P, P).

        Their eigenvalues are lifted above zero.
        """
        n, size = self.model.task.n, self.model.size
        varied = np.zeros(n * size)
        varied[self.free] = 1.0
        varied = varied.reshape(n, size)
        values, vectors = np.linalg.eigh(blocks * varied[:, :, None] * varied[:, None])
        floor = _CURVATURE_FLOOR * np.maximum(1e-3, values[:, -1:])
        lifted = (vectors * np.maximum(values, floor)[:, None]) @ np.swapaxes(vectors, 1, 2)
        hessian = np.zeros((n, size, n, size))
        hessian[np.arange(n), :, np.arange(n), :] = lifted
        return hessian.reshape(n * size, n * size)[np.ix_(self.free, self.free)]

    def binding(self, point: Point) -> str:
        """Name the constraint that is violated most at `point`, in words."""
        values: FormationValues = point.cache
        names = self.model.task.names

        def worst(margins: Array) -> str:
            return f"'{names[int(np.argmin(margins.reshape(len(names), -1).min(axis=1)))]}'"

        found = {
            f'limits.thrust of {worst(values.thrust)}': values.thrust.min(),
            f'limits.torque of {worst(values.torque)}': values.torque.min(),
            f'the distance of {worst(values.walls)} from the walls': values.walls.min(),
        }
        if values.pairs.margins.size:
            first, second = self.pairs.robots(values.pairs)
            k = int(np.argmin(values.pairs.margins))
            label = f"arena.minimum_separation of '{names[first[k]]}' and '{names[second[k]]}'"
            found[label] = values.pairs.margins[k]
        if values.circles.margins.size:
            k = int(np.argmin(values.circles.margins))
            name = names[values.circles.robot[k]]
            label = f"the distance of '{name}' from keep-out zones or staying robots"
            found[label] = values.circles.margins[k]
        return min(found, key=lambda label: float(found[label]))
