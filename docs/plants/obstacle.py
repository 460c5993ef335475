# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The shortest way round an obstacle: what a path constraint costs, and which side to pass.

A vehicle of bounded speed moves from rest of nothing - its velocity is the control - past a disc
that lies across its way. The fastest path is known: a tangent to the disc, an arc along it, a
tangent to the goal. x and y are polynomials; with tau = t their order alone must also keep the
speed at its limit all along, which a speed factor does for less (compare the columns).

Run it: ``python docs/plants/obstacle.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Disc
from tdm_planner.parameters import NON_NEGATIVE, parameter, POSITIVE
from tdm_planner.problems import DirectProblem, DirectSolverParameters


@dataclass(frozen=True)
class RoundTheObstacle(DirectProblem):
    """Go from (-distance, 0) to (distance, 0) past a disc at the origin in minimum time."""

    name: ClassVar[str] = 'round_the_obstacle'
    state_names, state_units = ('x', 'y'), ('m', 'm')
    control_names, control_units = ('u', 'v'), ('m/s', 'm/s')

    distance: float = parameter(2.0, 'from the middle to start and goal', unit='m')
    radius: float = parameter(1.0, "obstacle's radius", unit='m', allowed=POSITIVE)
    speed: float = parameter(1.0, 'largest speed', unit='m/s', allowed=POSITIVE)
    free: int = parameter(6, 'varied parameters of each coordinate', allowed=NON_NEGATIVE)
    speed_factor_order: int = parameter(0, 'degree of dt/ds', allowed=NON_NEGATIVE)

    def outputs(self):
        return {
            'x': Output(start=(-self.distance,), end=(self.distance,), free=self.free),
            'y': Output(start=(0.0,), end=(0.0,), free=self.free),
        }

    def duration(self):
        guess = 3.0 * self.distance / self.speed
        return Duration(guess=guess, speed_factor_order=self.speed_factor_order)

    def invert(self, y, z):
        return (y['x'][0], y['y'][0]), (y['x'][1], y['y'][1])

    def derivative(self, x, u):
        return u[0], u[1]

    def margins(self, t, x, u):
        return {
            'obstacle': (x[0] ** 2 + x[1] ** 2) / self.radius**2 - 1.0,
            'speed': 1.0 - (u[0] ** 2 + u[1] ** 2) / self.speed**2,
        }

    def final_cost(self, t, x):
        return t

    def drawing(self, x):
        return Disc((0.0, 0.0), self.radius, 'limit'), Disc((x[0], x[1]), 0.05, trail=True)


def shortest_time(distance: float, radius: float, speed: float) -> float:
    """Return the analytic minimum [s]: tangent, arc, tangent."""
    tangent = math.sqrt(distance**2 - radius**2)
    return (2.0 * tangent + radius * (math.pi - 2.0 * math.acos(radius / distance))) / speed


if __name__ == '__main__':
    problem = RoundTheObstacle(solver=DirectSolverParameters(deadline=10.0, refine=False))
    best = shortest_time(problem.distance, problem.radius, problem.speed)
    print(f'tangent, arc, tangent: {best:.5f} s, refined {RoundTheObstacle().solve().cost:.5f} s')
    print('free parameters    tau = t           dt/ds of degree 3')
    for free in (2, 4, 6, 8):
        times = [replace(problem, free=free, speed_factor_order=k).solve().cost for k in (0, 3)]
        print(
            f'{free:15d}    '
            + '    '.join(f'{t:.4f} s ({100 * (t / best - 1):4.2f} %)' for t in times)
        )
