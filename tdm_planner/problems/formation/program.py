# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The nonlinear program of section 4.2, whatever form the motions have: performance index (28).

A form of motion brings its varied parameters, the gas they use, and the limits of every robot;
arrivals, their intervals and the distances of robots at equal times (19) are the same for all.
Polynomials of the virtual arc are one such form.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.problems.formation.approaches import CLOSENESS, COLUMNS, scaled
from tdm_planner.problems.formation.polynomial_kernels import (
    ACTIVE_THRUST,
    derivatives,
    evaluate,
    grid_of,
    Manoeuvre,
    Values,
)
from tdm_planner.problems.formation.reference_motion import FormationMotion, ReferenceMotion
from tdm_planner.problems.formation.task import first_arrival, FormationTask, least_time

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_INSTANTS = 80  # in a typical manoeuvre, between which approaches are looked for
_KEPT = 2e-3  # margin of a separation that is not active
_USED = 0.67  # of F_max, assumed by an initial guess: polynomials seldom give more


class FormationProgram(NonlinearProgram):
    """
    The program of one manoeuvre in the scaled varied parameters that are free, Xi (m,).

    A robot has parameters x (n, P), in `units` (n, P) of the same shape; it arrives `coast` plus
    x @ `arriving` (P,) s after the start. Where robots are `kept` (n,) nothing is varied, `fixed`
    (n, P) holds their x; robots that stay vary what `turning` (P,) marks. Violations count
    relative to their limits. `first` [s] is when the first robot may well arrive, `scale` a
    typical J, by which the cost is divided.
    """

    curvature: ClassVar[tuple[float, float]]  # least eigenvalue of a robot's Hessian, and share

    def __init__(
        self,
        task: FormationTask,
        first: float,
        units: Array,
        arriving: Array,
        turning: Mask,
        kept: Mask,
    ) -> None:
        self.task, self.first, self.units, self.size = task, first, units, arriving.size
        self.evaluations = 0
        self.kept, self.varied = kept, ~(task.staying | kept)
        way = np.linalg.norm(task.goal - task.departure, axis=1).sum()
        typical = 2.4 * way / self.first + np.linalg.norm(task.velocity, axis=1).sum()
        self.scale = float(max(task.weights[[0, 2]] @ [self.first, typical], 1e-9))
        self.weights = task.weights / self.scale
        free = np.where(task.staying[:, None], turning, True) & ~kept[:, None]
        self.free = np.flatnonzero(free.ravel())
        self.all_free = bool(free.all())
        self._scales = units * free
        self.clearances = self._clearances()
        self.interval = self.first / _INSTANTS
        arrivals = np.zeros((task.n, task.n, self.size))
        arrivals[np.arange(task.n), np.arange(task.n)] = arriving * units
        arrivals = arrivals.reshape(task.n, -1)[:, self.free]
        self._used = np.flatnonzero(arriving)
        self._speeds = arriving[self._used]
        self._arrived = task.coast - task.arrived
        self._first, self._intervals = self.weights[0] * arrivals[0], np.diff(arrivals, axis=0)

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

    def bound(self, lower: Array, upper: Array, fixed: Array) -> None:
        """Bound the parameters x (n, P), in SI units; `fixed` (n, P) holds those not varied."""
        self.fixed = fixed
        self.lower, self.upper = self.reduce(lower), self.reduce(np.maximum(lower, upper))

    def full(self, xi: Array) -> Array:
        """Parameters x (n, P) in SI units of every robot."""
        x = self.fixed.ravel().copy()
        x[self.free] = xi * self.units.ravel()[self.free]
        return x.reshape(self.fixed.shape)

    def reduce(self, x: Array) -> Array:
        """Take the free parameters of x (n, P), scaled."""
        return np.asarray((x / self.units).ravel()[self.free])

    def durations(self, x: Array) -> Array:
        """Time that every motion takes after its coast, (n,) s."""
        return np.asarray(x[:, self._used] @ self._speeds)

    def usual_durations(self) -> Array:
        """Durations (n,) s of first guesses."""
        task = self.task
        least = self.durations(self.full(self.lower))
        arrivals = self.first + task.interval * np.arange(task.n) + task.arrived - task.coast
        found = np.minimum(np.maximum(arrivals, least), 0.98 * task.longest)
        return np.where(task.staying, least, found)

    @abstractmethod
    def fly(self, x: Array, found: Array) -> tuple[Any, float, float]:
        """
        Return the motions at x (n, P), all gas [m/s] and the worst margin.

        Of the motions `x` and `approaches` (r, 6), a part of `found`, are known to this class.
        """

    @abstractmethod
    def derive(
        self, flown: Any, multipliers: Multipliers | None
    ) -> tuple[Array, Array, Array, Array, Any]:
        """
        Differentiate by x: weighted gas (n, P), (n, P, P); margins near active (r,), (r, n, P).

        The second derivatives may be those of the Lagrangian. At last, the `tags` of the rows.
        """

    @abstractmethod
    def own_margins(self, flown: Any) -> dict[str, Array]:
        """Margins (n, ...) of every robot's own limits, by what violates them in words."""

    def evaluate(self, xi: Array) -> Point:
        """Return the performance index, relative to a typical one, and the worst violation."""
        self.evaluations += 1
        found = np.zeros((16 + self.task.n * len(self.clearances), COLUMNS))
        flown, gas, worst = self.fly(self.full(xi), found)
        first, late = self._late(flown.x)
        time, sequence, gas_weight = self.weights
        cost = time * first + sequence * np.abs(late).sum() + gas_weight * gas
        return Point(xi, float(cost), np.array([max(0.0, -worst)]), flown)

    def _late(self, x: Array) -> tuple[float, Array]:
        """Return when the first robot arrives, and by how much the others are off (n - 1,)."""
        arrivals = self.durations(x) + self._arrived
        return float(arrivals[0]), arrivals[1:] - arrivals[:-1] - self.task.interval

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Exact first derivatives; Hessian of the gas, made positive definite."""
        gradient, blocks, margins, rows, tags = self.derive(point.cache, multipliers)
        curvature = scaled(self._scales, blocks, *self.curvature, rows)
        jacobian = rows.reshape(margins.size, gradient.size)
        gradient = (self._scales * gradient).ravel()
        if not self.all_free:
            curvature = curvature[np.ix_(self.free, self.free)]
            gradient, jacobian = gradient[self.free], jacobian[:, self.free]
        return Linearisation(
            gradient=gradient + self._first,
            hessian=curvature,
            equalities=np.zeros(0),
            equality_jacobian=np.zeros((0, self.free.size)),
            inequalities=margins,
            inequality_jacobian=jacobian,
            inequality_groups=np.zeros(margins.size, dtype=np.intp),
            terms=self._late(point.cache.x)[1],
            terms_jacobian=self._intervals,
            term_weights=np.full(self.task.n - 1, self.weights[1]),
            tags=tags,
        )

    def crowded(self, point: Point) -> bool:
        """Whether a separation binds, so that other sides to pass on may be cheaper."""
        return bool(point.cache.approaches[:, CLOSENESS].min(initial=1.0) < _KEPT)

    def binding(self, point: Point) -> str:
        """Name what is violated most at `point`, in words."""
        names, approaches = self.task.names, point.cache.approaches
        found = {}
        for label, margins in self.own_margins(point.cache).items():
            worst = margins.reshape(len(names), -1).min(axis=1)
            found[label.format(names[int(np.argmin(worst))])] = float(worst.min())
        if len(approaches):
            nearest = approaches[int(np.argmin(approaches[:, CLOSENESS]))]
            one, other = nearest[:2].astype(int)
            label = f"the distance of '{names[one]}' from keep-out zones or staying robots"
            if other < len(names):
                label = f"arena.minimum_separation of '{names[one]}' and '{names[other]}'"
            found[label] = float(nearest[CLOSENESS])
        return min(found, key=lambda label: found[label])


class PolynomialProgram(FormationProgram):
    """
    The program of one manoeuvre by the reference motions of `model`.

    Staying robots have only their times (and attitudes) varied. `held` (n, P) holds the
    parameters of robots whose motion is not varied but avoided by the others, NaN for those of
    the others.
    """

    curvature = 1e-6, 1e-3

    def __init__(self, model: ReferenceMotion, held: Array | None = None) -> None:
        self.model, task, nb = model, model.task, model.nb
        self.held = np.full((task.n, model.size), np.nan) if held is None else held
        turn = least_time(task.goal_yaw - task.departure_yaw, task.yaw_rate, task.torque)
        number = np.arange(model.size)
        super().__init__(
            task,
            first_arrival(task, turn, _USED * task.thrust),
            np.tile(model.units, (task.n, 1)),
            np.where(number < nb, 1.0 / nb, 0.0),
            (number < nb) | (number >= model.size - model.ny),
            ~np.isnan(self.held[:, 0]),
        )
        self._set_bounds()
        walls, (centres, _) = task.wall_clearances(), task.circles()
        self.manoeuvre = Manoeuvre(
            grid=grid_of(model.form),
            motion=model.tables,
            coast=np.ascontiguousarray(task.coast),
            thrust=float(task.thrust),
            torque=float(task.torque),
            low=np.ascontiguousarray(walls[..., 0]),
            high=np.ascontiguousarray(task.sides - walls[..., 1]),
            separation=float(task.separation),
            clearances=self.clearances,
            centres=np.ascontiguousarray(centres),
            interval=self.interval,
            kept=self.kept,
            varied=self.varied,
        )

    def _set_bounds(self) -> None:
        task, model, nb = self.task, self.model, self.model.nb
        lower, upper = (np.full(self.units.shape, sign * np.inf) for sign in (-1.0, 1.0))
        # The speed factor's coefficients must stay positive, and well so.
        lower[:, :nb] = (0.05 if nb == 1 else 0.4) * model.time
        lower[task.staying, :nb] = 0.02 * model.time
        upper[:, :nb] = np.maximum(task.longest - task.coast, 0.1)[:, None]
        upper[task.staying & (task.arrived > 0.0), :nb] = 0.03 * model.time  # there already
        lower = np.minimum(lower, 0.9 * upper)
        self.bound(lower, upper, np.nan_to_num(self.held))

    def motion(self, xi: Array) -> FormationMotion:
        """Return the motions at Xi."""
        return self.model.unpack(self.full(xi))

    def fly(self, x: Array, found: Array) -> tuple[Values, float, float]:
        """Return gas and margins, all gas, and the worst margin."""
        values = evaluate(self.manoeuvre, x, found)
        margins = values.thrust, values.torque, values.walls, values.approaches[:, CLOSENESS]
        worst = min(float(margin.min(initial=1.0)) for margin in margins)
        return values, float(values.gas.sum()), worst

    def derive(
        self, flown: Values, multipliers: Multipliers | None
    ) -> tuple[Array, Array, Array, Array, tuple[NDArray[np.intp], ...]]:
        """Differentiate gas and margins; second derivatives are those of gas and thrust rows."""
        dual = np.zeros(flown.thrust.shape)
        if multipliers is not None:
            robots, nodes = multipliers.tags
            dual[robots, nodes] = multipliers.inequalities[: robots.size]
        found = derivatives(self.manoeuvre, flown, self.weights[2], dual)
        return *found, np.nonzero(flown.thrust < ACTIVE_THRUST)

    def own_margins(self, flown: Values) -> dict[str, Array]:
        """Margins of thrust, torque and walls."""
        return {
            "limits.thrust of '{}'": flown.thrust,
            "limits.torque of '{}'": flown.torque,
            "the distance of '{}' from the walls": flown.walls,
        }


def compile_polynomials(task: FormationTask) -> None:
    """Compile the kernels or load them from the disk."""
    program = PolynomialProgram(ReferenceMotion(task))
    x = np.tile(program.model.units, (task.n, 1))
    program.linearise(program.evaluate(program.reduce(x)), None)
