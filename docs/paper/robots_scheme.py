# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The robots' inverse dynamics as printed, (21)-(27) of Yakimenko (2006), beside the exact one.

The printed recursion for the speed factor is circular - V_j needs lambda_j and lambda_j needs
V_j - so it is read causally, V_j = lambda_(j-1) |x'_j|. Measured here:

- in motion from the start, lambda stays 1 whatever the polynomials are: tau is time, and the speed
  along the path is as fixed as without a speed factor;
- from rest with zero acceleration lambda drifts to a wrong constant, whatever the number of nodes:
  time is stretched, forces are not in proportion, and the open loop misses the goal;
- the second control (22) has the wrong sign and denominator;
- the recursion for omega in (27) passes an error on undamped, with alternating sign.

Run it: ``python docs/paper/robots_scheme.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly

Array = NDArray[np.float64]


class Controls(NamedTuple):
    """Instants, speed factor, thrust/mass, its direction, that direction's rate, yaw rate."""

    times: Array
    speed_factor: Array
    thrust: Array
    direction: Array
    rate: Array
    yaw_rate: Array


class Move(NamedTuple):
    """Reference functions of x, y and yaw on a common arc."""

    x: BPoly
    y: BPoly
    yaw: BPoly

    @property
    def tau_f(self) -> float:
        """Length of the virtual arc."""
        return float(self.x.x[-1])


def move(velocity: float = 0.0, tau_f: float = 30.0, yaw_error: float = 0.0) -> Move:
    """Return a move by (2, 1) m and 1 rad, from a `velocity` along x or from rest, to rest."""
    ways = (velocity, 2.0), (0.0, 1.0), (yaw_error, 1.0)
    ends = [((0.0, rate, 0.0), (goal, 0.0, 0.0)) for rate, goal in ways]
    return Move(*(BPoly.from_derivatives([0.0, tau_f], pair) for pair in ends))


def printed(motion: Move, nodes: int, first_yaw_rate: float = 0.0) -> Controls:
    """Return (21)-(27) as printed, read causally."""
    tau = np.linspace(0.0, motion.tau_f, nodes)
    x, y, yaw = (np.stack([f(tau, k) for k in range(4)]) for f in motion)
    times, speed_factor = np.zeros(nodes), np.ones(nodes)
    speed, yaw_rate = np.zeros(nodes), np.zeros(nodes)
    speed[0] = np.hypot(x[1, 0], y[1, 0])
    yaw_rate[0] = first_yaw_rate
    for j in range(1, nodes):
        speed[j] = speed_factor[j - 1] * np.hypot(x[1, j], y[1, j])  # (23)
        distance = np.hypot(x[0, j] - x[0, j - 1], y[0, j] - y[0, j - 1])
        if speed[j] + speed[j - 1] < 1e-12:
            elapsed = (tau[j] - tau[j - 1]) / speed_factor[j - 1]
        else:
            elapsed = 2.0 * distance / (speed[j] + speed[j - 1])  # (24)
        speed_factor[j] = (tau[j] - tau[j - 1]) / elapsed  # (25)
        times[j] = times[j - 1] + elapsed  # (26)
        yaw_rate[j] = 2.0 * (yaw[0, j] - yaw[0, j - 1]) / elapsed - yaw_rate[j - 1]  # (27)
    thrust = speed_factor * np.hypot(x[2], y[2])  # (21)
    direction = np.unwrap(np.arctan2(y[2], x[2]))
    with np.errstate(all='ignore'):
        turned = (x[3] * y[2] - x[2] * y[3]) / y[3] * np.cos(yaw[0]) ** 2
    rate = speed_factor * (turned - yaw[1])  # (22)
    return Controls(times, speed_factor, thrust, direction, rate, yaw_rate)


def exact(motion: Move, nodes: int) -> Controls:
    """Return the exact inverse dynamics with tau = t."""
    tau = np.linspace(0.0, motion.tau_f, nodes)
    x, y, yaw = (np.stack([f(tau, k) for k in range(4)]) for f in motion)
    with np.errstate(all='ignore'):
        rate = (x[2] * y[3] - y[2] * x[3]) / (x[2] ** 2 + y[2] ** 2) - yaw[1]
    direction = np.unwrap(np.arctan2(y[2], x[2]))
    return Controls(tau, np.ones(nodes), np.hypot(x[2], y[2]), direction, rate, yaw[1])


def open_loop_miss(motion: Move, controls: Controls) -> float:
    """Distance from the goal [m] where the thrust is applied over the times of `controls`."""
    t = np.linspace(0.0, controls.times[-1], 20001)
    forces = [
        np.interp(t, controls.times, controls.thrust * share)
        for share in (np.cos(controls.direction), np.sin(controls.direction))
    ]
    step = t[1]
    end = []
    for coordinate, force in zip(motion[:2], forces, strict=True):
        speed = coordinate(0.0, 1) + np.concatenate(
            [[0.0], np.cumsum(0.5 * step * (force[1:] + force[:-1]))]
        )
        end.append(coordinate(0.0) + np.sum(0.5 * step * (speed[1:] + speed[:-1])))
    return float(np.hypot(end[0] - 2.0, end[1] - 1.0))


def yaw_rate_ripple(nodes: int, error: float = 0.01) -> float:
    """Ratio of the last to the first error of omega in (27) after an error at the start."""
    motion = move(velocity=0.2)
    disturbed = printed(motion, nodes, error).yaw_rate
    return float(abs(disturbed[-1] - printed(motion, nodes).yaw_rate[-1]) / error)


if __name__ == '__main__':
    print(
        'nodes    in motion: lambda   miss [m]    from rest: lambda   t_f [s]   miss [m]    exact'
    )
    for nodes in (26, 51, 101, 201, 401):
        moving, resting = move(velocity=0.2), move()
        first, second = printed(moving, nodes), printed(resting, nodes)
        print(
            f'{nodes:5d}  {first.speed_factor[nodes // 2]:19.3f} '
            f'{open_loop_miss(moving, first):10.3f} {second.speed_factor[nodes // 2]:20.3f} '
            f'{second.times[-1]:9.2f} {open_loop_miss(resting, second):10.3f} '
            f'{open_loop_miss(resting, exact(resting, nodes)):8.4f}'
        )
    moving = move(velocity=0.2)
    wrong, right = printed(moving, 101).rate[30], exact(moving, 101).rate[30]
    print(f'(22) at one node: {wrong:.4f} rad/s as printed, {right:.4f} rad/s exactly')
    print(f'(27): an error of omega at the start is passed on by {yaw_rate_ripple(101):.3f}')
