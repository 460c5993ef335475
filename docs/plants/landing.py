# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Landing approach of a small fixed-wing aircraft: a path in space, and the speed along it.

The three coordinates are polynomials of the virtual arc, the speed is given its own freedom by
the speed factor - Taranenko's fourth reference function in (1). Thrust, load factor and bank angle
follow by inverse dynamics of a point mass,

    V.     = T/m - D/m - g sin(gamma)          gamma path angle, chi heading
    gamma. = g/V (n cos(phi) - cos(gamma))     n load factor, phi bank angle
    chi.   = g n sin(phi)/(V cos(gamma))       D = c0 V^2 + c1 n^2/V^2

From cruise to the threshold of a runway to the side, along its direction, at landing speed, within
the limits of the engine, of load factor and bank, and of the stall, for the least

    J = t_f + comfort * integral of (n sin(phi))^2 + (n cos(phi) - 1)^2,

the second part being the load beyond that of straight level flight. `landing_reference.py`
computes the optimum by full collocation. With ``comfort = 0``, time alone, there is none that
could be flown: the aircraft dives, and then brakes by induced drag, with the bank thrown from
limit to limit, the oftener the more intervals the collocation has. No smooth function does that.

Run it: ``python docs/plants/landing.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Box, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem, DirectSolverParameters, Solution

G = 9.81
DRAG, INDUCED = 2.0e-3, 80.0  # c0 [1/m], c1 [m^3/s^4], per unit of mass


@dataclass(frozen=True)
class Approach(Validated):
    """Position, speed and direction at one end."""

    x: float = parameter(0.0, 'east', unit='m')
    y: float = parameter(0.0, 'north', unit='m')
    h: float = parameter(60.0, 'height', unit='m')
    speed: float = parameter(25.0, 'airspeed', unit='m/s', allowed=POSITIVE)
    path_angle: float = parameter(0.0, 'path angle', unit='rad')
    heading: float = parameter(0.0, 'heading', unit='rad')

    def conditions(self) -> np.ndarray:
        """Position and velocity, (3, 2)."""
        level = self.speed * math.cos(self.path_angle)
        velocity = level * np.cos(self.heading), level * np.sin(self.heading)
        climb = self.speed * math.sin(self.path_angle)
        return np.array([[self.x, velocity[0]], [self.y, velocity[1]], [self.h, climb]])


THRESHOLD = Approach(x=500.0, y=300.0, h=2.0, speed=16.0, path_angle=-0.06, heading=2.2)


def drag(v: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Drag per unit of mass [m/s^2], from speed and load factor."""
    return DRAG * v**2 + INDUCED * n**2 / v**2


@dataclass(frozen=True)
class Landing(DirectProblem):
    """Reach the runway's threshold soon and in comfort."""

    name: ClassVar[str] = 'landing'
    state_names = ('x', 'y', 'h', 'speed', 'path_angle', 'heading')
    state_units = ('m', 'm', 'm', 'm/s', 'rad', 'rad')
    control_names, control_units = ('thrust', 'load', 'bank'), ('m/s^2', '', 'rad')

    starts: ClassVar[int] = 8  # there are local minima

    start: Approach = group(Approach)
    thrust: float = parameter(4.0, 'largest thrust per mass', unit='m/s^2', allowed=POSITIVE)
    load: float = parameter(1.8, 'largest load factor', allowed=POSITIVE)
    bank: float = parameter(0.9, 'largest bank angle', unit='rad', allowed=POSITIVE)
    stall: float = parameter(14.0, 'stall speed at n = 1', unit='m/s', allowed=POSITIVE)
    comfort: float = parameter(2.0, 'weight of uncomfortable load', allowed=NON_NEGATIVE)
    free: int = parameter(6, 'varied parameters of each coordinate', allowed=NON_NEGATIVE)
    speed_factor_order: int = parameter(2, 'degree of dt/ds', allowed=NON_NEGATIVE)

    goal: ClassVar[Approach] = THRESHOLD

    def outputs(self):
        ends = zip('xyh', self.start.conditions(), self.goal.conditions(), strict=True)
        return {n: Output(start=a, end=b, free=self.free, scale=200.0) for n, a, b in ends}

    def duration(self):
        return Duration(guess=40.0, speed_factor_order=self.speed_factor_order)

    def invert(self, y, z):
        (px, vx, ax), (py, vy, ay), (h, vh, ah) = y['x'], y['y'], y['h']
        level = np.sqrt(vx**2 + vy**2)
        v = np.sqrt(level**2 + vh**2)
        gamma, chi = np.arctan(vh / level), np.arctan2(vy, vx)
        v_dot = (vx * ax + vy * ay + vh * ah) / v
        gamma_dot = (ah - v_dot * vh / v) / level
        chi_dot = (vx * ay - vy * ax) / level**2
        up, side = v * gamma_dot / G + level / v, level * chi_dot / G
        n = np.sqrt(up**2 + side**2)
        thrust = v_dot + drag(v, n) + G * vh / v
        return (px, py, h, v, gamma, chi), (thrust, n, np.arctan2(side, up))

    def derivative(self, x, u):
        (_, _, _, v, gamma, chi), (thrust, n, bank) = x, u
        level = v * np.cos(gamma)
        return (
            level * np.cos(chi),
            level * np.sin(chi),
            v * np.sin(gamma),
            thrust - drag(v, n) - G * np.sin(gamma),
            G / v * (n * np.cos(bank) - np.cos(gamma)),
            G * n * np.sin(bank) / level,
        )

    def margins(self, t, x, u):
        return {
            'full thrust': 1.0 - u[0] / self.thrust,
            'engine idle': u[0] / self.thrust,
            'load factor': 1.0 - u[1] / self.load,
            'bank': 1.0 - (u[2] / self.bank) ** 2,
            'stall': (x[3] / self.stall) ** 2 - u[1],
            'ground': x[2] / 100.0,
        }

    def final_cost(self, t, x):
        return t

    def running_cost(self, t, x, u):
        return self.comfort * (u[1] ** 2 - 2.0 * u[1] * np.cos(u[2]) + 1.0)

    def drawing(self, x):
        end, size = self.goal, 24.0  # of an aircraft that can be seen beside its way
        far = end.x + 150.0 * np.cos(end.heading), end.y + 150.0 * np.sin(end.heading), 0.0
        hull = Box(x[:3], (size, size / 8.0, size / 8.0), turn=x[5], trail=True)
        wings = Box(x[:3], (size / 6.0, size, size / 20.0), turn=x[5])
        return Line(((end.x, end.y, 0.0), far), 'limit'), hull, wings


def table(counts: tuple[int, ...], orders: tuple[int, ...]) -> dict[tuple[int, int], Solution]:
    """Plans of the direct method by the free parameters of a coordinate, the degree of dt/ds."""
    solver = DirectSolverParameters(deadline=60.0, refine=False)  # never reached here
    problem = Landing(solver=solver)
    return {
        (free, order): replace(problem, free=free, speed_factor_order=order).solve()
        for free in counts
        for order in orders
    }


if __name__ == '__main__':
    print('free of each    degree of dt/ds    varied parameters    J [s]     t_f [s]')
    for (free, order), plan in table((2, 3, 6, 9), (0, 2)).items():
        count = plan.parameters.size
        print(f'{free:12d}    {order:15d}    {count:17d}    {plan.cost:.4f}   {plan.duration:.3f}')
