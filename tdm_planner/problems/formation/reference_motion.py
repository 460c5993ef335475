# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Reference functions of the robots: position and attitude as polynomials of the virtual arc.

On the unit arc s in [0, 1] a robot's coordinates are X(s) = X_b(s) + sum_k q_k phi_k(s): X_b takes
the boundary conditions that are given, phi_k span the polynomials that change none of them, which
are those of the end derivatives that are varied. They are orthonormal in the inner product of
their second derivatives, for the sake of conditioning. A polynomial is kept as all of its end
derivatives, those at s = 0 first, so that `PolynomialBasis` evaluates it.

Time runs along the arc as dt/ds = mu(s) = sum_k b_k B_k(s) > 0, a polynomial in Bernstein's form:
with the virtual arc's length tau_f the speed factor of section 2 is lambda = tau_f / mu. Degree 0
is tau = t, and b_0 the time the manoeuvre takes. A velocity v and an acceleration a at an end
become X_s = mu v and X_ss = mu^2 a + mu_s v. With N = X_ss mu - X_s mu_s the exact inverse, in
place of (21) and (27), which lose the speed factor's slope, is

    X' = X_s / mu,   X'' = N / mu^3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bases import orthonormal, PolynomialBasis
from tdm_planner.direct_method.virtual_arc import bernstein_basis
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.problems.formation.task import FormationTask

Array = NDArray[np.float64]

_YAW_SCALE = 10.0
_NODES = 24  # of the quadrature of a fit
_NEWTON_STEPS, _MOST_STEPS = 12, 80  # of the inversion of time


@inlined
def acceleration(mu: Any, mu_s: Any, first: Any, second: Any) -> Any:
    """Return X'' from derivatives by s."""
    return (second * mu - first * mu_s) / (mu * mu**2)


@dataclass(frozen=True, eq=False)
class EndDerivatives:
    """
    The polynomials of one coordinate, determined by as many derivatives at either end.

    `basis` evaluates them; `free` (order + 1, nf) holds the end derivatives of the phi_k.
    """

    basis: PolynomialBasis
    free: Array

    @property
    def goal(self) -> int:
        """Where the value at s = 1 is among the end derivatives."""
        return len(self.basis.start)


@lru_cache(maxsize=32)
def end_derivatives(order: int, vary_curvature: bool) -> EndDerivatives:
    """Make the polynomials of odd order >= 5; `vary_curvature`: X_ss is varied at both ends."""
    given = (0, 1) if vary_curvature else (0, 1, 2)
    basis = PolynomialBasis.raised(given, given, order + 1 - 2 * len(given))
    varied = [k not in given for k in (*basis.start, *basis.end)]
    free = np.zeros((order + 1, sum(varied)))
    shapes = orthonormal(
        lambda s, derivative: basis.values(s, derivative)[..., varied], 2 * len(given), (2,)
    )
    free[varied] = shapes * np.sign(np.diag(shapes))  # whichever signs LAPACK chose
    free.flags.writeable = False
    return EndDerivatives(basis, free)


@lru_cache(maxsize=8)
def passing(degree: int) -> Array:
    """Powers of s (q + 1, q + 2) in the time at s, by b: integrals of Bernstein's polynomials."""
    powers = np.zeros((degree + 1, degree + 2))
    for k in range(degree + 1):
        for j in range(degree - k + 1):
            power = k + j + 1
            choices = math.comb(degree, k) * math.comb(degree - k, j)
            powers[k, power] = (-1) ** j * choices / power
    powers.flags.writeable = False
    return powers


class MotionForm(NamedTuple):
    """
    The reference functions' form.

    Orders of the polynomials of x and y, and of the attitude's; degree of mu; whether the
    accelerations at the ends are varied, not given; number of nodes, None: as `order` needs.
    """

    order: int = 7
    yaw_order: int = 5
    degree: int = 0
    vary_ends: bool = True
    nodes: int | None = None

    @property
    def points(self) -> int:
        """Return the number of nodes at which limits are kept and gas is summed."""
        return self.nodes or max(21, 5 * self.order - 14)

    def of_order(self, order: int) -> MotionForm:
        """Return the form with polynomials of another order, on as many nodes as that needs."""
        return self if order == self.order else self._replace(order=order, nodes=None)


