# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Ball and beam: roll the ball along by tilting the beam, in the shortest time.

The beam's angle is the reference function and gives the torque; the ball, which nothing drives
but gravity and the beam's turning, is integrated. The model is Hauser's, with the ball's rolling
inertia; both ends at rest, the beam level.

Run it: ``python docs/plants/ball_and_beam.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.drawing import Disc, Line
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem

G = 9.81
ROLLING = 5.0 / 7.0  # m/(m + J/R^2) of a solid ball


@dataclass(frozen=True)
class BallStart(Validated):
    """State to start from."""

    r: float = parameter(-0.4, "the ball's place along the beam", unit='m')
    v: float = parameter(0.0, "the ball's velocity", unit='m/s')
    theta: float = parameter(0.0, "the beam's angle", unit='rad')
    omega: float = parameter(0.0, "the beam's rate", unit='rad/s')


@dataclass(frozen=True)
class BallAndBeam(DirectProblem):
    """Bring the ball to rest at another place of a level beam."""

    name = 'ball_and_beam'
    state_names, state_units = ('r', 'v', 'theta', 'omega'), ('m', 'm/s', 'rad', 'rad/s')
    control_names, control_units = ('torque',), ('N m',)
    reserve: ClassVar = {'angle': 0.1}  # overshot where constants are off

    start: BallStart = group(BallStart)
    goal: float = parameter(0.4, 'place to bring the ball to', unit='m')
    ball: float = parameter(0.1, "the ball's mass", unit='kg', allowed=POSITIVE)
    inertia: float = parameter(0.02, "the beam's inertia", unit='kg m^2', allowed=POSITIVE)
    torque: float = parameter(0.6, 'largest torque', unit='N m', allowed=POSITIVE)
    angle: float = parameter(0.35, 'largest angle', unit='rad', allowed=POSITIVE)
    half: float = parameter(0.5, "half of the beam's length", unit='m', allowed=POSITIVE)
    free: int = parameter(10, "varied parameters of the beam's angle", allowed=NON_NEGATIVE)

    def outputs(self):
        start = self.start.theta, self.start.omega
        return {'theta': Output(start=start, end=(0.0, 0.0), free=self.free, scale=self.angle)}

    def integrated(self):
        return {'r': Integrated(self.start.r, self.goal), 'v': Integrated(self.start.v, 0.0)}

    def duration(self):
        return Duration(guess=2.0)

    def load(self, r, v, theta, omega):
        """Return the inertia of beam and ball, and the torque that needs no acceleration."""
        moment = self.ball * r * (2.0 * v * omega + G * np.cos(theta))
        return self.inertia + self.ball * r**2, moment

    def invert(self, y, z):
        (theta, omega, alpha), r, v = y['theta'], z['r'], z['v']
        inertia, moment = self.load(r, v, theta, omega)
        return (r, v, theta, omega), (inertia * alpha + moment,)

    def derivative(self, x, u):
        r, v, theta, omega = x
        inertia, moment = self.load(r, v, theta, omega)
        rolls = ROLLING * (r * omega**2 - G * np.sin(theta))
        return v, rolls, omega, (u[0] - moment) / inertia

    def control_limits(self):
        return {'torque': (-self.torque, self.torque)}

    def margins(self, t, x, u):
        r, theta = x[0], x[2]
        return {'beam': 1.0 - (r / self.half) ** 2, 'angle': 1.0 - (theta / self.angle) ** 2}

    def final_cost(self, t, x):
        return t

    def drawing(self, x):
        r, c, s, ball = x[0], np.cos(x[2]), np.sin(x[2]), 0.06 * self.half
        ends = [(k * self.half * c, 0.0, k * self.half * s) for k in (-1.0, 1.0)]
        centre = r * c - 1.2 * ball * s, 0.0, r * s + 1.2 * ball * c
        post = Line(((0.0, 0.0, 0.0), (0.0, 0.0, -0.5 * self.half)))
        return post, Line(ends), Disc(centre, ball, trail=True)


VARIATIONS = (
    {'angle': 0.15},
    {'torque': 0.45},
    {'start.r': 0.3, 'start.v': 0.5, 'goal': 0.0},
    {'ball': 0.2, 'torque': 1.0},
    {'start.theta': 0.1, 'start.omega': -0.5, 'goal': 0.2},
)
PUBLISHED: dict[str, tuple[float, str]] = {}  # the model: J. Hauser et al., 1992

if __name__ == '__main__':
    from table import show

    show(BallAndBeam, VARIATIONS, PUBLISHED)
