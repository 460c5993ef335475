# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Brachistochrone: the slope is a reference function, everything else is integrated.

A bead slides without friction from rest at the origin to (x_f, y_f), y downwards, in the shortest
time. The angle gamma of the track below the horizontal is the control; x. = v cos(gamma),
y. = v sin(gamma), v. = g sin(gamma). None of the three can be prescribed together with gamma, so
gamma(t) is the reference function and all three are integrated; the end (x_f, y_f) becomes two
equalities. No boundary condition holds gamma: all its parameters are varied.

The optimum is the cycloid, along which gamma falls linearly in time. The duration is one varied
parameter; with one of the slope beside it, two in all, comes the straight line, with three the
cycloid itself; more can add nothing.

Run it: ``python docs/plants/brachistochrone.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
from scipy.optimize import brentq
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.drawing import Disc, Line
from tdm_planner.parameters import parameter, POSITIVE, Range
from tdm_planner.problems import DirectProblem, DirectSolverParameters


@dataclass(frozen=True)
class Brachistochrone(DirectProblem):
    """Find the track of quickest descent."""

    name: ClassVar[str] = 'brachistochrone'
    state_names, state_units = ('x', 'y', 'v'), ('m', 'm', 'm/s')
    control_names, control_units = ('gamma',), ('rad',)

    across: float = parameter(2.0, 'horizontal distance', unit='m', allowed=POSITIVE)
    down: float = parameter(1.0, 'vertical distance', unit='m', allowed=POSITIVE)
    gravity: float = parameter(9.81, 'acceleration due to gravity', unit='m/s^2', allowed=POSITIVE)
    free: int = parameter(
        3, 'varied parameters of the slope, beside the duration', allowed=Range(1, 12)
    )

    def outputs(self):
        return {'gamma': Output(free=self.free, scale=1.0)}

    def integrated(self):
        return {
            'x': Integrated(0.0, self.across, scale=self.across),
            'y': Integrated(0.0, self.down, scale=self.down),
            'v': Integrated(0.0),
        }

    def duration(self):
        slope = math.atan2(self.down, self.across)
        return Duration(guess=math.sqrt(2.0 * self.down / self.gravity) / math.sin(slope))

    def invert(self, y, z):
        return (z['x'], z['y'], z['v']), (y['gamma'][0],)

    def derivative(self, x, u):
        v, gamma = x[2], u[0]
        return v * np.cos(gamma), v * np.sin(gamma), self.gravity * np.sin(gamma)

    def final_cost(self, t, x):
        return t

    def drawing(self, x):
        straight = Line(((0.0, 0.0, 0.0), (self.across, 0.0, -self.down)), 'reach')
        return straight, Disc((x[0], 0.0, -x[1]), 0.03, trail=True)


def cycloid_time(across: float, down: float, gravity: float) -> float:
    """Return the analytic minimum [s]: x = r (phi - sin phi), y = r (1 - cos phi)."""
    phi = brentq(
        lambda p: (p - math.sin(p)) * down - (1.0 - math.cos(p)) * across, 1e-3, 2 * math.pi
    )
    return phi * math.sqrt(down / (1.0 - math.cos(phi)) / gravity)


if __name__ == '__main__':
    problem = Brachistochrone(solver=DirectSolverParameters(deadline=10.0))
    best = cycloid_time(problem.across, problem.down, problem.gravity)
    print(f'cycloid: {best:.6f} s')
    print('varied parameters    t_f [s]    over the cycloid')
    for free in (1, 2, 3, 4):
        t_f = replace(problem, free=free).solve().cost
        print(f'{free + 1:17d}    {t_f:.6f}    {100 * (t_f / best - 1.0):.4f} %')
