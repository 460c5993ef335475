# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The replay of plans of the floating robot, by quadrature of (17).

Attitude and thrust direction are integrals of the controls alone, and velocity and position follow
by Gauss-Legendre quadrature; no time stepping is needed.
"""

from __future__ import annotations

import math

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plants.compilation import compiled
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.trajectory import Trajectory

# Gauss-Legendre on [0, 1] with two and three nodes. While the heading turns by d, the velocity
# gained is off by d^4 / 4320 or d^6 / 2e6 of itself: by 1e-10 at these angles [rad].
_TWO, _THREE = ((x / 2.0 + 0.5, w / 2.0) for x, w in map(np.polynomial.legendre.leggauss, (2, 3)))
_LITTLE, _MOST = 0.02, 0.2


def replay(robot: FloatingRobot, trajectory: Trajectory, times: Array) -> Array:
    """
    Return the states (n, 7) at `times` (n,) s, which rise, from the trajectory's first state on.

    Raise InvalidProblem for controls that run by splines between samples.
    """
    if trajectory.interpolation == 'cubic':
        raise InvalidProblem("a robot's controls must be held or linear between samples")
    linear = trajectory.interpolation == 'linear'
    given = trajectory.times, trajectory.controls, trajectory.states[0], times
    # Copied, as numba would compile another kernel for what is read-only, or stored by columns.
    samples, controls, first, at = (np.array(values, order='C') for values in given)
    return replayed(samples, controls, first, linear, robot.mass, robot.inertia, at)


@compiled
def replayed(
    samples: Array,
    controls: Array,
    first: Array,
    linear: bool,
    mass: float,
    inertia: float,
    times: Array,
) -> Array:
    """Return what `replay` does, for controls (N, 3) at the `samples` (N,) s."""
    x, y, u, v, yaw, omega, alpha = first
    states = np.empty((times.size, 7))
    now, k, last = samples[0], 0, samples.size - 1
    for r in range(times.size):
        while now < times[r]:
            thrust, rate, torque = controls[k]
            thrust_slope, rate_slope, torque_slope = 0.0, 0.0, 0.0
            until = times[r] if k == last else min(times[r], samples[k + 1])
            if linear and k < last:
                step, since = samples[k + 1] - samples[k], now - samples[k]
                thrust_slope = (controls[k + 1, 0] - thrust) / step
                rate_slope = (controls[k + 1, 1] - rate) / step
                torque_slope = (controls[k + 1, 2] - torque) / step
                thrust += since * thrust_slope
                rate += since * rate_slope
                torque += since * torque_slope
            h = until - now
            spin, spin_slope = torque / inertia, torque_slope / inertia
            faster = omega + h * (spin + h * spin_slope / 2.0)
            turning = max(abs(omega), abs(faster)) + max(abs(rate), abs(rate + h * rate_slope))
            burning = thrust != 0.0 or thrust_slope != 0.0
            parts = max(math.ceil(h * turning / _MOST), 1) if burning else 0
            nodes, weights = _TWO if h * turning < _LITTLE else _THREE
            gained, across = 0.0, 0.0
            x += h * u
            y += h * v
            for part in range(parts):
                for j in range(nodes.size):
                    t = h * (part + nodes[j]) / parts
                    heading = yaw + t * (omega + t * (spin / 2.0 + t * spin_slope / 6.0))
                    heading += alpha + t * (rate + t * rate_slope / 2.0)
                    push = h / parts * weights[j] * (thrust + t * thrust_slope) / mass
                    # The position gains what is left of the interval times the velocity gained.
                    x += push * math.cos(heading) * (h - t)
                    y += push * math.sin(heading) * (h - t)
                    gained += push * math.cos(heading)
                    across += push * math.sin(heading)
            u += gained
            v += across
            yaw += h * (omega + h * (spin / 2.0 + h * spin_slope / 6.0))
            omega = faster
            alpha += h * (rate + h * rate_slope / 2.0)
            now = until
            if k < last and now == samples[k + 1]:
                k += 1
        row = states[r]
        row[0], row[1], row[2], row[3], row[4], row[5], row[6] = x, y, u, v, yaw, omega, alpha
    return states
