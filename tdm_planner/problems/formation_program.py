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
The nonlinear program of section 4.2: performance index (28) under the limits of (17)-(19).

Varied parameters: of every robot the time (or speed factor) and the shapes of its reference
functions, see `ReferenceMotion`; thrust, torque and gas at Chebyshev nodes, see `robot_statement`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.arc_nodes import chebyshev_nodes
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.problems.formation_kernels import ACTIVE_THRUST, FormationValues
from tdm_planner.problems.formation_terms import FormationTerms
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion
from tdm_planner.problems.thruster_rows import HodographValues, ThrusterRows

Array = NDArray[np.float64]

_IRRELEVANT = 2.0  # a margin that makes no row, or one without effect
_CURVATURE_FLOOR = 1e-3  # smallest eigenvalue of a robot's Hessian, relative to its largest


@dataclass(frozen=True, eq=False)
class FormationPoint:
    """What is known at one Xi: values and margins, and those of the thruster's rate."""

    values: FormationValues
    hodograph: HodographValues | None


class FormationProgram(NonlinearProgram):
    """
    The program of one manoeuvre, in the scaled varied parameters that are free, Xi (m,).

    Staying robots have only their times (and attitudes) varied. Constraints that are violated
    count relative to their limits. Group 0 holds all but the thruster's rate; with
    `limit_thruster_rate` group 1 holds that. `scale` is a typical J, by which the cost is divided.
    `held` (n, P) holds the varied parameters of robots whose motion is not varied but avoided by
    the others, NaN for those of the others.
    """

    def __init__(
        self,
        model: ReferenceMotion,
        nodes: int | None = None,
        common_instants: int = 32,
        limit_thruster_rate: bool = False,
        held: Array | None = None,
    ) -> None:
        self.model = model
        shape = model.task.n, model.size
        self.held = np.full(shape, np.nan) if held is None else held
        self._kept = ~np.isnan(self.held[:, 0])
        nodes = nodes or max(21, 5 * model.order - 14)
        interval = 1.5 * model.time_scale / common_instants
        self.terms = FormationTerms(model, nodes, interval, common_instants)
        self.thruster = None
        if limit_thruster_rate:
            self.thruster = ThrusterRows(model, chebyshev_nodes(nodes))
        self.groups = 2 if limit_thruster_rate else 1
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
        task = self.model.task
        self.evaluations += 1
        values = self.values(xi)
        terms = task.cost_terms(task.coast + values.durations, values.gas)
        violations = [max(0.0, -values.worst)]
        hodograph = None
        if self.thruster is not None:
            hodograph = self.thruster.values(self.motion(xi), self.full(xi))
            hodograph.margins[self._kept] = _IRRELEVANT
            violations.append(max(0.0, -hodograph.margins.min()))
        return Point(
            np.asarray(xi),
            sum(terms.values()) / self.scale,
            np.array(violations),
            FormationPoint(values, hodograph),
        )

    def values(self, xi: Array) -> FormationValues:
        """Gas and margins at Xi."""
        values = self.terms.values(self.full(xi))
        if self._kept.any():
            self._ignore_kept(values)
        return values

    def _ignore_kept(self, values: FormationValues) -> None:
        """Leave limits out that depend on nothing varied: the check has the last word on them."""
        for margins in (values.thrust, values.torque, values.walls):
            margins[self._kept] = _IRRELEVANT
        values.circles.margins[self._kept[values.circles.robot]] = _IRRELEVANT
        if values.pairs.margins.size:
            first, second = self.terms.robots(values.pairs)
            values.pairs.margins[self._kept[first] & self._kept[second]] = _IRRELEVANT

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Exact first derivatives; Hessian of gas and thrust rows, see the base class."""
        cache: FormationPoint = point.cache
        values, task, model = cache.values, self.model.task, self.model
        gradient, hessian, margins, rows = self.terms.linearise(
            values, task.weights[2] / self.scale, self._thrust_dual(multipliers)
        )
        groups = np.zeros(margins.size, dtype=np.intp)
        if self.thruster is not None and cache.hodograph is not None:
            rates, more = self.thruster.rows(self.full(point.xi), cache.hodograph)
            margins = np.concatenate([margins, rates])
            rows = np.concatenate([rows, more.reshape(rates.size, rows.shape[1])])
            groups = np.concatenate([groups, np.ones(rates.size, dtype=np.intp)])
        arrivals = task.coast + values.durations - task.arrived
        late = np.diff(arrivals) - task.interval
        return Linearisation(
            gradient=gradient.ravel()[self.free] + self._first_arrival,
            hessian=self.definite(hessian),
            equalities=np.zeros(0),
            equality_jacobian=np.zeros((0, self.free.size)),
            inequalities=margins,
            inequality_jacobian=rows if self.all_free else rows[:, self.free],
            inequality_groups=groups,
            terms=late / model.time_scale,
            terms_jacobian=self._intervals,
            term_weights=np.full(task.n - 1, task.weights[1] * model.time_scale / self.scale),
            tags=np.nonzero(values.thrust < ACTIVE_THRUST),
        )

    def _thrust_dual(self, multipliers: Multipliers | None) -> Array:
        """Multipliers of the thrust rows at every node (n, K)."""
        dual = np.zeros((self.model.task.n, self.terms.nodes))
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
        values: FormationValues = point.cache.values
        names = self.model.task.names

        def worst(margins: Array) -> str:
            return f"'{names[int(np.argmin(margins.reshape(len(names), -1).min(axis=1)))]}'"

        found = {
            f'limits.thrust of {worst(values.thrust)}': values.thrust.min(),
            f'limits.torque of {worst(values.torque)}': values.torque.min(),
            f'the distance of {worst(values.walls)} from the walls': values.walls.min(),
        }
        if values.pairs.margins.size:
            first, second = self.terms.robots(values.pairs)
            k = int(np.argmin(values.pairs.margins))
            label = f"arena.minimum_separation of '{names[first[k]]}' and '{names[second[k]]}'"
            found[label] = values.pairs.margins[k]
        if values.circles.margins.size:
            k = int(np.argmin(values.circles.margins))
            name = names[values.circles.robot[k]]
            label = f"the distance of '{name}' from keep-out zones or staying robots"
            found[label] = values.circles.margins[k]
        return min(found, key=lambda label: float(found[label]))
