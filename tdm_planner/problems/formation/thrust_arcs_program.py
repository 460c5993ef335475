# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The program of robots that fly rounded polylines: exact gas.

Varied are, of every robot, the start of its first burn, corners and their instants, and the
arrival; goals are reached exactly whatever they are, see `thrust_arcs_kernels`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Multipliers
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.formation.approaches import approach_rows, approaches, CLOSENESS
from tdm_planner.problems.formation.program import FormationProgram
from tdm_planner.problems.formation.task import first_arrival, FormationTask, least_time
from tdm_planner.problems.formation.thrust_arcs_kernels import (
    add_slope,
    Fleet,
    own_margins,
    own_slopes,
    place,
    round_off,
    smoothing,
)

Array = NDArray[np.float64]

RATE_SHARE = 0.97  # of the thruster's rate, with which turns are reckoned
_SPEED = 0.02  # of a typical speed, by which |p| is rounded off
_NEAR = 0.3  # own margins below which they make a row
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


def least_arrivals(task: FormationTask) -> Array:
    """Earliest arrivals (n,) s that torque, and a thruster that holds its direction, allow."""
    turn = task.goal_yaw - task.yaw
    held = 2.0 * np.abs(turn) / (RATE_SHARE * task.thruster_rate)
    return np.maximum(least_time(turn, task.yaw_rate, 0.999 * task.torque), held)


@compiled
def _place(motion: tuple[Fleet, Array], i: int, t: float, found: Array) -> None:
    fleet, burns = motion
    place(t, fleet.start[i], fleet.velocity[i], burns[i], found)


@compiled
def _add_slope(motion: tuple[Array, Array], i: int, t: float, along: Array, row: Array) -> None:
    burns, slopes = motion
    add_slope(t, burns[i], slopes[i], along, row)


@compiled
def evaluate(
    x: Array, fleet: Fleet, burns: Array, slopes: Array, margins: Array, found: Array
) -> tuple[int, float, float]:
    """
    Burns, own margins and approaches at the varied parameters x (n, v).

    Returns the number of approaches, all gas, rounded off at zero, and the least margin. `burns`
    (N, m, 4) of what is not varied are left as they are.
    """
    n, m = len(x), burns.shape[1]
    last, gas, worst = 0.0, 0.0, 1.0
    for i in range(n):
        last = max(last, x[i, x.shape[1] - 1])
        if not fleet.varied[i]:
            continue
        round_off(x[i], fleet, i, burns[i], slopes[i])
        for k in range(m):
            e = smoothing(fleet, i, k, m)
            gas += math.sqrt(burns[i, k, 0] ** 2 + burns[i, k, 1] ** 2 + e * e) - e
        own_margins(x[i], fleet, i, burns[i], margins[i])
        worst = min(worst, margins[i].min())
    count = approaches(_place, (fleet, burns), fleet.clearances, last, fleet.interval, found)
    for r in range(count):
        worst = min(worst, found[r, CLOSENESS])
    return count, gas, worst


@compiled
def derivatives(
    x: Array,
    fleet: Fleet,
    burns: Array,
    slopes: Array,
    margins: Array,
    found: Array,
    weight: float,
    gradient: Array,
    hessian: Array,
    rows: Array,
    values: Array,
) -> int:
    """
    Slopes of `weight` times the gas, (n, v) and (n, v, v), and of rows (r, n, v).

    The rows are those of the approaches `found`, then those of own margins near active; `values`
    (r,) are the margins. Returns how many rows there are.
    """
    n, v = x.shape
    m = margins.shape[1]
    by, count = np.zeros((m, v)), len(found)
    approach_rows(_add_slope, (burns, slopes), fleet.varied, fleet.clearances, found, rows, values)
    for i in range(n):
        if not fleet.varied[i]:
            continue
        own_slopes(x[i], fleet, i, slopes[i], burns[i], gradient[i], hessian[i], by)
        for k in range(m):
            if margins[i, k] < _NEAR:
                values[count] = margins[i, k]
                rows[count, i] = by[k]
                count += 1
        gradient[i] *= weight
        hessian[i] *= weight
    return count


class ArcProgram(FormationProgram):
    """
    The program of one manoeuvre with `count` burns a robot.

    Robots that stay vary their arrival only, and `held` ones nothing.
    """

    curvature = 2e-3, 0.0

    def __init__(
        self, task: FormationTask, count: int = 3, held: Mapping[int, HeldMotion] | None = None
    ) -> None:
        self.count, self.held = count, held or {}
        first = first_arrival(task, least_arrivals(task), task.thrust)
        self.length, self.time = 1.25 * float(task.separation), 0.25 * first
        corner = [self.length, self.length, self.time]
        units = np.tile([self.time, *(corner * (count - 2)), self.time], (task.n, 1))
        units[task.staying, -1] *= _FREELY  # nothing bends along with these
        last = np.arange(units.shape[1]) == units.shape[1] - 1
        kept = np.isin(np.arange(task.n), list(self.held))
        super().__init__(task, first, units, 1.0 * last, last, kept)
        self._set_fleet()
        self._set_bounds()

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
            clearances=self.clearances,
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
            length=self.length,
            time=self.time,
            interval=self.interval,
        )

    def _set_bounds(self) -> None:
        task, fleet, shape = self.task, self.fleet, self.units.shape
        fixed = np.zeros(shape)
        for robot, motion in self.held.items():
            fixed[robot, -1] = motion.duration
        lower, upper = np.zeros(shape), np.full(shape, task.longest)
        for w in range(1, self.size - 1, 3):
            lower[:, [w, w + 1]], upper[:, [w, w + 1]] = fleet.low, fleet.high
        lower[:, -1] = np.maximum(least_arrivals(task), _THERE * self.first)
        waiting = task.staying & (task.arrived > 0.0)
        upper[waiting, -1] = lower[waiting, -1]
        self.bound(lower, upper, fixed)

    def fly(self, x: Array, found: Array) -> tuple[ArcPoint, float, float]:
        """Return burns and approaches, all gas and the worst margin."""
        burns = self._burns.copy()
        slopes = np.zeros((self.task.n, self.count, 4, self.size))
        margins = np.ones((self.task.n, self.count + 2))
        count, gas, worst = evaluate(x, self.fleet, burns, slopes, margins, found)
        return ArcPoint(x, burns, slopes, margins, found[:count]), gas, worst

    def derive(
        self, flown: ArcPoint, multipliers: Multipliers | None
    ) -> tuple[Array, Array, Array, Array, None]:
        """Differentiate gas, the distances of approaches, and own margins near active."""
        n, v = flown.x.shape
        most = len(flown.approaches) + flown.margins.size
        gradient, hessian = np.zeros((n, v)), np.zeros((n, v, v))
        rows, margins = np.zeros((most, n, v)), np.zeros(most)
        count = derivatives(
            flown.x, self.fleet, flown.burns, flown.slopes, flown.margins, flown.approaches,
            self.weights[2], gradient, hessian, rows, margins,
        )  # fmt: skip
        return gradient, hessian, margins[:count], rows[:count], None

    def own_margins(self, flown: ArcPoint) -> dict[str, Array]:
        """Margins of what the thruster needs, and of robots that fly towards a wall."""
        return {"the time that the thruster of '{}' needs between burns": flown.margins}
