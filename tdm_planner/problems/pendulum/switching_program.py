# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The swing-up as the nonlinear program (10): the varied parameters are the switching times.

Xi = w0 (d_1, ..., d_K), the durations of arcs of constant torque; J = sum Xi. The
argument tau is time itself: torque and initial state already determine the motion, so that the
states follow by integration and the terminal conditions become equalities,

    (theta - 2 pi n, psi, theta'/w0, psi'/w0) = 0 at the end,  |psi| <= psi_max along every arc.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from tdm_planner.arrays import Array, Integers, Mask
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.plants.compilation import compiled
from tdm_planner.plants.pendulum_kernels import (
    ALL,
    derivative,
    LANES,
    MOST_STEPS,
    quick_time,
    roll_arcs,
    roll_lanes,
    runge_kutta,
)
from tdm_planner.plants.rotary_pendulum import Coefficients

_MESH_STEP = 0.2  # of `quick_time`: steps in which a motion is looked at for a mesh
DIFFERENCE = 1e-5  # step of the directional differences of the Jacobian
SMALLEST_CURVATURE = 2e-2
_SIDE_BY_SIDE = 4  # directions from which it takes less time to look at them together
NEAR_LIMIT = 0.3  # [rad] from psi_max within which an arc's peak gets a row
_ACTIVE = 2e-3  # [rad] from the disk's limit, of a peak that counts as at it


class SwitchingData(NamedTuple):
    """
    The program for one sequence of torques.

    `k` the plant's coefficients, `start` (4,), `torques` (K,) [N m], `goal` 2 pi n,
    `disk_angle` the limit of |psi| [rad], `counts` (K,) and `mesh` (n,) the RK4 steps of the arcs.
    """

    k: Coefficients
    start: Array
    torques: Array
    goal: float
    disk_angle: float
    w0: float
    counts: Integers
    mesh: Array


class ArcPoint(NamedTuple):
    """
    The program's values at `xi` (K,).

    `cost`; `ends` and `beyond`, the violations; `residual` (4,) of the ends with its `jacobian`
    (4, K), `margins` (K,) of the arcs' peaks with `slopes` (K, K), infinite if far from the limit.
    """

    xi: Array
    cost: float
    ends: float
    beyond: float
    residual: Array
    jacobian: Array
    margins: Array
    slopes: Array


@compiled
def mesh_of_arcs(
    k: Coefficients, start: Array, durations: Array, torques: Array, fewest: int, share: float
) -> tuple[Integers, Array]:
    """
    Return where to step in arcs: the numbers of steps (K,), and (n,) shares of arcs' durations.

    A step is no longer than that share of `quick_time`, nor than a `fewest`-th of its arc.
    """
    counts, mesh = np.full(durations.size, fewest), np.empty(durations.size * MOST_STEPS)
    times, steps = np.zeros(MOST_STEPS + 1), np.zeros(MOST_STEPS + 1)  # from the arc's beginning
    theta, w, v, filled = start[0], start[2], start[3], 0
    for arc in range(durations.size):
        duration, last = durations[arc], 0
        quick, longest = quick_time(k, theta, w, v), duration / fewest
        while times[last] < duration:
            left, h = duration - times[last], min(_MESH_STEP * quick, longest)
            h = h if h < ALL * left and last < MOST_STEPS - 1 else left
            theta, _, w, v = runge_kutta(k, theta, w, v, torques[arc], h)
            before, quick = quick, quick_time(k, theta, w, v)
            steps[last + 1] = steps[last] + h / min(share * min(before, quick), longest)
            last += 1
            times[last] = times[last - 1] + h if h < left else duration
        if last > 0 and steps[last] < np.inf:
            counts[arc] = math.ceil(min(ALL * steps[last], MOST_STEPS))
        n, node, reached = counts[arc], 0, 0.0
        for step in range(1, n + 1):
            time = step / n
            if last > 0 and steps[last] < np.inf and step < n:
                wanted = time * steps[last]
                while steps[node + 1] < wanted:
                    node += 1
                part = (wanted - steps[node]) / (steps[node + 1] - steps[node])
                time = (times[node] + part * (times[node + 1] - times[node])) / duration
            mesh[filled], reached = time - reached, time
            filled += 1
    return counts, mesh[:filled]


