# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The nonlinear program of robots that fly rounded polylines: performance index (28), exact gas.

Varied are, of every robot, the start of its first burn, corners and their instants, and the
arrival; goals are reached exactly whatever they are, see `thrust_arcs_kernels`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.problems.formation_checks import least_time
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.thrust_arcs_approaches import CLOSENESS, COLUMNS, derivatives, evaluate
from tdm_planner.problems.thrust_arcs_kernels import Fleet

Array = NDArray[np.float64]

RATE_SHARE = 0.97  # of the thruster's rate, with which turns are reckoned
_INSTANTS = 80  # in a typical manoeuvre, between which approaches are looked for
_SPEED = 0.02  # of a typical speed, by which |p| is rounded off
_KEPT = 2e-3  # margin of a separation that binds nobody
_PAUSE = 1e-3  # of a typical duration: the shortest coast
_FREELY = 20.0  # times the unit of other arrivals, that of robots that stay
_THERE = 0.01  # of a typical duration, in which robots that stay are at their goals


@dataclass(frozen=True, eq=False)
class HeldMotion:
    """A motion that the others avoid: burns (m, 4) as `thrust_arcs_kernels` has them, arrival."""

    burns: Array
    duration: float


@dataclass(frozen=True, eq=False)
class ArcPoint:
    """Parameters x (n, v), burns (N, m, 4), slopes (n, m, 4, v), margins, approaches (r, 6)."""

    x: Array
    burns: Array
    slopes: Array
    margins: Array
    approaches: Array

    @property
    def closeness(self) -> Array:
        """Margins distance / clearance - 1 of the approaches (r,)."""
        return self.approaches[:, CLOSENESS]


def first_arrival(task: FormationTask) -> float:
    """Arrival of the first robot [s] that (28) prefers, were all ways straight and free."""
    way = np.linalg.norm(task.goal - task.start, axis=1)
    speed = np.linalg.norm(task.velocity, axis=1)
    later = task.interval * np.arange(task.n)
    quickest = np.sqrt(4.4 * way / task.thrust) + 2.0 * speed / task.thrust
    least = max(float((np.maximum(quickest, least_arrivals(task)) - later).max()), 0.02)
    latest = max(task.longest - later[-1], 1.01 * least)
    times = np.geomspace(least, latest, 200)
    lasting = times[:, None] + later
    root = np.sqrt(np.maximum(0.25 * lasting**2 - way / task.thrust, 0.0))
    gas = 2.0 * task.thrust * (0.5 * lasting - root)
    cost = task.weights[0] * times + 1.1 * task.weights[2] * gas.sum(axis=1)
    return float(times[np.argmin(cost)])


def least_arrivals(task: FormationTask) -> Array:
    """Earliest arrivals (n,) s that torque, and a thruster that holds its direction, allow."""
    turn = task.goal_yaw - task.yaw
    held = 2.0 * np.abs(turn) / (RATE_SHARE * task.thruster_rate)
    return np.maximum(least_time(turn, task.yaw_rate, 0.999 * task.torque), held)


