# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Overtaking: a car by the kinematic bicycle model, past one that drives ahead, and back in lane.

The flat outputs are the rear axle's coordinates; speed, heading and steering angle follow from
them. The other car drives on while we pass it: the limit that keeps us out
of the ellipse round it depends on time. To a place down the road in our lane, soon and without
hard accelerations:

    J = t_f + comfort * integral of (a^2 + (v^2 curvature)^2).

Run it: ``python docs/plants/overtaking.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Box, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Range, Validated
from tdm_planner.problems import DirectProblem


@dataclass(frozen=True)
class CarStart(Validated):
    """State to start from."""

    x: float = parameter(0.0, 'along the road', unit='m')
    y: float = parameter(0.0, 'across the road, from our lane', unit='m')
    heading: float = parameter(0.0, 'heading', unit='rad')
    v: float = parameter(20.0, 'speed', unit='m/s', allowed=POSITIVE)


@dataclass(frozen=True)
class Overtaking(DirectProblem):
    """Pass a slower car."""

    state_names, state_units = ('x', 'y', 'heading', 'v'), ('m', 'm', 'rad', 'm/s')
    control_names, control_units = ('a', 'steering'), ('m/s^2', 'rad')

    start: CarStart = group(CarStart)
    goal: float = parameter(200.0, 'place to be back in lane', unit='m', allowed=POSITIVE)
    end_speed: float = parameter(22.0, 'speed there', unit='m/s', allowed=POSITIVE)
    ahead: float = parameter(30.0, 'from us to the other car', unit='m', allowed=POSITIVE)
    other: float = parameter(12.0, "the other car's speed", unit='m/s', allowed=NON_NEGATIVE)
    wheelbase: float = parameter(2.8, 'wheelbase', unit='m', allowed=POSITIVE)
    speed: float = parameter(30.0, 'largest speed', unit='m/s', allowed=POSITIVE)
    grip: float = parameter(5.0, 'largest acceleration', unit='m/s^2', allowed=POSITIVE)
    lock: float = parameter(0.5, 'largest steering angle', unit='rad', allowed=Range(0.0, 1.5))
    comfort: float = parameter(0.02, 'weight of accelerations', allowed=NON_NEGATIVE)
    free: int = parameter(6, 'varied parameters of each coordinate', allowed=NON_NEGATIVE)

    def outputs(self):
        s, g = self.start, self.goal
        x = Output((s.x, s.v * np.cos(s.heading)), (g, self.end_speed), self.free, scale=100.0)
        y = Output((s.y, s.v * np.sin(s.heading)), (0.0, 0.0), self.free, scale=3.0)
        return {'x': x, 'y': y}

    def duration(self):
        return Duration(guess=2.0 * self.goal / (self.start.v + self.end_speed))

    def first_guess(self, s):
        x = self.start.x + (self.goal - self.start.x) * s
        return {'x': x, 'y': self.start.y * (1.0 - s) + 3.0 * np.sin(np.pi * s) ** 2}

    def invert(self, y, z):
        (px, vx, ax), (py, vy, ay) = y['x'], y['y']
        v = np.hypot(vx, vy)
        steering = np.arctan(self.wheelbase * (vx * ay - vy * ax) / v**3)
        return (px, py, np.arctan2(vy, vx), v), ((vx * ax + vy * ay) / v, steering)

    def side(self, v, steering):
        return v**2 * np.tan(steering) / self.wheelbase

    def derivative(self, x, u):
        return x[3] * np.cos(x[2]), x[3] * np.sin(x[2]), self.side(x[3], u[1]) / x[3], u[0]

    def control_limits(self):
        return {'a': (-self.grip, self.grip), 'steering': (-self.lock, self.lock)}

    def margins(self, t, x, u):
        apart = (x[0] - self.ahead - self.other * t) / 8.0, x[1] / 2.5
        return {
            'other car': apart[0] ** 2 + apart[1] ** 2 - 1.0,
            'left edge': (5.0 - x[1]) / 5.0,
            'right edge': (x[1] + 1.0) / 5.0,
            'speed': 1.0 - x[3] / self.speed,
            'grip': 1.0 - (u[0] ** 2 + self.side(x[3], u[1]) ** 2) / self.grip**2,
        }

    def running_cost(self, t, x, u):
        return 1.0 + self.comfort * (u[0] ** 2 + self.side(x[3], u[1]) ** 2)

    def drawing(self, x):
        edges = [Line(((self.start.x, y), (self.goal, y)), 'limit') for y in (-2.0, 6.0)]
        return *edges, Box((x[0], x[1]), (4.5, 1.8), turn=x[2], trail=True)


VARIATIONS = (
    {'other': 5.0, 'ahead': 40.0},
    {'other': 15.0, 'ahead': 20.0, 'goal': 300.0},
    {'speed': 25.0, 'start.v': 24.0},
    {'start.y': 0.5, 'start.heading': -0.03, 'start.v': 17.0},
    {'grip': 3.0, 'comfort': 0.1},
)
PUBLISHED: dict[str, tuple[float, str]] = {}

if __name__ == '__main__':
    from table import show

    show(Overtaking, VARIATIONS, PUBLISHED, plane=('x', 'y'))