@compiled
def evaluate_arcs(program: SwitchingData, xi: Array) -> ArcPoint:
    """Integrate the motion, with derivatives; infinitely bad where it runs away."""
    arcs, w0, counts, mesh = xi.size, program.w0, program.counts, program.mesh
    durations = xi / w0
    states, within, begins = roll_arcs(
        program.k, program.start, durations, program.torques, counts, mesh
    )
    residual, jacobian = states[-1].copy(), begins[-1] / w0
    residual[0] -= program.goal
    residual[2:] /= w0
    jacobian[2:] /= w0
    ends, highest = np.abs(residual).max(), np.abs(states[1:, 1]).max()
    margins, slopes, beyond = np.full(arcs, np.inf), np.zeros((arcs, arcs)), 0.0
    if not highest < program.disk_angle - NEAR_LIMIT:
        first = 0
        for arc in range(arcs):
            nodes = first, first + counts[arc]
            height = _peak(
                states, within, begins, arc, nodes, durations[arc], mesh, w0, slopes[arc]
            )
            margins[arc] = program.disk_angle - height
            beyond, first = max(beyond, -margins[arc]), nodes[1]
    if not ends + highest < np.inf:
        ends = beyond = np.inf
    return ArcPoint(xi, xi.sum(), ends, beyond, residual, jacobian, margins, slopes)


@compiled
def _peak(
    states: Array,
    within: Array,
    begins: Array,
    arc: int,
    nodes: tuple[int, int],
    duration: float,
    mesh: Array,
    w0: float,
    slope: Array,
) -> float:
    """Largest |psi| of an arc, of a parabola between nodes; `slope` receives the margin's."""
    first, last = nodes
    node = first + 1
    for other in range(first + 2, last + 1):
        if abs(states[other, 1]) > abs(states[node, 1]):
            node = other
    sign = -1.0 if states[node, 1] < 0.0 else 1.0
    height = sign * states[node, 1]
    left = node if sign * states[node, 3] > 0.0 else node - 1
    right = min(left + 1, last)
    rising, falling = sign * states[left, 3], sign * states[right, 3]
    if not (right > left and rising > 0.0 and falling < 0.0):
        for p in range(arc + 1):
            slope[p] = -sign / w0 * derivative(within, begins, node, arc, 1, p)
        return float(height)
    h, bend = mesh[left] * duration, rising - falling
    height = sign * states[left, 1] + 0.5 * h * rising**2 / bend
    by_rising = 0.5 * h * (2.0 * rising * bend - rising**2) / bend**2
    by_falling = 0.5 * h * rising**2 / bend**2
    own = arc if left > first else arc - 1  # of whose nodes the left one is
    for p in range(arc + 1):
        slope[p] = derivative(within, begins, left, own, 1, p)
        slope[p] += by_rising * derivative(within, begins, left, own, 3, p)
        slope[p] += by_falling * derivative(within, begins, right, arc, 3, p)
        slope[p] *= -sign / w0
    slope[arc] -= 0.5 * rising**2 / bend * mesh[left] / w0
    return float(height)


@compiled
def _changes_side_by_side(program: SwitchingData, xi: Array, along: Array, duals: Array) -> Array:
    """Change (n, K) of the slopes of `duals` times the ends along (n, K); the last lane stays."""
    arcs, w0 = xi.size, program.w0
    durations, torques = np.empty((arcs, LANES)), np.empty((arcs, LANES))
    state, derivatives = np.empty(4 * LANES), np.empty((arcs, 4 * LANES))
    parts = state.reshape(4, LANES)
    peaks, peak_slopes = np.empty((arcs, LANES)), np.empty((arcs, arcs, LANES))
    change = np.empty(along.shape)
    for first in range(0, len(along), LANES - 1):
        count = min(LANES - 1, len(along) - first)
        for p in range(arcs):
            torques[p], durations[p] = program.torques[p], xi[p] / w0
            for lane in range(count):
                durations[p, lane] += DIFFERENCE * along[first + lane, p] / w0
        for m in range(4):
            parts[m] = program.start[m]
        roll_lanes(
            program.k, durations, torques, arcs, program.counts, program.mesh, math.inf, state,
            derivatives, peaks, peak_slopes,
        )  # fmt: skip
        for p in range(arcs):
            for lane in range(count):
                total = 0.0
                for m in range(4):
                    n, unit = m * LANES, (w0 if m < 2 else w0 * w0) * DIFFERENCE
                    further = derivatives[p, n + lane] - derivatives[p, n + LANES - 1]
                    total += duals[m] / unit * further
                change[first + lane, p] = total
    return change


