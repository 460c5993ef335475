# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A satellite's turn in the shortest time: not about one axis, though it be all alike.

A rigid body turns from rest to rest by torques about its three axes, each limited for itself. Its
attitude is given by modified Rodrigues parameters, tangent of a quarter of the angle times the
axis: regular to a full turn, and the reference functions. Rate and torque follow from them.
For half a turn of a body of equal inertias about one of its axes the optimum is known; a turn
about that axis alone takes 2 sqrt(pi) s, 9 % longer.

Run it: ``python docs/plants/satellite.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Box, Line, points_of
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem

# What is drawn, in the axes of the body: the edges of its hull and panels, and an antenna.
HULL = points_of(Box((0.0, 0.0, 0.0), (0.6, 0.6, 0.9)), 1)[0]
PANELS = points_of(Box((0.0, 0.0, 0.0), (2.6, 0.5, 0.02)), 1)[0]
ANTENNA = (0.0, 0.0, 0.45), (0.5, 0.0, 1.0)


def dot(a, b):
    """Return the product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def mixed(*terms):
    """Return the sum of vectors, each given with its factor."""
    return [sum(f * v[i] for f, v in terms) for i in range(3)]


@dataclass(frozen=True)
class SatelliteStart(Validated):
    """State to start from: attitude by modified Rodrigues parameters, and body rates."""

    s1: float = parameter(0.0, 'attitude about the first axis')
    s2: float = parameter(0.0, 'attitude about the second axis')
    s3: float = parameter(0.0, 'attitude about the third axis')
    w1: float = parameter(0.0, 'rate about the first axis', unit='rad/s')
    w2: float = parameter(0.0, 'rate about the second axis', unit='rad/s')
    w3: float = parameter(0.0, 'rate about the third axis', unit='rad/s')


@dataclass(frozen=True)
class Satellite(DirectProblem):
    """Turn to another attitude, and stop."""

    name = 'satellite'
    state_names, state_units = ('s1', 's2', 's3', 'w1', 'w2', 'w3'), ('',) * 3 + ('rad/s',) * 3
    control_names, control_units = ('t1', 't2', 't3'), ('N m',) * 3

    start: SatelliteStart = group(SatelliteStart)
    goal: list[float] = parameter([0.0, 0.0, 1.0], 'attitude to turn to', length=3)
    inertia: list[float] = parameter([1.0] * 3, 'principal inertias', unit='kg m^2', length=3)
    torque: float = parameter(1.0, 'largest about each axis', unit='N m', allowed=POSITIVE)
    free: int = parameter(8, 'varied parameters of each coordinate', allowed=NON_NEGATIVE)

    def outputs(self):
        s = self.start
        at, rate = (s.s1, s.s2, s.s3), self.attitude_rate((s.s1, s.s2, s.s3), (s.w1, s.w2, s.w3))
        rows = zip(('s1', 's2', 's3'), at, rate, self.goal, strict=True)
        return {n: Output((a, b), (e, 0.0), free=self.free, scale=1.0) for n, a, b, e in rows}

    def duration(self):
        return Duration(guess=4.0)

    def attitude_rate(self, s, w):
        factor = (1.0 - dot(s, s)) / 4.0
        return mixed((factor, w), (0.5, cross(s, w)), (0.5 * dot(s, w), s))

    def invert(self, y, z):
        s, d, a = zip(y['s1'], y['s2'], y['s3'], strict=True)
        left, k = 1.0 - dot(s, s), 4.0 / (1.0 + dot(s, s)) ** 2
        w = mixed((k * left, d), (-2.0 * k, cross(s, d)), (2.0 * k * dot(s, d), s))
        along = 2.0 * k * (dot(d, d) + dot(s, a))
        fade = -4.0 * dot(s, d) / (1.0 + dot(s, s))
        wd = mixed((k * left, a), (-2.0 * k, cross(s, a)), (along, s), (fade, w))
        spin = [j * rate for j, rate in zip(self.inertia, w, strict=True)]
        gyro = cross(w, spin)
        return (*s, *w), tuple(self.inertia[i] * wd[i] + gyro[i] for i in range(3))

    def derivative(self, x, u):
        s, w = x[:3], x[3:]
        gyro = cross(w, [j * rate for j, rate in zip(self.inertia, w, strict=True)])
        turn = [(u[i] - gyro[i]) / self.inertia[i] for i in range(3)]
        return (*self.attitude_rate(s, w), *turn)

    def control_limits(self):
        return dict.fromkeys(self.control_names, (-self.torque, self.torque))

    def final_cost(self, t, x):
        return t

    def turned(self, s, v):
        """Return where a vector of the body points in space."""
        k, across = 4.0 / (1.0 + dot(s, s)) ** 2, cross(s, v)
        return mixed((1.0, v), (k * (1.0 - dot(s, s)), across), (2.0 * k, cross(s, across)))

    def drawing(self, x):
        ways = [[self.turned(x[:3], v) for v in way] for way in (HULL, PANELS, ANTENNA)]
        return Line(ways[0]), Line(ways[1]), Line(ways[2], trail=True)


VARIATIONS = (
    {'goal': [0.0, 0.0, 0.41421356]},
    {'torque': 0.5, 'goal': [0.3, -0.2, 0.5]},
    {'inertia': [1.0, 2.0, 3.0], 'goal': [0.5, 0.0, 0.3]},
    {'start.w1': 0.3, 'start.w2': -0.2},
    {'inertia': [2.0, 2.0, 0.8], 'goal': [0.0, 0.7, 0.0]},
)
PAPER = (
    'K. D. Bilimoria, B. Wie, Time-optimal three-axis reorientation of a rigid spacecraft,'
    ' J. Guidance, Control, and Dynamics 16(3), 1993'
)
PUBLISHED = {'default': (3.2430, PAPER)}

if __name__ == '__main__':
    from table import show

    show(Satellite, VARIATIONS, PUBLISHED)
