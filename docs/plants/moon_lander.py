# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A soft landing on the Moon with the least fuel: fall freely, then brake with all there is.

h.. = u - gravity, 0 <= u <= thrust; the fuel used is the integral of u, the change of the mass
being neglected. The optimum is known: no thrust to the one instant from which full thrust just
brings the lander to rest on the ground.

Run it: ``python docs/plants/moon_lander.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Box, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem


@dataclass(frozen=True)
class LanderStart(Validated):
    """State to start from."""

    h: float = parameter(10.0, 'height', unit='m', allowed=POSITIVE)
    v: float = parameter(-2.0, 'velocity upwards', unit='m/s')


@dataclass(frozen=True)
class MoonLander(DirectProblem):
    """Come to rest on the ground with the least fuel."""

    name = 'moon_lander'
    state_names, state_units = ('h', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)

    start: LanderStart = group(LanderStart)
    gravity: float = parameter(1.5, 'acceleration due to gravity', unit='m/s^2', allowed=POSITIVE)
    thrust: float = parameter(3.0, 'largest thrust by mass', unit='m/s^2', allowed=POSITIVE)
    free: int = parameter(8, 'varied parameters of the height', allowed=NON_NEGATIVE)

    def outputs(self):
        start = self.start.h, self.start.v
        return {'h': Output(start=start, end=(0.0, 0.0), free=self.free)}

    def duration(self):
        fall = 2.0 * np.sqrt(2.0 * self.start.h / self.gravity)
        return Duration(guess=float(fall + abs(self.start.v) / self.gravity))

    def invert(self, y, z):
        h, v, a = y['h']
        return (h, v), (a + self.gravity,)

    def derivative(self, x, u):
        return x[1], u[0] - self.gravity

    def control_limits(self):
        return {'u': (0.0, self.thrust)}

    def margins(self, t, x, u):
        return {'ground': x[0] / 10.0}

    def running_cost(self, t, x, u):
        return u[0]

    def drawing(self, x):
        ground = Line(((-3.0, 0.0, 0.0), (3.0, 0.0, 0.0)), 'limit')
        legs = [Line(((0.3 * k, 0.0, x[0] + 0.6), (0.7 * k, 0.0, x[0]))) for k in (-1.0, 1.0)]
        return ground, *legs, Box((0.0, 0.0, x[0] + 0.9), (1.0, 1.0, 0.6), trail=True)


def least_fuel(problem: MoonLander) -> float:
    """Return the least change of speed [m/s]: that of braking from the free fall's end."""
    brake = problem.thrust - problem.gravity
    drop = problem.start.h + problem.start.v**2 / (2.0 * problem.gravity)
    fastest = np.sqrt(2.0 * drop / (1.0 / problem.gravity + 1.0 / brake))
    return float(problem.thrust * fastest / brake)


VARIATIONS = (
    {'thrust': 2.0},
    {'gravity': 1.62, 'thrust': 6.0},
    {'start.h': 100.0, 'start.v': -10.0},
    {'start.v': 3.0},
    {'gravity': 3.7, 'thrust': 9.0, 'start.h': 50.0, 'start.v': 0.0},
)
PAPER = (
    'one switch: J. S. Meditch, On the problem of optimal thrust programming for a lunar soft'
    ' landing, IEEE Trans. Automatic Control 9(4), 1964'
)
PUBLISHED = {
    'default': (least_fuel(MoonLander()), PAPER),  # 2 sqrt(17)
    **{
        str(i): (least_fuel(MoonLander.from_parameters(given)), PAPER)
        for i, given in enumerate(VARIATIONS)
    },
}

if __name__ == '__main__':
    from table import show

    show(MoonLander, VARIATIONS, PUBLISHED)
