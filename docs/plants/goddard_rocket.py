# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Goddard's rocket: as high as the fuel carries, with a singular arc between full thrust and none.

A rocket climbs vertically against a drag that fades with the height, as high as possible,

    v. = (thrust - D)/m - 1/(1 + h)^2,   m. = -thrust/exhaust,   D = drag v^2 exp(-thinning h),

in the units of the literature: lengths by the planet's radius, accelerations by gravity at its
surface, masses by that at the start. The height is the reference function, thrust follows from
it, the mass is integrated.

Run it: ``python docs/plants/goddard_rocket.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.drawing import Box, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Range, Validated
from tdm_planner.problems import DirectProblem


@dataclass(frozen=True)
class RocketStart(Validated):
    """State to start from."""

    h: float = parameter(0.0, 'height above the ground', allowed=NON_NEGATIVE)
    v: float = parameter(0.0, 'velocity upwards')
    m: float = parameter(1.0, 'mass with fuel', allowed=POSITIVE)


@dataclass(frozen=True)
class GoddardRocket(DirectProblem):
    """Reach the greatest height."""

    name = 'goddard_rocket'
    state_names, state_units = ('h', 'v', 'm'), ('radius', 'speed', 'mass')
    control_names, control_units = ('thrust',), ('weight',)

    start: RocketStart = group(RocketStart)
    empty: float = parameter(0.6, 'mass without fuel', allowed=POSITIVE)
    thrust: float = parameter(3.5, 'largest thrust', allowed=POSITIVE)
    exhaust: float = parameter(0.5, 'speed of the exhaust', allowed=POSITIVE)
    drag: float = parameter(310.0, 'drag by the square of speed', allowed=NON_NEGATIVE)
    thinning: float = parameter(500.0, 'radius by the height of the air', allowed=NON_NEGATIVE)
    free: int = parameter(8, 'varied parameters of the height', allowed=Range(1, 40))

    def outputs(self):
        start = self.start.h, self.start.v
        return {'h': Output(start=start, free=self.free, scale=0.01)}

    def integrated(self):
        return {'m': Integrated(self.start.m, self.empty)}

    def duration(self):
        return Duration(guess=0.2)

    def resistance(self, h, v):
        return self.drag * v**2 * np.exp(-self.thinning * h)

    def invert(self, y, z):
        (h, v, a), m = y['h'], z['m']
        return (h, v, m), (m * (a + 1.0 / (1.0 + h) ** 2) + self.resistance(h, v),)

    def derivative(self, x, u):
        h, v, m = x
        pull = (u[0] - self.resistance(h, v)) / m
        return v, pull - 1.0 / (1.0 + h) ** 2, -u[0] / self.exhaust

    def control_limits(self):
        return {'thrust': (0.0, self.thrust)}

    def final_cost(self, t, x):
        return -x[0]

    def drawing(self, x):
        size = 1e-3  # large enough to be seen beside its way
        hull = Box((0.0, 0.0, x[0] + size / 2.0), (size / 4.0, size / 4.0, size), trail=True)
        return Line(((-size, 0.0, 0.0), (size, 0.0, 0.0)), 'limit'), hull


VARIATIONS = (
    {'thrust': 2.5},
    {'empty': 0.5},
    {'drag': 155.0},
    {'drag': 620.0, 'thinning': 400.0},
    {'start.h': 0.002, 'start.v': 0.05, 'start.m': 0.9},
)
PUBLISHED = {
    'default': (
        -0.01283,
        'E. D. Dolan, J. J. More, T. S. Munson, Benchmarking Optimization Software with COPS 3.0,'
        ' Argonne, 2004 (height 1.01283 from the centre)',
    ),
}

if __name__ == '__main__':
    from table import show

    show(GoddardRocket, VARIATIONS, PUBLISHED)
