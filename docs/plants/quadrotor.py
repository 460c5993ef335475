# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A quadrotor through a gate in the shortest time.

The vehicle is a point with a thrust vector, which is what a quadrotor's attitude and rotors make:
its flat outputs are the three coordinates. Thrust is limited in size and, by the tilt, in
direction, and never stops. The wall at x = 0 has a round opening with bevelled rims: solid is
what lies outside the hyperboloid of one sheet

    y^2 + (z - height)^2 = radius^2 + (bevel x)^2,

whose waist is the opening. That is a limit on every place, at no instant that must be known.

Run it: ``python docs/plants/quadrotor.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Disc, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Range, Validated
from tdm_planner.problems import DirectProblem

G = 9.81


@dataclass(frozen=True)
class QuadrotorStart(Validated):
    """State to start from."""

    x: float = parameter(-3.0, 'across the wall', unit='m')
    y: float = parameter(-2.0, 'along the wall', unit='m')
    z: float = parameter(0.5, 'height', unit='m')
    vx: float = parameter(0.0, 'velocity across the wall', unit='m/s')
    vy: float = parameter(0.0, 'velocity along the wall', unit='m/s')
    vz: float = parameter(0.0, 'velocity upwards', unit='m/s')


@dataclass(frozen=True)
class Quadrotor(DirectProblem):
    """Fly through a gate to hover behind it."""

    name = 'quadrotor'
    state_names, state_units = ('x', 'y', 'z', 'vx', 'vy', 'vz'), ('m',) * 3 + ('m/s',) * 3
    control_names, control_units = ('fx', 'fy', 'fz'), ('m/s^2',) * 3

    start: QuadrotorStart = group(QuadrotorStart)
    goal_x: float = parameter(3.0, 'goal, behind the wall', unit='m')
    goal_y: float = parameter(-1.5, 'goal, along the wall', unit='m')
    goal_z: float = parameter(1.0, 'goal, height', unit='m')
    height: float = parameter(1.5, "the gate's height", unit='m')
    radius: float = parameter(0.3, "the gate's radius", unit='m', allowed=POSITIVE)
    bevel: float = parameter(1.2, 'slope of its rims', allowed=POSITIVE)
    thrust: float = parameter(18.0, 'largest thrust by mass', unit='m/s^2', allowed=POSITIVE)
    idle: float = parameter(2.0, 'least thrust upwards by mass', unit='m/s^2', allowed=POSITIVE)
    tilt: float = parameter(0.9, 'largest tilt', unit='rad', allowed=Range(0.1, 1.5))
    drag: float = parameter(0.1, 'drag by mass and speed', unit='1/s', allowed=NON_NEGATIVE)
    free: int = parameter(8, 'varied parameters of each coordinate', allowed=NON_NEGATIVE)

    def outputs(self):
        s = self.start
        starts = (s.x, s.vx), (s.y, s.vy), (s.z, s.vz)
        ends = (self.goal_x, 0.0), (self.goal_y, 0.0), (self.goal_z, 0.0)
        rows = zip('xyz', starts, ends, strict=True)
        return {n: Output(start=a, end=b, free=self.free, scale=3.0) for n, a, b in rows}

    def duration(self):
        return Duration(guess=2.0)

    def invert(self, y, z):
        (px, vx, ax), (py, vy, ay), (pz, vz, az) = y['x'], y['y'], y['z']
        thrust = ax + self.drag * vx, ay + self.drag * vy, az + self.drag * vz + G
        return (px, py, pz, vx, vy, vz), thrust

    def derivative(self, x, u):
        k, (_, _, _, vx, vy, vz) = self.drag, x
        return vx, vy, vz, u[0] - k * vx, u[1] - k * vy, u[2] - k * vz - G

    def control_limits(self):
        return {'fz': (self.idle, self.thrust)}

    def margins(self, t, x, u):
        rho2, side2 = x[1] ** 2 + (x[2] - self.height) ** 2, u[0] ** 2 + u[1] ** 2
        return {
            'gate': 1.0 - rho2 / (self.radius**2 + (self.bevel * x[0]) ** 2),
            'thrust': 1.0 - (side2 + u[2] ** 2) / self.thrust**2,
            'tilt': ((u[2] * np.tan(self.tilt)) ** 2 - side2) / G**2,
        }

    def final_cost(self, t, x):
        return t

    def drawing(self, x):
        turn = np.linspace(0.0, 2.0 * np.pi, 40)
        rims = [(d, np.hypot(self.radius, self.bevel * d)) for d in (-0.4, 0.0, 0.4)]
        ways = [[(d, r * np.cos(a), self.height + r * np.sin(a)) for a in turn] for d, r in rims]
        return *(Line(way, 'limit') for way in ways), Disc(x[:3], 0.12, trail=True)


VARIATIONS = (
    {'radius': 0.15},
    {'thrust': 14.0, 'tilt': 0.6},
    {'start.y': 3.0, 'start.vy': -1.0},
    {'height': 2.5, 'goal_z': 0.3},
    {'start.x': -6.0, 'goal_x': 5.0, 'goal_y': 2.0, 'drag': 0.3},
)
PUBLISHED: dict[str, tuple[float, str]] = {}

if __name__ == '__main__':
    from table import show

    show(Quadrotor, VARIATIONS, PUBLISHED, plane=('x', 'y'))