@compiled
def curvature(program: SwitchingData, point: ArcPoint, duals: Array) -> Array:
    """Hessian of the Lagrangian along the end conditions, by directional differences."""
    arcs = point.xi.size
    basis = np.linalg.svd(point.jacobian)[2]
    across, along = np.ascontiguousarray(basis[:4]), np.ascontiguousarray(basis[4:])
    hessian: Array = SMALLEST_CURVATURE * (across.T @ across)
    free = arcs - 4
    if free <= 0:
        return hessian
    if free < _SIDE_BY_SIDE:
        moved, gradients = point.xi + DIFFERENCE * along, np.empty((free, arcs))
        for b in range(free):
            gradients[b] = duals @ evaluate_arcs(program, moved[b]).jacobian
        change = (gradients - duals @ point.jacobian) / DIFFERENCE
    else:
        change = _changes_side_by_side(program, point.xi, along, duals)
    reduced = change @ along.T
    values, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
    directions = np.ascontiguousarray(vectors.T) @ along
    for b in range(free):
        size = max(abs(values[b]), SMALLEST_CURVATURE)
        hessian += size * np.outer(directions[b], directions[b])
    return hessian


def lagrangian_slopes(point: ArcPoint, there: Mask) -> Array:
    """
    Return dL/dxi (K,), by multipliers with which it is nearest to zero for the arcs `there`.

    These are lambda of the ends and mu >= 0 of the disk's limit. By an empty arc of the opposite
    torque the derivative is

        dL/dxi = 1 + lambda d(ends)/dxi - mu d(margins)/dxi,

    the Hamiltonian of the minimum principle under that torque. Where it is negative the torque has
    the wrong sign, and an arc begun there shortens the swing-up.
    """
    active = np.flatnonzero(point.margins < _ACTIVE)
    while True:
        rows = np.concatenate([point.jacobian, -point.slopes[active]])
        multipliers = np.linalg.lstsq(rows[:, there].T, -np.ones(there.sum()), rcond=1e-6)[0]
        pushed = multipliers[4:] >= 0.0
        if pushed.all():
            slopes: Array = 1.0 + multipliers @ rows
            return slopes
        active = active[pushed]


class SwitchingProgram(NonlinearProgram):
    """The program as the minimiser asks for it: group 0 are the ends, group 1 the disk's limit."""

    def __init__(self, arcs: SwitchingData) -> None:
        self._arcs, count = arcs, arcs.torques.size
        self.lower, self.upper = np.zeros(count), np.full(count, np.inf)

    def evaluate(self, xi: Array) -> Point:
        """Return the time and the violations at the durations `xi` (K,), times w0."""
        at = evaluate_arcs(self._arcs, xi)
        violations = np.array([at.ends, at.beyond])
        return Point(xi, at.cost, violations, at, at.residual, at.margins)

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Return slopes of ends and of the peaks near the limit, and the reduced Hessian."""
        at: ArcPoint = point.cache
        duals = np.zeros(4) if multipliers is None else multipliers.equalities
        near = np.flatnonzero((at.margins < NEAR_LIMIT) & (at.xi > 0.0))
        return Linearisation(
            gradient=np.ones(at.xi.size),
            hessian=curvature(self._arcs, at, duals),
            equalities=at.residual,
            equality_jacobian=at.jacobian,
            inequalities=at.margins[near],
            inequality_jacobian=at.slopes[near],
            inequality_groups=np.ones(near.size, np.intp),
            tags=near,
            evaluations=max(at.xi.size - 4, 0),  # the Hessian differences along so many directions
        )
