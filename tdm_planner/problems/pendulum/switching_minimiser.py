# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The minimiser of `direct_method.trust_region`, compiled for programs over switching times.

The same method step by step: one elastic quadratic program a step, with one slack for the ends
and one for the disk's limit, a trust region, second-order corrections. On so few variables Python
takes many times as long as the arithmetic.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget, Point
from tdm_planner.direct_method.trust_region import (
    Minimum,
    PRESSURE,
    SLACK_CURVATURE,
    TrustRegionOptions,
)
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.pendulum.switching_motion import (
    ArcPoint,
    ArcProgram,
    curvature,
    evaluate_arcs,
    first_multipliers,
    NEAR_LIMIT,
)

Array = NDArray[np.float64]

_SMALLEST_RADIUS = 1e-6
_AT_ONCE = 4  # steps between two looks at the clock; one when the end is near
_NEAR = 0.015  # s
# In the quadratic program: of a constraint, relative to its size; and the squared share of its
# gradient that the active ones leave free.
_TOLERANCE, _DEPENDENT = 1e-11, 1e-14
# Places in the array of what the search knows beside the point.
_RADIUS, _ENDS, _LIMIT, _STEPS, _STALLED, _OUTCOME, _ESTIMATED, _EVALUATIONS = range(8)
_GOES_ON, _CONVERGED, _FAILED = 0.0, 1.0, 2.0


class _Step(NamedTuple):
    """A step: change, decrease it predicts, larger slack, multipliers, rows, those active."""

    solved: bool
    change: Array
    predicted: float
    slack: float
    duals: Array
    near: NDArray[np.intp]
    active: NDArray[np.bool_]


def minimise(
    program: ArcProgram,
    xi: Array,
    options: TrustRegionOptions,
    budget: Budget,
) -> Minimum:
    """
    Search as `trust_region.minimise` does.

    The option `steering`, which only other programs need, is not looked at.
    """
    ends, limit = options.penalties
    state = np.array([options.radius, ends, limit, 0.0, 0.0, _GOES_ON, 0.0, 0.0])
    at, duals = np.maximum(xi, 0.0), np.zeros(4)
    while True:
        steps = _AT_ONCE if budget.remaining > _NEAR else 1
        at, cost, ends, limit = advance(program, at, duals, state, options, steps)
        if state[_OUTCOME] != _GOES_ON or state[_STEPS] >= options.iterations or budget.spent:
            break
    budget.evaluations += int(state[_EVALUATIONS])
    point = Point(at, cost, np.array([ends, limit]))
    return Minimum(point, int(state[_STEPS]), bool(state[_OUTCOME] == _CONVERGED), None)


@compiled
def advance(
    program: ArcProgram,
    xi: Array,
    duals: Array,
    state: Array,
    options: TrustRegionOptions,
    steps: int,
) -> tuple[Array, float, float, float]:
    """
    Take up to `steps` steps from `xi` (K,); `duals` (4,) and `state` are brought up to date.

    Returns the point, its cost and both violations.
    """
    point = evaluate_arcs(program, xi)
    state[_EVALUATIONS] += 1
    if not point.cost + point.ends + point.beyond < np.inf:
        state[_OUTCOME] = _FAILED
    hessian, known = np.empty((xi.size, xi.size)), False
    for _ in range(steps):
        if state[_OUTCOME] != _GOES_ON or state[_STEPS] >= options.iterations:
            break
        state[_STEPS] += 1
        if not known:
            if state[_ESTIMATED] == 0.0:
                duals[:] = first_multipliers(point)
            hessian[:, :] = curvature(program, point, duals)
            state[_EVALUATIONS] += max(xi.size - 4, 0)
            known = True
        step = _elastic_step(point, hessian, state)
        if not step.solved:
            known = _shrink(point, state, options, state[_RADIUS]) and known
            continue
        if step.predicted < options.cost_tolerance * max(abs(point.cost), 1e-6):
            if _feasible(point, options):
                state[_OUTCOME] = _CONVERGED
                continue
            state[_STALLED] += 1
            if state[_STALLED] >= 2 and max(state[_ENDS], state[_LIMIT]) < options.largest_penalty:
                _charge_more(point, state, options)
                state[_RADIUS] = max(state[_RADIUS], 0.5 * options.radius)
                state[_STALLED] = 0
                continue
        else:
            state[_STALLED] = 0
        trial = evaluate_arcs(program, np.maximum(point.xi + step.change, 0.0))
        state[_EVALUATIONS] += 1
        if options.corrections > 0 and step.slack < 1e-4:
            trial = _corrected(program, point, step, trial, state, options.corrections)
        gained = _merit(point, state) - _merit(trial, state)
        length = np.abs(step.change).max()
        ratio = gained / max(step.predicted, 1e-12) if abs(gained) < np.inf else -np.inf
        if not (ratio > 0.05 or (step.predicted < 1e-7 and gained > -1e-9)):
            known = _shrink(point, state, options, length) and known
            continue
        point, known = trial, False
        duals[:] = step.duals
        state[_ESTIMATED] = 1.0
        if ratio > 0.75 and length > 0.9 * state[_RADIUS]:
            state[_RADIUS] = min(2.0 * state[_RADIUS], options.largest_radius)
        elif ratio < 0.25:
            state[_RADIUS] *= 0.5
        dear = state[_STEPS] >= 5 and trial.cost > options.cutoff
        if dear and max(trial.ends, trial.beyond) < 1e-3:
            state[_OUTCOME] = _FAILED
    return point.xi, point.cost, point.ends, point.beyond


