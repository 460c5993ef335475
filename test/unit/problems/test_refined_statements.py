# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Stated plants that only the refinement's own care solves: kinks in limits, unstable motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.parameters import parameter
from tdm_planner.problems import DirectProblem


@dataclass(frozen=True)
class Slalom(DirectProblem):
    """A unicycle between three posts in least time, its sideways acceleration limited."""

    name = 'slalom'
    state_names, state_units = ('x', 'y', 'yaw', 'v'), ('m', 'm', 'rad', 'm/s')
    control_names, control_units = ('a', 'omega'), ('m/s^2', 'rad/s')
    folded: bool = parameter(True, 'whether the limit is stated by an absolute value')

    def outputs(self):
        return {
            'yaw': Output(start=(0.0,), end=(0.0,), free=9, derivatives=1),
            'v': Output(start=(0.5,), end=(0.5,), free=6, derivatives=1),
        }

    def integrated(self):
        return {'x': Integrated(0.0, 14.0), 'y': Integrated(0.0, 0.0)}

    def duration(self):
        return Duration(guess=6.0)

    def invert(self, y, z):
        (yaw, omega), (v, a) = y['yaw'], y['v']
        return (z['x'], z['y'], yaw, v), (a, omega)

    def derivative(self, x, u):
        return x[3] * np.cos(x[2]), x[3] * np.sin(x[2]), u[1], u[0]

    def control_limits(self):
        return {'a': (-1.5, 1.5), 'omega': (-1.5, 1.5)}

    def margins(self, t, x, u):
        sideways = x[3] * u[1]
        grip = {'left': 3.0 - sideways, 'right': 3.0 + sideways}
        if self.folded:
            grip = {'grip': 3.0 - np.abs(sideways)}
        posts = ((3.5, 0.2), (7.0, -0.2), (10.5, 0.2))
        return grip | {f'{px:g}': np.hypot(x[0] - px, x[1] - py) - 1.5 for px, py in posts}

    def final_cost(self, t, x):
        return t


def test_an_absolute_value_in_a_limit_costs_nothing() -> None:
    """Collocation that meets the kink at every turn ended 16 % above this, or nowhere."""
    folded, smooth = (Slalom(folded=how).solve() for how in (True, False))
    assert folded.cost == pytest.approx(smooth.cost, rel=1e-3)
    assert folded.cost < 5.61


@dataclass(frozen=True)
class Balanced(DirectProblem):
    """A rod upright on a cart, moved by 3 m in least time: e^15 times what it is off at first."""

    name = 'balanced'
    state_names, state_units = ('x', 'v', 'phi', 'omega'), ('m', 'm/s', 'rad', 'rad/s')
    control_names, control_units = ('a',), ('m/s^2',)
    rate: float = parameter(6.5, 'rate at which the rod falls', unit='1/s')

    def outputs(self):
        return {'phi': Output(start=(0.0, 0.0), end=(0.0, 0.0), free=10)}

    def integrated(self):
        return {'x': Integrated(-3.0, 0.0), 'v': Integrated(0.0, 0.0)}

    def duration(self):
        return Duration(guess=3.0)

    def invert(self, y, z):
        phi, omega, alpha = y['phi']
        return (z['x'], z['v'], phi, omega), (9.81 * (phi - alpha / self.rate**2),)

    def derivative(self, x, u):
        return x[1], u[0], x[3], self.rate**2 * (x[2] - u[0] / 9.81)

    def control_limits(self):
        return {'a': (-4.0, 4.0)}

    def margins(self, t, x, u):
        return {'lean': 0.3 - np.abs(x[2])}

    def final_cost(self, t, x):
        return t


def test_an_unstable_plant_lands_where_its_controls_lead() -> None:
    problem = Balanced()
    plan = problem.solve().trajectory
    state = np.array([-3.0, 0.0, 0.0, 0.0])
    pieces = zip(plan.times, plan.times[1:], plan.controls, plan.controls[1:], strict=False)
    for begin, end, first, last in pieces:

        def rates(t, x, a=begin, b=end, u=first, w=last):
            return problem.derivative(x, u + (t - a) / (b - a) * (w - u))

        found = solve_ivp(rates, (begin, end), state, method='DOP853', rtol=1e-11, atol=1e-13)
        state = found.y[:, -1]
    assert np.abs(state).max() < 2e-3
