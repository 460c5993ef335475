# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The nonlinear program of section 4.2: performance index (28) under the limits of (17)-(19).

Varied parameters: of every robot the time (or speed factor) and the shapes of its reference
functions, see `ReferenceMotion`; thrust, torque and gas at Chebyshev nodes, see `robot_statement`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.problems.formation_kernels import (
    ACTIVE_THRUST,
    evaluate,
    FormationValues,
    linearise,
    tabulated,
)
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_IRRELEVANT = 2.0  # a margin that makes no row, or one without effect
_KEPT = 0.03  # margin of a separation that binds nobody
_CURVATURE_FLOOR = 1e-3  # smallest eigenvalue of a robot's Hessian, relative to its largest


class FormationProgram(NonlinearProgram):
    """
    The program of one manoeuvre, in the scaled varied parameters that are free, Xi (m,).

    Staying robots have only their times (and attitudes) varied. Constraints that are violated
    count relative to their limits. `scale` is a typical J, by which the cost is divided. `held`
    (n, P) holds the varied parameters of robots whose motion is not varied but avoided by the
    others, NaN for those of the others.
    """

    def __init__(self, model: ReferenceMotion, held: Array | None = None) -> None:
        self.model = model
        shape = model.task.n, model.size
        self.held = np.full(shape, np.nan) if held is None else held
        self._kept = ~np.isnan(self.held[:, 0])
        self._tables = tabulated(model)
        self.evaluations = 0
        self.scale = self._typical_cost()
        self._set_bounds()
        self._set_arrivals()

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
        free[self._kept] = False
        self.free = np.flatnonzero(free.ravel())
        self.all_free = bool(free.all())
        lower, upper = np.full(shape, -np.inf), np.full(shape, np.inf)
        # The speed factor's coefficients must stay positive, and well so.
        lower[:, :nb] = 0.05 if model.degree == 0 else 0.4
        lower[task.staying, :nb] = 0.02
        latest = np.maximum(task.longest - task.coast, 0.1) / model.time_scale
        upper[:, :nb] = latest[:, None]
        upper[task.staying & (task.arrived > 0.0), :nb] = 0.03  # they are there already
        lower = np.minimum(lower, 0.9 * upper)
        self.lower, self.upper = lower.ravel()[self.free], upper.ravel()[self.free]

    def _set_arrivals(self) -> None:
        """Make the slopes of the first arrival's cost, and of the intervals between arrivals."""
        model, n = self.model, self.model.task.n
        durations = np.zeros((n, n, model.size))
        durations[np.arange(n), np.arange(n), : model.nb] = 1.0 / model.nb
        durations = durations.reshape(n, -1)[:, self.free]
        first = model.task.weights[0] / self.scale * model.time_scale
        self._first_arrival = first * durations[0]
        self._intervals = np.diff(durations, axis=0)

    def full(self, xi: Array) -> Array:
        """Scaled varied parameters of every robot (n, P), those not varied being zero."""
        z = np.where(self._kept[:, None], self.held, 0.0).ravel()
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
        task, values = self.model.task, self.values(xi)
        self.evaluations += 1
        terms = task.cost_terms(task.coast + values.durations, values.gas)
        violation = np.array([max(0.0, -values.worst)])
        return Point(np.asarray(xi), sum(terms.values()) / self.scale, violation, values)

    def values(self, xi: Array) -> FormationValues:
        """Gas and margins at Xi."""
        x, t = self.full(xi) * self.model.scales, self._tables
        pushed = (x @ t.push_slopes.T).reshape(t.push_fixed.shape) + t.push_fixed
        turned = (x @ t.turn_slopes.T).reshape(t.turn_fixed.shape) + t.turn_fixed
        values = evaluate(t, x, pushed, turned)
        if self._kept.any():
            self._ignore_kept(values)
        return values

    def pairs(self, values: FormationValues) -> tuple[Indices, Indices]:
        """Return both robots of every approach; what stands still counts on from the last one."""
        first, second = self._tables.separation.pairs[values.pairs.pair].T
        return first, second

    def _ignore_kept(self, values: FormationValues) -> None:
        """Leave limits out that depend on nothing varied: the check has the last word on them."""
        for margins in (values.thrust, values.torque, values.walls):
            margins[self._kept] = _IRRELEVANT
        first, second = self.pairs(values)
        still = np.append(self._kept, np.ones(len(self._tables.separation.centres), dtype=bool))
        values.pairs.margins[still[first] & still[second]] = _IRRELEVANT

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Exact first derivatives; Hessian of gas and thrust rows, see the base class."""
        values: FormationValues = point.cache
        task, model, scales = self.model.task, self.model, self.model.scales
        gradient, hessian, margins, rows = linearise(
            self._tables, values, task.weights[2] / self.scale, self._thrust_dual(multipliers),
            values.near,
        )  # fmt: skip
        rows *= scales
        jacobian = rows.reshape(margins.size, gradient.size)
        arrivals = task.coast + values.durations - task.arrived
        late = np.diff(arrivals) - task.interval
        return Linearisation(
            gradient=(gradient * scales).ravel()[self.free] + self._first_arrival,
            hessian=self.definite(hessian * (scales[:, None] * scales)),
            equalities=np.zeros(0),
            equality_jacobian=np.zeros((0, self.free.size)),
            inequalities=margins,
            inequality_jacobian=jacobian if self.all_free else jacobian[:, self.free],
            inequality_groups=np.zeros(margins.size, dtype=np.intp),
            terms=late / model.time_scale,
            terms_jacobian=self._intervals,
            term_weights=np.full(task.n - 1, task.weights[1] * model.time_scale / self.scale),
            tags=np.nonzero(values.thrust < ACTIVE_THRUST),
        )

    def _thrust_dual(self, multipliers: Multipliers | None) -> Array:
        """Multipliers of the thrust rows at every node (n, K)."""
        dual = np.zeros((self.model.task.n, self.model.form.points))
        if multipliers is not None:
            robots, nodes = multipliers.tags
            dual[robots, nodes] = multipliers.inequalities[: robots.size]
        return dual

    def definite(self, blocks: Array) -> Array:
        """
        Hessian (m, m) of the free parameters from the robots' blocks (n, P, P).

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
            k = int(np.argmin(values.pairs.margins))
            one, other = (int(robots[k]) for robots in self.pairs(values))
            label = f"the distance of '{names[one]}' from keep-out zones or staying robots"
            if other < len(names):
                label = f"arena.minimum_separation of '{names[one]}' and '{names[other]}'"
            found[label] = values.pairs.margins[k]
        return min(found, key=lambda label: float(found[label]))

    def crowded(self, point: Point) -> bool:
        """Whether a separation binds, so that other sides to pass on may be cheaper."""
        return bool(point.cache.pairs.margins.min(initial=1.0) < _KEPT)


def compile_polynomials(task: FormationTask) -> None:
    """Compile the kernels or load them from the disk."""
    program = FormationProgram(ReferenceMotion(task))
    z = np.ones((task.n, program.model.size))
    program.linearise(program.evaluate(program.reduce(z)), None)