@compiled
def _merit(point: ArcPoint, state: Array) -> float:
    return float(point.cost + state[_ENDS] * point.ends + state[_LIMIT] * point.beyond)


@compiled
def _feasible(point: ArcPoint, options: TrustRegionOptions) -> bool:
    ends, limit = options.feasibility
    return bool(point.ends <= ends and point.beyond <= limit)


@compiled
def _charge_more(point: ArcPoint, state: Array, options: TrustRegionOptions) -> None:
    if point.ends > options.feasibility[0]:
        state[_ENDS] *= PRESSURE
    if point.beyond > options.feasibility[1]:
        state[_LIMIT] *= PRESSURE


@compiled
def _shrink(point: ArcPoint, state: Array, options: TrustRegionOptions, length: float) -> bool:
    """Make the trust region smaller; False if derivatives are to be taken anew."""
    state[_RADIUS] = 0.35 * min(state[_RADIUS], length)
    if state[_RADIUS] >= _SMALLEST_RADIUS:
        return True
    if _feasible(point, options):
        state[_OUTCOME] = _CONVERGED
    elif max(state[_ENDS], state[_LIMIT]) < options.largest_penalty:
        _charge_more(point, state, options)
        state[_RADIUS] = 0.5 * options.radius
        return False
    else:
        state[_OUTCOME] = _FAILED
    return True


@compiled
def _elastic_step(point: ArcPoint, hessian: Array, state: Array) -> _Step:
    """Solve the elastic quadratic program in step and slacks; see `trust_region`."""
    n = point.xi.size
    near = np.flatnonzero((point.margins < NEAR_LIMIT) & (point.xi > 0.0))
    count = 8 + near.size
    whole, gradient = np.zeros((n + 2, n + 2)), np.ones(n + 2)
    whole[:n, :n] = hessian
    whole[n, n] = whole[n + 1, n + 1] = SLACK_CURVATURE
    gradient[n], gradient[n + 1] = state[_ENDS], state[_LIMIT]
    rows, least = np.zeros((count, n + 2)), np.empty(count)
    rows[:4, :n], rows[4:8, :n] = point.jacobian, -point.jacobian
    rows[:8, n] = 1.0
    least[:4], least[4:8] = -point.residual, point.residual
    for i in range(near.size):
        rows[8 + i, :n] = point.slopes[near[i]]
        rows[8 + i, n + 1] = 1.0
        least[8 + i] = -point.margins[near[i]]
    lower, upper = np.zeros(n + 2), np.full(n + 2, 1e12)
    lower[:n] = np.maximum(-state[_RADIUS], -point.xi)
    upper[:n] = state[_RADIUS]
    solved, solution, multipliers = solve_compiled(whole, gradient, rows, least, lower, upper)
    change, slacks = solution[:n].copy(), np.maximum(solution[n:], 0.0)
    predicted = state[_ENDS] * (point.ends - slacks[0]) + state[_LIMIT] * (
        point.beyond - slacks[1]
    )
    predicted -= change.sum() + 0.5 * (change @ (hessian @ change))
    duals, active = multipliers[4:8] - multipliers[:4], multipliers[8:] > 1e-9
    return _Step(solved, change, predicted, slacks.max(), duals, near, active)


@compiled
def _corrected(
    program: ArcProgram, at: ArcPoint, step: _Step, trial: ArcPoint, state: Array, most: int
) -> ArcPoint:
    """Second-order correction: pull the trial back to the constraints along their gradients."""
    active = step.near[step.active]
    inverse, inverted = np.zeros((at.xi.size, 4 + active.size)), False
    for _ in range(most):
        violation = max(trial.ends, trial.beyond)
        if not 1e-9 < violation < 2.0:
            break
        residual = np.zeros(4 + active.size)
        residual[:4] = trial.residual
        for i in range(active.size):
            residual[4 + i] = min(trial.margins[active[i]], 0.0)
        if not inverted:
            jacobian = np.zeros((4 + active.size, at.xi.size))
            jacobian[:4] = at.jacobian
            for i in range(active.size):
                jacobian[4 + i] = at.slopes[active[i]]
            for p in range(at.xi.size):
                if not trial.xi[p] > 1e-9:
                    jacobian[:, p] = 0.0
            inverse[:, :], inverted = np.linalg.pinv(jacobian, 1e-4), True
        back = inverse @ residual
        if np.abs(back).max() > 2.0 * state[_RADIUS]:
            break
        better = evaluate_arcs(program, np.maximum(trial.xi - back, 0.0))
        state[_EVALUATIONS] += 1
        if not max(better.ends, better.beyond) < 0.8 * violation:
            break
        trial = better
    return trial


