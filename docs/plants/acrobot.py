# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The acrobot: two links on a free hinge, swung up by a torque at the elbow alone.

The elbow's angle is the reference function; the shoulder, which nothing drives, is integrated,
and the torque follows by inverse dynamics. Two uniform rods, the first of 1 kg and 1 m, the
second light and long. From hanging at rest to standing at rest in a given time with the least
integral of the torque's square.

Run it: ``python docs/plants/acrobot.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.drawing import Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem


@dataclass(frozen=True)
class AcrobotStart(Validated):
    """State to start from, angles from hanging and from the first link."""

    shoulder: float = parameter(0.0, "first link's angle", unit='rad')
    elbow: float = parameter(0.0, 'angle between the links', unit='rad')
    shoulder_rate: float = parameter(0.0, "first link's rate", unit='rad/s')
    elbow_rate: float = parameter(0.0, "the elbow's rate", unit='rad/s')


@dataclass(frozen=True)
class Acrobot(DirectProblem):
    """Swing two links up by the torque between them."""

    name = 'acrobot'
    state_names = ('shoulder', 'elbow', 'shoulder_rate', 'elbow_rate')
    state_units = ('rad', 'rad', 'rad/s', 'rad/s')
    control_names, control_units = ('torque',), ('N m',)

    start: AcrobotStart = group(AcrobotStart)
    lower: float = parameter(0.5, 'mass of the second link', unit='kg', allowed=POSITIVE)
    length: float = parameter(2.0, 'of the second link', unit='m', allowed=POSITIVE)
    torque: float = parameter(15.0, 'largest torque', unit='N m', allowed=POSITIVE)
    time: float = parameter(1.8, 'time for it', unit='s', allowed=POSITIVE)
    free: int = parameter(8, "varied parameters of the elbow's angle", allowed=NON_NEGATIVE)

    def outputs(self):
        start = self.start.elbow, self.start.elbow_rate
        return {'elbow': Output(start=start, end=(0.0, 0.0), free=self.free, scale=1.0)}

    def integrated(self):
        return {
            'shoulder': Integrated(self.start.shoulder, np.pi),
            'shoulder_rate': Integrated(self.start.shoulder_rate, 0.0, scale=3.0),
        }

    def duration(self):
        return Duration(guess=self.time, fixed=True)

    def first_guess(self, s):
        return {'elbow': self.start.elbow * (1.0 - s) + 3.5 * np.sin(np.pi * s)}  # fold, unfold

    def forces(self, p, q, pd, qd):
        """Return the inertias, and what acts on shoulder and elbow beside the torque."""
        m, a = self.lower, self.length
        d, c, s = m * a**2 / 3.0, m * a / 2.0 * np.cos(q), m * a / 2.0 * np.sin(q)
        weight = 9.81 * m * a / 2.0 * np.sin(p + q)
        first = s * (2.0 * pd + qd) * qd - 9.81 * (0.5 + m) * np.sin(p) - weight
        return (1.0 / 3.0 + m + d + 2.0 * c, d + c, d), (first, -s * pd**2 - weight)

    def invert(self, y, z):
        (q, qd, qdd), p, pd = y['elbow'], z['shoulder'], z['shoulder_rate']
        (m11, m12, m22), (first, second) = self.forces(p, q, pd, qd)
        pdd = (first - m12 * qdd) / m11
        return (p, q, pd, qd), (m12 * pdd + m22 * qdd - second,)

    def derivative(self, x, u):
        p, q, pd, qd = x
        (m11, m12, m22), (first, second) = self.forces(p, q, pd, qd)
        qdd = (m11 * (u[0] + second) - m12 * first) / (m11 * m22 - m12**2)
        return pd, qd, (first - m12 * qdd) / m11, qdd

    def control_limits(self):
        return {'torque': (-self.torque, self.torque)}

    def running_cost(self, t, x, u):
        return u[0] ** 2

    def drawing(self, x):
        first, second = x[0], x[0] + x[1]
        elbow = np.sin(first), 0.0, -np.cos(first)
        tip = elbow[0] + self.length * np.sin(second), 0.0, elbow[2] - self.length * np.cos(second)
        return Line(((0.0, 0.0, 0.0), elbow)), Line((elbow, tip), trail=True)


VARIATIONS = (
    {'time': 1.7},
    {'torque': 10.0},
    {'lower': 0.6, 'length': 1.9},
    {'start.shoulder': 0.5, 'start.elbow': -0.4},
    {'start.shoulder_rate': 1.0, 'start.elbow_rate': -1.0},
)
PUBLISHED: dict[str, tuple[float, str]] = {}  # the model: M. W. Spong, 1995

if __name__ == '__main__':
    from table import show

    show(Acrobot, VARIATIONS, PUBLISHED)