class ArcProgram(NonlinearProgram):
    """
    The program of one manoeuvre with `count` burns a robot, in scaled varied parameters Xi.

    Robots that stay vary their arrival only, and `held` ones nothing. Violations are relative.
    """

    def __init__(
        self, task: FormationTask, count: int = 3, held: Mapping[int, HeldMotion] | None = None
    ) -> None:
        self.task, self.count, self.size = task, count, 3 * count - 4
        self.held = held or {}
        self.evaluations = 0
        kept = np.isin(np.arange(task.n), list(self.held))
        self.varied = ~(task.staying | kept)
        self.first = first_arrival(task)
        self._set_scales()
        self._set_fleet()
        self._set_bounds(kept)
        intervals = np.zeros((task.n - 1, task.n, self.size))
        for k in range(task.n - 1):
            intervals[k, k, -1] = -self.units[k, -1]
            intervals[k, k + 1, -1] = self.units[k + 1, -1]
        self._intervals = intervals.reshape(task.n - 1, task.n * self.size)[:, self.free]

    def _set_scales(self) -> None:
        task = self.task
        time, _, gas = task.weights
        way = np.linalg.norm(task.goal - task.start, axis=1).sum()
        typical = 2.4 * way / self.first + np.linalg.norm(task.velocity, axis=1).sum()
        self.scale = float(max(time * self.first + gas * typical, 1e-9))
        self.weights = task.weights / self.scale
        length, lasting = 1.25 * float(task.separation), 0.25 * self.first
        corner = [length, length, lasting]
        self.units = np.tile([lasting, *(corner * (self.count - 2)), lasting], (task.n, 1))
        self.units[task.staying, -1] *= _FREELY  # nothing bends along with these

    def _set_fleet(self) -> None:
        task = self.task
        walls = task.wall_clearances()
        way = np.linalg.norm(task.goal - task.start, axis=1).mean()
        typical = max(float(way), 0.1 * task.separation) / self.first
        typical = max(typical, float(np.linalg.norm(task.velocity, axis=1).mean()))
        centres, _ = task.circles()
        velocity = np.concatenate([task.velocity, np.zeros_like(centres)])
        self._burns = np.zeros((len(velocity), self.count, 4))
        for robot, motion in self.held.items():
            self._burns[robot, : len(motion.burns)] = motion.burns
        self.fleet = Fleet(
            start=np.concatenate([task.start, centres]),
            velocity=velocity,
            clearances=self._clearances(),
            goal=np.ascontiguousarray(task.goal),
            alpha=np.ascontiguousarray(task.alpha),
            yaw=np.ascontiguousarray(task.yaw),
            yaw_rate=np.ascontiguousarray(task.yaw_rate),
            goal_yaw=np.ascontiguousarray(task.goal_yaw),
            varied=self.varied,
            low=np.ascontiguousarray(walls[..., 0]),
            high=np.ascontiguousarray(task.sides - walls[..., 1]),
            thrust=float(task.thrust),
            rate=RATE_SHARE * float(task.thruster_rate),
            pause=_PAUSE * self.first,
            speed=_SPEED * typical,
            length=1.25 * float(task.separation),
            time=0.25 * self.first,
            units=self.units,
            interval=self.first / _INSTANTS,
        )

    def _clearances(self) -> Array:
        """Clearances (N, N) of all from one another, first those of the robots."""
        task, n = self.task, self.task.n
        centres, apart = task.circles()
        found = np.zeros((n + len(centres),) * 2)
        i, j = np.triu_indices(n, 1)
        found[i, j] = task.pair_clearances(i, j)
        found[:n, n:] = apart
        still = np.concatenate([~self.varied, np.ones(len(centres), dtype=bool)])
        found[np.ix_(still, still)] = 0.0
        staying = np.flatnonzero(task.staying)
        found[staying], found[:n, staying] = 0.0, 0.0
        return found

    def _set_bounds(self, kept: NDArray[np.bool_]) -> None:
        task, fleet, shape = self.task, self.fleet, (self.task.n, self.size)
        self.fixed = np.zeros(shape)
        for robot, motion in self.held.items():
            self.fixed[robot, -1] = motion.duration
        lower, upper = np.zeros(shape), np.full(shape, task.longest)
        for w in range(1, self.size - 1, 3):
            lower[:, [w, w + 1]], upper[:, [w, w + 1]] = fleet.low, fleet.high
        least = np.maximum(least_arrivals(task), _THERE * self.first)
        lower[:, -1] = least
        waiting = task.staying & (task.arrived > 0.0)
        upper[waiting, -1] = least[waiting]
        upper = np.maximum(upper, lower)
        free = np.broadcast_to(self.varied[:, None], shape).copy()
        free[task.staying & ~kept, -1] = True
        self.free = np.flatnonzero(free.ravel())
        self.all_free = bool(free.all())
        self.lower, self.upper = self.reduce(lower), self.reduce(upper)

    def full(self, xi: Array) -> Array:
        """Parameters x (n, v) in SI units of every robot."""
        x = self.fixed.ravel().copy()
        x[self.free] = xi * self.units.ravel()[self.free]
        return x.reshape(self.fixed.shape)

    def reduce(self, x: Array) -> Array:
        """Take the free parameters of x (n, v), scaled."""
        return np.asarray((x / self.units).ravel()[self.free])

    def evaluate(self, xi: Array) -> Point:
        """Return the performance index, relative to a typical one, and the worst violation."""
        n = self.task.n
        self.evaluations += 1
        x, burns = self.full(xi), self._burns.copy()
        slopes = np.zeros((n, self.count, 4, self.size))
        margins = np.ones((n, self.count + 2))
        found = np.zeros((16 + n * len(burns), COLUMNS))
        count, gas, worst = evaluate(x, self.fleet, burns, slopes, margins, found)
        values = ArcPoint(x, burns, slopes, margins, found[:count])
        first, late = self._arrivals(x)
        time, sequence, gas_weight = self.weights
        cost = time * first + sequence * np.abs(late).sum() + gas_weight * gas
        return Point(xi, float(cost), np.array([max(0.0, -worst)]), values)

    def _arrivals(self, x: Array) -> tuple[float, Array]:
        """Return when the first robot arrives, and by how much the others are off (n-1,)."""
        arrivals = x[:, -1] - self.task.arrived
        return float(arrivals[0]), arrivals[1:] - arrivals[:-1] - self.task.interval

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Exact first derivatives; Hessian of the gas, made positive definite."""
        n, v = self.task.n, self.size
        values: ArcPoint = point.cache
        most = len(values.approaches) + values.margins.size
        gradient, hessian = np.zeros((n, v)), np.zeros((n, v, n, v))
        rows, margins = np.zeros((most, n, v)), np.zeros(most)
        count = derivatives(
            values.x, self.fleet, values.burns, values.slopes, values.margins, values.approaches,
            self.weights[2], gradient, hessian, rows, margins,
        )  # fmt: skip
        gradient[0, -1] += self.weights[0] * self.units[0, -1]
        curvature, jacobian = hessian.reshape(n * v, n * v), rows[:count].reshape(count, n * v)
        if not self.all_free:
            curvature = curvature[np.ix_(self.free, self.free)]
            gradient, jacobian = gradient.ravel()[self.free], jacobian[:, self.free]
        return Linearisation(
            gradient=gradient.ravel(),
            hessian=curvature,
            equalities=np.zeros(0),
            equality_jacobian=np.zeros((0, self.free.size)),
            inequalities=margins[:count],
            inequality_jacobian=jacobian,
            inequality_groups=np.zeros(count, dtype=np.intp),
            terms=self._arrivals(values.x)[1],
            terms_jacobian=self._intervals,
            term_weights=np.full(n - 1, self.weights[1]),
        )

    def crowded(self, point: Point) -> bool:
        """Whether a separation binds, so that other sides to pass on may be cheaper."""
        return bool(point.cache.closeness.min(initial=1.0) < _KEPT)

    def binding(self, point: Point) -> str:
        """Name what is violated most at `point`, in words."""
        values: ArcPoint = point.cache
        names = self.task.names
        worst = int(np.argmin(values.margins.min(axis=1)))
        if values.closeness.min(initial=np.inf) > values.margins[worst].min():
            return f"the time that the thruster of '{names[worst]}' needs between burns"
        one, other = values.approaches[int(np.argmin(values.closeness)), :2].astype(int)
        if other >= len(names):
            return f"the distance of '{names[one]}' from keep-out zones or staying robots"
        return f"arena.minimum_separation of '{names[one]}' and '{names[other]}'"
