# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
An underwater vehicle in a current: Zermelo's problem with the vehicle's inertia.

The current runs along x and changes linearly with y. The vehicle's velocity through the water
follows the force of its thrusters against a quadratic drag; at small speeds the drag is linear,
which keeps it smooth at rest. From rest in the water to rest over ground in the shortest time.

Run it: ``python docs/plants/auv.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Disc, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem

SLOW = 0.05  # m/s, below which the drag is linear


@dataclass(frozen=True)
class AuvStart(Validated):
    """State to start from; the velocity is that through the water."""

    x: float = parameter(37.0, 'along the current', unit='m')
    y: float = parameter(-19.0, 'across the current', unit='m')
    u: float = parameter(0.0, 'velocity through the water along x', unit='m/s')
    w: float = parameter(0.0, 'velocity through the water along y', unit='m/s')


@dataclass(frozen=True)
class Auv(DirectProblem):
    """Reach the origin, where the water stands, through a current in the shortest time."""

    name = 'auv'
    state_names, state_units = ('x', 'y', 'u', 'w'), ('m', 'm', 'm/s', 'm/s')
    control_names, control_units = ('fx', 'fy'), ('m/s^2', 'm/s^2')

    start: AuvStart = group(AuvStart)
    shear: float = parameter(-0.1, 'change of the current across', unit='1/s')
    force: float = parameter(0.3, 'largest force by mass', unit='m/s^2', allowed=POSITIVE)
    drag: float = parameter(0.3, 'drag by mass and speed squared', unit='1/m', allowed=POSITIVE)
    free: int = parameter(8, 'varied parameters of each coordinate', allowed=NON_NEGATIVE)

    def outputs(self):
        s = self.start
        starts = (s.x, s.u + self.shear * s.y), (s.y, s.w)
        rows = zip('xy', starts, strict=True)
        return {n: Output(start=a, end=(0.0, 0.0), free=self.free, scale=20.0) for n, a in rows}

    def duration(self):
        return Duration(guess=60.0)

    def resistance(self, u, w):
        """Return the drag by mass along both axes [m/s^2]."""
        by_speed = self.drag * np.sqrt(u**2 + w**2 + SLOW**2)
        return by_speed * u, by_speed * w

    def invert(self, y, z):
        (px, vx, ax), (py, vy, ay) = y['x'], y['y']
        u = vx - self.shear * py
        rx, ry = self.resistance(u, vy)
        return (px, py, u, vy), (ax - self.shear * vy + rx, ay + ry)

    def derivative(self, x, u):
        rx, ry = self.resistance(x[2], x[3])
        return x[2] + self.shear * x[1], x[3], u[0] - rx, u[1] - ry

    def margins(self, t, x, u):
        return {'force': 1.0 - (u[0] ** 2 + u[1] ** 2) / self.force**2}

    def final_cost(self, t, x):
        return t

    def drawing(self, x):
        place, nose = (x[0], x[1]), (x[0] + 3.0 * x[2], x[1] + 3.0 * x[3])  # 3 s through the water
        rows = np.linspace(-1.0, 1.0, 9) * max(abs(self.start.x), abs(self.start.y))
        current = [Line(((0.0, y), (5.0 * self.shear * y, y)), 'reach') for y in rows]
        return *current, Line((place, nose)), Disc(place, 0.6, trail=True)


VARIATIONS = (
    {'start.x': 36.6, 'start.y': -18.6, 'force': 3.0, 'drag': 3.0},
    {'shear': 0.08},
    {'force': 0.5},
    {'start.x': 10.0, 'start.y': 25.0},
    {'start.x': -20.0, 'start.y': -10.0, 'start.u': 0.8, 'start.w': -0.3},
)
PUBLISHED = {
    '0': (  # (tan 240 deg - tan 105 deg) h/V
        54.64,
        'A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, section 2.7: without inertia,'
        ' which this case comes near, h = 10 m, V = 1 m/s',
    ),
}

if __name__ == '__main__':
    from table import show

    show(Auv, VARIATIONS, PUBLISHED, plane=('x', 'y'))