DEFAULT_FORM: Final = MotionForm()


class MotionTables(NamedTuple):
    """
    What the end derivatives of n robots' polynomials follow from, see `unpacked`.

    `shapes` (m, nf) and `turns` (my, ny) are end derivatives of the varied shapes of x and y and
    of yaw, `fixed` (n, 2, m) and `fixed_yaw` (n, my) what is given of them. The start's `velocity`
    and `acceleration` (n, 3) are those of x, y and yaw, the latter `given` (3,): 1, or 0 where it
    is varied. `slope` (q + 1,) is mu_s at the start, by b.
    """

    shapes: Array
    turns: Array
    fixed: Array
    fixed_yaw: Array
    velocity: Array
    acceleration: Array
    given: Array
    slope: Array


@compiled
def unpacked(t: MotionTables, x: Array) -> tuple[Array, Array]:
    """End derivatives by s, (n, 2, m) and (n, my), at the varied parameters x (n, P)."""
    position, yaw, nb = t.fixed.copy(), t.fixed_yaw.copy(), t.slope.size
    for i in range(len(x)):
        mu, slope = x[i, 0], 0.0
        for k in range(nb):
            slope += t.slope[k] * x[i, k]
        first = nb
        for axis in range(3):
            end, shapes = (position[i, axis], t.shapes) if axis < 2 else (yaw[i], t.turns)
            end[1] += mu * t.velocity[i, axis]
            departing = mu**2 * t.acceleration[i, axis] + slope * t.velocity[i, axis]
            end[2] += t.given[axis] * departing
            for j in range(end.size):
                for q in range(shapes.shape[1]):
                    end[j] += shapes[j, q] * x[i, first + q]
            first += shapes.shape[1]
    return position, yaw


@compiled
def powers_at(coefficients: Array, u: float) -> tuple[float, float, float]:
    """Value at u of the polynomial with these coefficients of its powers, and two derivatives."""
    value, first, second = 0.0, 0.0, 0.0
    for k in range(coefficients.size - 1, -1, -1):
        second = second * u + first
        first = first * u + value
        value = value * u + coefficients[k]
    return value, first, 2.0 * second


@compiled
def arc_at(times: Array, duration: float, since: float) -> float:
    """
    Return s in [0, 1] at which a time that rises with s, of powers `times`, is `since` [s].

    By Newton's method in a bracket.
    """
    s = min(max(since / duration, 0.0), 1.0)
    low, high = 0.0, 1.0
    if times.size == 2 or s == 0.0 or s == 1.0:
        return s
    for step in range(_MOST_STEPS):
        time, mu, _ = powers_at(times, s)
        error = time - since
        if abs(error) <= 1e-15 * duration:
            break
        if error < 0.0:
            low = s
        else:
            high = s
        last, s = s, s - error / mu
        if not low <= s <= high or (step >= _NEWTON_STEPS and step % 3 == 2):
            s = 0.5 * (low + high)
        if s == last:
            break
    return s


@compiled
def _arcs_at(times: Array, duration: float, since: Array) -> Array:
    found = np.empty(since.size)
    for k in range(since.size):
        found[k] = arc_at(times, duration, since[k])
    return found


@dataclass(frozen=True, eq=False)
class FormationMotion:
    """
    The motions of all robots at one set of varied parameters.

    `rates` (n, q + 1): the coefficients b of mu [s]; `position` (n, 2, order + 1) and `yaw`
    (n, yaw order + 1): end derivatives by s.
    """

    rates: Array
    position: Array
    yaw: Array

    @property
    def durations(self) -> Array:
        """Time each manoeuvre takes, without coasting (n,) s: the integral of mu."""
        return np.asarray(self.rates.mean(axis=1))


