# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Double integrator in minimum time: the more varied parameters, the nearer to the optimum.

x.. = u, |u| <= u_max, from x_0 at rest to the origin at rest. The optimal control is bang-bang,
full thrust half the way, full brakes the other half, and takes 2 sqrt(|x_0|/u_max): 2 s here.
Position is a polynomial reference function of time, velocity and force follow by differentiation
(inverse dynamics). With no free parameter the polynomial is the cubic of the boundary conditions
and takes sqrt(6) s; with more, its second derivative comes closer and closer to the jump.

Run it: ``python docs/plants/double_integrator.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Box, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem, DirectSolverParameters


@dataclass(frozen=True)
class CartStart(Validated):
    """State to start from."""

    x: float = parameter(-1.0, 'position', unit='m')
    v: float = parameter(0.0, 'velocity', unit='m/s')


@dataclass(frozen=True)
class DoubleIntegrator(DirectProblem):
    """Bring a cart to rest at the origin in minimum time."""

    name: ClassVar[str] = 'double_integrator'
    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)

    start: CartStart = group(CartStart)
    limit: float = parameter(1.0, 'largest acceleration', unit='m/s^2', allowed=POSITIVE)
    free: int = parameter(6, 'varied parameters beside the duration', allowed=NON_NEGATIVE)

    def outputs(self):
        return {'x': Output(start=(self.start.x, self.start.v), end=(0.0, 0.0), free=self.free)}

    def duration(self):
        return Duration(guess=3.0 * math.sqrt(abs(self.start.x) / self.limit) + 0.1)

    def invert(self, y, z):
        x, v, u = y['x']
        return (x, v), (u,)

    def derivative(self, x, u):
        return x[1], u[0]

    def margins(self, t, x, u):
        return {'push': 1.0 - u[0] / self.limit, 'pull': 1.0 + u[0] / self.limit}

    def final_cost(self, t, x):
        return t

    def drawing(self, x):
        rail = Line(((self.start.x, 0.0, 0.0), (0.0, 0.0, 0.0)), 'limit')
        return rail, Box((x[0], 0.0, 0.05), (0.2, 0.1, 0.1), trail=True)


def table(counts: tuple[int, ...]) -> dict[int, float]:
    """Minimum time [s] of the direct method alone by the number of varied parameters but one."""
    problem = DoubleIntegrator(solver=DirectSolverParameters(deadline=10.0, refine=False))
    return {free: replace(problem, free=free).solve().cost for free in counts}


if __name__ == '__main__':
    print('varied parameters    t_f [s]    over the optimum')
    for free, t_f in table((0, 2, 4, 8, 12, 20)).items():
        print(f'{free + 1:17d}    {t_f:.5f}    {50 * (t_f - 2.0):.2f} %')
    print(f'{"refined":>17s}    {DoubleIntegrator().solve().cost:.5f}')
