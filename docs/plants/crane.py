# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A crane whose rope swings twice: the hook below the trolley, the load below the hook.

The trolley's place is the reference function and its acceleration the control; both angles,
measured from the vertical, are integrated. From rest to rest, nothing swinging, in the shortest
time, within the trolley's speed and acceleration and an angle that the load may reach.

Run it: ``python docs/plants/crane.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.drawing import Box, Disc, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem

G = 9.81


@dataclass(frozen=True)
class CraneStart(Validated):
    """State to start from."""

    x: float = parameter(0.0, "the trolley's place", unit='m')
    hook: float = parameter(0.0, "the hook rope's angle", unit='rad')
    load: float = parameter(0.0, "the load rope's angle", unit='rad')
    v: float = parameter(0.0, "the trolley's velocity", unit='m/s')
    hook_rate: float = parameter(0.0, "the hook rope's rate", unit='rad/s')
    load_rate: float = parameter(0.0, "the load rope's rate", unit='rad/s')


@dataclass(frozen=True)
class Crane(DirectProblem):
    """Carry a load to another place without letting it swing there."""

    name = 'crane'
    state_names = ('x', 'hook', 'load', 'v', 'hook_rate', 'load_rate')
    state_units = ('m', 'rad', 'rad', 'm/s', 'rad/s', 'rad/s')
    control_names, control_units = ('a',), ('m/s^2',)

    start: CraneStart = group(CraneStart)
    goal: float = parameter(8.0, 'place to bring the load to', unit='m')
    hook_rope: float = parameter(4.0, 'from trolley to hook', unit='m', allowed=POSITIVE)
    load_rope: float = parameter(2.0, 'from hook to load', unit='m', allowed=POSITIVE)
    ratio: float = parameter(2.0, "the load's mass by the hook's", allowed=POSITIVE)
    acceleration: float = parameter(1.0, 'largest', unit='m/s^2', allowed=POSITIVE)
    speed: float = parameter(2.0, 'largest', unit='m/s', allowed=POSITIVE)
    swing: float = parameter(0.3, 'largest angle', unit='rad', allowed=POSITIVE)
    free: int = parameter(10, "varied parameters of the trolley's place", allowed=NON_NEGATIVE)

    def outputs(self):
        start, end = (self.start.x, self.start.v), (self.goal, 0.0)
        return {'x': Output(start=start, end=end, free=self.free, scale=5.0)}

    def integrated(self):
        names = 'hook', 'load', 'hook_rate', 'load_rate'
        return {n: Integrated(getattr(self.start, n), 0.0, scale=0.3) for n in names}

    def duration(self):
        return Duration(guess=8.0)

    def invert(self, y, z):
        x, v, a = y['x']
        return (x, z['hook'], z['load'], v, z['hook_rate'], z['load_rate']), (a,)

    def derivative(self, x, u):
        _, p, q, v, pd, qd = x
        k, c, s = self.ratio / (1.0 + self.ratio), np.cos(p - q), np.sin(p - q)
        first = -k * s * self.load_rope * qd**2 - G * np.sin(p) - u[0] * np.cos(p)
        second = s * self.hook_rope * pd**2 - G * np.sin(q) - u[0] * np.cos(q)
        pull = 1.0 - k * c**2
        hook, load = (first - k * c * second) / pull, (second - c * first) / pull
        return v, pd, qd, u[0], hook / self.hook_rope, load / self.load_rope

    def control_limits(self):
        return {'a': (-self.acceleration, self.acceleration)}

    def margins(self, t, x, u):
        angles = {'hook': x[1], 'load': x[2]}
        swings = {n: 1.0 - (angle / self.swing) ** 2 for n, angle in angles.items()}
        return {'speed': 1.0 - (x[3] / self.speed) ** 2, **swings}

    def final_cost(self, t, x):
        return t

    def drawing(self, x):
        at, a, b = (x[0], 0.0, 0.0), self.hook_rope, self.load_rope
        hook = x[0] + a * np.sin(x[1]), 0.0, -a * np.cos(x[1])
        load = hook[0] + b * np.sin(x[2]), 0.0, hook[2] - b * np.cos(x[2])
        rail = Line(((self.start.x, 0.0, 0.0), (self.goal, 0.0, 0.0)), 'limit')
        return rail, Box(at, (0.6, 0.4, 0.3)), Line((at, hook, load)), Disc(load, 0.3, trail=True)


VARIATIONS = (
    {'goal': 3.0},
    {'swing': 0.12},
    {'hook_rope': 6.0, 'load_rope': 1.0, 'ratio': 10.0},
    {'speed': 1.0, 'goal': 6.0},
    {'start.v': 0.5, 'start.hook': 0.05, 'start.load': 0.08},
)
PUBLISHED: dict[str, tuple[float, str]] = {}

if __name__ == '__main__':
    from table import show

    show(Crane, VARIATIONS, PUBLISHED)