class ReferenceMotion:
    """
    Map from a robot's varied parameters (P,) to its motion, for all n robots at once.

    The varied parameters of one robot are b (q + 1), q of x (nf), of y (nf), of yaw (ny); they
    are scaled by `units` (P,).
    """

    def __init__(self, task: FormationTask, form: MotionForm = DEFAULT_FORM) -> None:
        self.task, self.form = task, form
        self.basis = end_derivatives(form.order, form.vary_ends)
        self.yaw_basis = end_derivatives(form.yaw_order, False)
        self.nb, self.nf = form.degree + 1, self.basis.free.shape[1]
        self.ny = self.yaw_basis.free.shape[1]
        self.size = self.nb + 2 * self.nf + self.ny
        way = np.linalg.norm(task.goal - task.departure, axis=1)
        speed = float(np.linalg.norm(task.velocity, axis=1).max())
        longest = max(float(way.max()), task.separation)
        self.time = max(2.4 * math.sqrt(longest / task.thrust), speed / task.thrust)
        self.units = np.repeat(
            [self.time, 10.0 * longest, _YAW_SCALE], [self.nb, 2 * self.nf, self.ny]
        )
        fixed = np.zeros((task.n, 2, form.order + 1))
        fixed[..., 0], fixed[..., self.basis.goal] = task.departure, task.goal
        fixed_yaw = np.zeros((task.n, form.yaw_order + 1))
        fixed_yaw[:, 0], fixed_yaw[:, self.yaw_basis.goal] = task.departure_yaw, task.goal_yaw
        self.tables = MotionTables(
            shapes=self.basis.free,
            turns=self.yaw_basis.free,
            fixed=fixed,
            fixed_yaw=fixed_yaw,
            velocity=np.column_stack([task.velocity, task.yaw_rate]),
            acceleration=np.column_stack([task.acceleration, task.yaw_acceleration]),
            given=np.array([1.0 - form.vary_ends, 1.0 - form.vary_ends, 1.0]),
            slope=bernstein_basis(form.degree, 0.0, 1),
        )

    def with_task(self, task: FormationTask) -> ReferenceMotion:
        """Return the same reference functions for another manoeuvre."""
        return ReferenceMotion(task, self.form)

    def fit(self, b: Array, bend: Callable[[Array], Array]) -> Array:
        """
        Varied parameters (n, P) of rates b (n, q + 1) s whose motions bend most as wanted.

        `bend` gives the second derivatives (n, 2, K) at arcs s (K,). The yaw is at rest.
        """
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        s, nb = (nodes + 1) / 2, self.nb
        x = np.zeros((len(b), self.size))
        x[:, :nb] = b
        curvature = self.basis.basis.values(s, 2)
        missed = (bend(s) - self.unpack(x).position @ curvature.T) * (weights / 2)
        shape, last = missed @ (curvature @ self.basis.free), self.size - self.ny
        x[:, nb:last] = shape.reshape(len(b), -1)
        return x

    def raise_order(self, low: ReferenceMotion, x: Array) -> Array:
        """Varied parameters (n, P) of the same motions as `low` with x, of lower order, has."""
        motion = low.unpack(x)
        curvature = low.basis.basis.values
        raised = self.fit(motion.rates, lambda s: motion.position @ curvature(s, 2).T)
        own, its = self.size - self.ny, low.size - low.ny
        raised[:, own:] = x[:, its:]
        return raised

    def unpack(self, x: Array) -> FormationMotion:
        """Motions at the varied parameters x (n, P)."""
        return FormationMotion(x[:, : self.nb], *unpacked(self.tables, x))

    def speed(self, motion: FormationMotion, robot: int, s: Array) -> list[Array]:
        """Return mu and mu_s of a robot at arcs s (K,)."""
        b = motion.rates[robot]
        return [bernstein_basis(self.form.degree, s, d) @ b for d in range(2)]

    def arcs_at(self, motion: FormationMotion, robot: int, t: Array) -> Array:
        """Arc s in [0, 1] of a robot at instants t (K,) s."""
        times, duration = motion.rates[robot] @ passing(self.form.degree), motion.durations[robot]
        return _arcs_at(times, float(duration), t - self.task.coast[robot])
