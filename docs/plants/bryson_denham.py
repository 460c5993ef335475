# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Double integrator with a wall: Bryson and Denham's problem, a limit on the state of second order.

A cart thrown at a wall with 1 m/s must come back within a second, as quick as it left, for the
least integral of u^2/2. Where the wall is near, the cart coasts along it for a while.

Run it: ``python docs/plants/bryson_denham.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Box, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem


@dataclass(frozen=True)
class CartStart(Validated):
    """State to start from."""

    x: float = parameter(0.0, 'position', unit='m')
    v: float = parameter(1.0, 'velocity', unit='m/s')


@dataclass(frozen=True)
class BrysonDenham(DirectProblem):
    """Turn back in front of a wall with the least effort."""

    name = 'bryson_denham'
    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)

    start: CartStart = group(CartStart)
    wall: float = parameter(1.0 / 9.0, "the wall's position", unit='m', allowed=POSITIVE)
    back: float = parameter(1.0, 'speed at the end, away from the wall', unit='m/s')
    time: float = parameter(1.0, 'time for it', unit='s', allowed=POSITIVE)
    free: int = parameter(8, 'varied parameters of the position', allowed=NON_NEGATIVE)

    def outputs(self):
        start, end = (self.start.x, self.start.v), (0.0, -self.back)
        return {'x': Output(start=start, end=end, free=self.free, scale=self.wall)}

    def duration(self):
        return Duration(guess=self.time, fixed=True)

    def invert(self, y, z):
        x, v, u = y['x']
        return (x, v), (u,)

    def derivative(self, x, u):
        return x[1], u[0]

    def margins(self, t, x, u):
        return {'wall': 1.0 - x[0] / self.wall}

    def running_cost(self, t, x, u):
        return 0.5 * u[0] ** 2

    def drawing(self, x):
        size = 0.2 * self.wall
        wall = Line(((self.wall, -size), (self.wall, size)), 'limit')
        return wall, Box((x[0] - size / 2.0, 0.0), (size, size), trail=True)


VARIATIONS = (
    {'wall': 0.05},
    {'wall': 0.2},
    {'wall': 0.4},
    {'time': 2.0, 'wall': 0.15},
    {'start.x': 0.02, 'start.v': 1.5, 'back': 0.5},
)
BOOK = 'A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, section 3.11'
PUBLISHED = {  # l = wall / time: 4/(9 l) to l = 1/6, 2 + 6 (1 - 4 l)^2 to 1/4, then 2; over time
    'default': (4.0, BOOK),
    '0': (80.0 / 9.0, BOOK),
    '1': (2.24, BOOK),
    '2': (2.0, BOOK),
    '3': (4.0 / 9.0 / 0.075 / 2.0, BOOK),
}

if __name__ == '__main__':
    from table import show

    show(BrysonDenham, VARIATIONS, PUBLISHED)
