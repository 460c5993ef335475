# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled replay of the rotary pendulum by Dormand and Prince's method of order 8.

`roll_states` gives states along arcs of constant torque; `replay_pendulum`, with control of the
step's error, the motion that a plan is verified with.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import DOP853
from tdm_planner.arrays import Array
from tdm_planner.direct_method.integrator import (
    LEAST_STEP,
    MOST_REPLAYED,
    replayed_motion,
    SHARES,
    step_factor,
    stricter,
)
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.pendulum_kernels import quick_accelerations, quick_time
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.trajectory import ReplayedMotion, Trajectory

# Of DOP853: 12 stages, where the step ends, three more for the dense output.
_STAGES, _ERRORS = np.zeros((16, 16)), np.array([DOP853.E5, DOP853.E3])
_STAGES[:12, :12], _STAGES[12, :12], _STAGES[13:] = DOP853.A, DOP853.B, DOP853.A_EXTRA
_RELATIVE, _ABSOLUTE = 1e-9, 1e-11  # of a step
_LONG_STEP = 0.1  # of `quick_time`
_MOST_SUBSTEPS = 10_000  # of an interval: a light disk may turn however fast

_step_factor = inlined(step_factor)


@compiled
def _roll_states(k: Coefficients, start: Array, intervals: Array, torques: Array) -> Array:
    states, rates, x = np.empty((intervals.size + 1, 4)), np.empty((12, 4)), start.copy()
    states[0] = start
    for n in range(intervals.size):
        left = intervals[n]
        for _ in range(_MOST_SUBSTEPS):
            h = min(left, _LONG_STEP * quick_time(k, x[0], x[2], x[3]))
            for s in range(12):
                theta, w, v = x[0], x[2], x[3]
                for j in range(s):
                    a = h * _STAGES[s, j]
                    theta, w, v = theta + a * rates[j, 0], w + a * rates[j, 2], v + a * rates[j, 3]
                rates[s, 0], rates[s, 1] = w, v
                rates[s, 2], rates[s, 3] = quick_accelerations(k, theta, w, v, torques[n])
            for s in range(12):
                for m in range(4):
                    x[m] += h * _STAGES[12, s] * rates[s, m]
            left -= h
            if not left > 0.0:
                break
        states[n + 1] = x
    return states


def roll_states(plant: RotaryPendulum, start: Array, intervals: Array, torques: Array) -> Array:
    """
    Integrate over `intervals` [s] under held `torques`, both (n,): states (n + 1, 4).

    To some ten digits: by Dormand and Prince's method of order 8, in steps that follow the
    motion's time scale.
    """
    states: Array = _roll_states(plant.coefficients, start, intervals, torques)
    return states


@compiled
def _replayed(
    k: Coefficients, times: Array, pieces: Array, start: Array, strictness: float
) -> tuple[int, Array, Array, Array]:
    """Return the number of steps, -1 where it cannot go on, and what `replayed_motion` takes."""
    room, n, proposed = 512, 0, np.inf
    instants, begins, slopes = np.empty(room + 1), np.empty((room, 4)), np.empty((room, 16, 4))
    instants[0], x, reached, rates = times[0], start.copy(), np.empty(4), np.empty((16, 4))
    now, missed = np.empty(4), np.empty((2, 4))
    for piece in range(times.size - 1):
        t, end = times[piece], times[piece + 1]
        whole = end - t
        while t < end:
            h, error = min(proposed, end - t), 0.0
            if not h >= LEAST_STEP * whole or n >= MOST_REPLAYED:
                return -1, instants, begins, slopes
            for s in range(16):
                now[:] = x
                for j in range(s):
                    for m in range(4):
                        now[m] += h * _STAGES[s, j] * rates[j, m]
                torque, since = 0.0, t + SHARES[s] * h - times[piece]
                for m in range(pieces.shape[0]):
                    torque = torque * since + pieces[m, piece]
                rates[s, 0], rates[s, 1] = now[2], now[3]
                rates[s, 2], rates[s, 3] = quick_accelerations(k, now[0], now[2], now[3], torque)
                if s == 12:  # it is there
                    reached[:], missed[:] = now, 0.0
                    for j in range(13):
                        for m in range(4):
                            missed[0, m] += _ERRORS[0, j] * rates[j, m]
                            missed[1, m] += _ERRORS[1, j] * rates[j, m]
                    fifth = third = 0.0
                    for m in range(4):
                        scale = _ABSOLUTE + _RELATIVE * max(abs(x[m]), abs(now[m]))
                        fifth += (missed[0, m] / scale) ** 2
                        third += (missed[1, m] / scale) ** 2
                    below = fifth + 0.01 * third
                    error = fifth / math.sqrt(4.0 * below) if below > 0.0 else below
                    error *= strictness * h
                    if not error < 1.0:
                        break
            if not error < np.inf:
                return -1, instants, begins, slopes
            proposed = h * _step_factor(error)
            if not error < 1.0:
                continue
            begins[n], slopes[n] = x, rates
            t, n = end if h == end - t else t + h, n + 1
            instants[n], x[:] = t, reached
            if n == room:
                room *= 2
                instants = np.append(instants, np.empty(n))
                begins, slopes = np.append(begins, begins, 0), np.append(slopes, slopes, 0)
    return n, instants, begins, slopes


def replay_pendulum(plant: RotaryPendulum, trajectory: Trajectory) -> ReplayedMotion:
    """Integrate along the planned torques; where it cannot go on all states are NaN."""
    times, pieces = np.array(trajectory.control_pieces.x), trajectory.control_pieces.c[..., 0]
    given = plant.coefficients, times, np.ascontiguousarray(pieces), np.array(trajectory.states[0])
    n, instants, begins, slopes = _replayed(*given, stricter(pieces.shape[1]))
    if n < 0:
        return ReplayedMotion(times, lambda t: np.full((t.size, 4), np.nan))
    return replayed_motion(instants[: n + 1], begins[:n], slopes[:n])