@compiled
def solve_compiled(
    hessian: Array, gradient: Array, rows: Array, least: Array, lower: Array, upper: Array
) -> tuple[bool, Array, Array]:
    """
    Minimise x'H x / 2 + g'x subject to A x >= b, lower <= x <= upper; H is positive definite.

    Returns the minimiser (n,) and the multipliers (m,) of the `rows` A (m, n), `least` is b (m,),
    zero or greater; and before them whether there is one: the constraints may contradict one
    another.

    The dual active-set method of Goldfarb and Idnani, "A numerically stable dual method for
    solving strictly convex quadratic programs" (1983): from the unconstrained minimum on, the
    constraint violated most is added to the active ones, and those whose multipliers would become
    negative are dropped. Constraints are numbered: rows, lower, then upper bounds.
    """
    m, n = rows.shape
    sizes = 1.0 + np.abs(np.concatenate((least, lower, upper)))
    x, multipliers = np.zeros(n), np.zeros(m + 2 * n)
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(hessian))
    except Exception:  # noqa: B902 - numba knows no other: H is not positive definite
        return False, x, multipliers[:m]
    x -= inverse.T @ (inverse @ gradient)
    active, chosen = np.zeros(m + 2 * n, np.bool_), np.zeros(n + 1, np.intp)
    # Gradients of the active constraints, times L^-1, H = L L'; they are triangle' basis.
    normals, basis, triangle = np.empty((n + 1, n)), np.empty((n + 1, n)), np.empty((n + 1, n + 1))
    u, away = np.zeros(n + 1), np.zeros(n)
    count, adding, violation = 0, -1, 0.0
    for _ in range(20 * (m + 2 * n) + 20):
        if adding < 0:
            slacks = np.concatenate((rows @ x - least, x - lower, upper - x))
            adding = int(np.argmin(np.where(active, 0.0, slacks / sizes)))
            violation = slacks[adding]
            if not violation < -_TOLERANCE * sizes[adding]:
                multipliers[chosen[:count]] = u[:count]
                return True, x, multipliers[:m]
            u[count] = 0.0
            normal = np.zeros(n)
            if adding < m:
                normal[:] = rows[adding]
            else:
                normal[(adding - m) % n] = 1.0 if adding < m + n else -1.0
            normal = inverse @ normal
            whole = normal @ normal
        if not whole < np.inf:
            break
        free = _split(normal, basis, triangle, count)
        # How the active constraints' multipliers fall as the new one's grows.
        for i in range(count - 1, -1, -1):
            total = triangle[i, count]
            for j in range(i + 1, count):
                total -= triangle[i, j] * away[j]
            away[i] = total / triangle[i, i]
        length, leaving = np.inf, -1
        for i in range(count):
            if away[i] > 0.0 and u[i] < length * away[i]:
                length, leaving = u[i] / away[i], i
        if free > _DEPENDENT * whole:
            if -violation / free <= length:
                length, leaving = -violation / free, -1
            x += length * (inverse.T @ basis[count]) * math.sqrt(free)
            violation += length * free
        if not length < np.inf:
            break
        u[:count] -= length * away[:count]
        u[count] += length
        if leaving < 0:
            normals[count], chosen[count], active[adding] = normal, adding, True
            count, adding = count + 1, -1
        else:
            active[chosen[leaving]] = False
            count -= 1
            for j in range(leaving, count):
                chosen[j], u[j], normals[j] = chosen[j + 1], u[j + 1], normals[j + 1]
                _split(normals[j], basis, triangle, j)
            u[count] = u[count + 1]
    return False, x, multipliers[:m]


@compiled
def _split(normal: Array, basis: Array, triangle: Array, count: int) -> float:
    """
    Split a vector into what the first `count` rows of an orthonormal `basis` span and the rest.

    The rest, normalised, becomes the next row; returns its squared length.
    """
    rest = normal.copy()
    triangle[:count, count] = 0.0
    for _ in range(2):  # the second time for what rounding left
        shares = basis[:count] @ rest
        triangle[:count, count] += shares
        rest -= shares @ basis[:count]
    free = float(rest @ rest)
    triangle[count, count] = math.sqrt(free)
    basis[count] = rest / triangle[count, count]
    return free
