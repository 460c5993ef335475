# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The replay of plans by DOP853, compiled, for every plant whose right-hand side can be traced.

One step, its error and its dense output are one CasADi function. The rotary pendulum has a
compiled kernel of its own. See Hairer, Norsett, Wanner, *Solving Ordinary Differential Equations
I*, II.10. The coefficients are scipy's, and so is the choice of the steps.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import DOP853
from scipy.interpolate import PPoly
from tdm_planner.arrays import Array
from tdm_planner.direct_method.graphs import Call
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.trajectory import ReplayedMotion

# Relative and absolute, of a step. Errors of an unstable plant grow by 1e10 and more; most steps
# are as long as the pieces of the controls all the same.
_TOLERANCES = 1e-12, 1e-14
_SAFETY, _SMALLEST, _LARGEST = 0.9, 0.2, 10.0  # of the factor from a step to the next
_EXPONENT = -1.0 / 8.0  # of the error: the error estimate is of order 7
LEAST_STEP = 1e-12  # share of a piece; where it would take less it cannot go on
MOST_REPLAYED = 100_000  # steps
# Of more than `_FEW` pieces the tolerance is less, as what follows magnifies their errors.
_FEW, _STRICTEST = 30, 100.0
_SOME_STEPS = 64  # between looks at the clock
_PARTS = 4  # steps where their errors are not looked at
# Shares of a step at which its 16 stages are: 12, its end, three more for the dense output.
SHARES = np.concatenate([DOP853.C, [1.0], DOP853.C_EXTRA])


def stricter(pieces: int) -> float:
    """Return the factor of the errors where a motion has so many pieces."""
    return float(min(max(pieces / _FEW, 1.0) ** 2, _STRICTEST))


def step_factor(error: float) -> float:
    """Return the factor from a step to the next, by its error: from 1 on it is tried again."""
    if not error > 0.0:
        return _LARGEST
    return float(min(max(_SAFETY * error**_EXPONENT, _SMALLEST), _LARGEST))


def _dense_output() -> Array:
    """Return the powers of the share of a step (8, 16) that its slopes have in the states."""
    share, left, term = np.poly1d([1.0, 0.0]), np.poly1d([-1.0, 1.0]), np.poly1d([1.0])
    change, (first, last) = np.append(DOP853.B, np.zeros(4)), np.eye(16)[[0, 12]]
    powers = np.zeros((8, 16))
    rows = [change, first - change, 2.0 * change - last - first, *DOP853.D]
    for index, row in enumerate(rows):
        term = term * (left if index % 2 else share)
        powers[: term.order + 1] += np.outer(term.coeffs[::-1], row)
    return powers


_DENSE = _dense_output()


def replayed_motion(steps: Array, begins: Array, slopes: Array) -> ReplayedMotion:
    """
    Return the motion by polynomials between the instants `steps` (m + 1,) [s].

    `begins` (m, nx) are the states there, `slopes` (m, 16, nx) those of every stage.
    """
    powers = np.tensordot(_DENSE, slopes, axes=(1, 1))
    powers *= np.diff(steps)[:, None] ** (1.0 - np.arange(8)[:, None, None])
    powers[0] = begins
    motion = PPoly(powers[::-1], steps)
    return ReplayedMotion(steps, lambda times: np.asarray(motion(np.array(times))))


def _controls(coefficients: Array, times: Array) -> Array:
    """Return the values of polynomials (k, ..., nu) at the `times` (..., 16), (..., 16 nu)."""
    found = np.zeros(1)
    for row in coefficients:
        found = found * times[..., None] + row[..., None, :]
    return found.reshape(*found.shape[:-2], -1)


class Integrator:
    """The integration of a plant's `rates` (x, u, p) -> (nx,), a CasADi function."""

    def __init__(self, rates: Any) -> None:
        size, controls, numbers = (rates.size1_in(i) for i in range(3))
        x, p, h = ca.SX.sym('x', size), ca.SX.sym('p', numbers), ca.SX.sym('h')
        u = ca.SX.sym('u', controls, SHARES.size)

        def rate(stage: int, state: Any) -> Any:
            return rates(state, u[:, stage], p)

        def combined(rows: list[Any], weights: Array) -> Any:
            return sum(float(w) * row for w, row in zip(weights, rows, strict=True) if w)

        slopes = [rate(0, x)]
        for stage, a in enumerate(DOP853.A[1:], 1):
            slopes.append(rate(stage, x + h * combined(slopes, a[:stage])))
        change = h * combined(slopes, DOP853.B)
        slopes.append(rate(12, x + change))
        relative, absolute = _TOLERANCES
        scale = absolute + relative * ca.fmax(ca.fabs(x), ca.fabs(x + change))
        fifth, third = (
            ca.sumsqr(combined(slopes, weights) / scale) for weights in (DOP853.E5, DOP853.E3)
        )
        below = fifth + 0.01 * third
        error = ca.if_else(below > 0.0, ca.fabs(h) * fifth / ca.sqrt(below * size), below)
        for stage, a in enumerate(DOP853.A_EXTRA, 13):
            slopes.append(rate(stage, x + h * combined(slopes, a[:stage])))
        results = [error, x + change, ca.vertcat(*slopes)]
        self._step = ca.Function('step', [x, ca.vec(u), h, p], results)
        self._size = size

    def stepped(
        self, states: Array, first: Array, last: Array, step: Array, numbers: Array
    ) -> Array:
        """
        Return the states (n, nx) after `step` s, (n, 1), from each of `states`, in `_PARTS` steps.

        Controls are linear, from `first` to `last` (n, nu).
        """
        call, line = Call(self._step, len(states)), np.stack([last - first, first])
        for part in range(_PARTS):
            controls = _controls(line, (part + SHARES) / _PARTS)
            states = call(states, controls, step / _PARTS, numbers)[1].copy()
        return states

    def __call__(
        self, pieces: PPoly, state: Array, numbers: Array, until: Budget | None = None
    ) -> ReplayedMotion | None:
        """
        Integrate from `state` (nx,) under the controls in `pieces`, one after the other.

        None where it cannot go on, or the time of `until` is up.
        """
        step, size, times = Call(self._step), self._size, pieces.x
        x, u, length, step.given[-1][...] = *step.given[:-1], numbers
        whole_steps = _controls(pieces.c, np.diff(times)[:, None] * SHARES)
        held = len(pieces.c) == 1
        instants, begins, rows = [float(times[0])], list[Array](), list[Array]()
        late = False
        proposed = np.inf
        strictness = stricter(times.size - 1)
        for k in range(times.size - 1):
            now, end = float(times[k]), float(times[k + 1])
            whole, u[:] = end - now, whole_steps[k]
            while now < end:
                left = end - now
                h = left if proposed >= left else proposed
                if len(rows) % _SOME_STEPS == 0:
                    late = len(rows) >= MOST_REPLAYED or (until is not None and until.spent)
                if h < LEAST_STEP * whole or late:
                    return None
                if h < whole and not held:
                    u[:] = _controls(pieces.c[:, k], now - times[k] + h * SHARES)
                x[:], length[0] = state, h
                missed, reached, slopes = step.run()
                error = strictness * float(missed[0])
                if not math.isfinite(error):
                    return None
                proposed = h * step_factor(error)
                if not error < 1.0:
                    continue
                begins.append(state)
                rows.append(slopes.copy())
                state = reached.copy()
                now = end if h == left else now + h
                instants.append(now)
        if not (rows and np.isfinite(state).all()):  # no rows: it is shorter than a nanosecond
            return None
        return replayed_motion(
            np.array(instants), np.array(begins), np.reshape(rows, (len(rows), -1, size))
        )
