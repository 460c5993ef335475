# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A stated problem whose ends must be shot at: a pole swung up by the acceleration of its cart."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem, DirectSolverParameters

GRAVITY, LENGTH = 9.81, 0.5


@dataclass(frozen=True)
class CartPole(DirectProblem, Validated):
    """Least effort over a fixed time; the track is short."""

    name: ClassVar[str] = 'cart_pole'
    state_names, state_units = ('x', 'v', 'angle', 'rate'), ('m', 'm/s', 'rad', 'rad/s')
    control_names, control_units = ('acceleration',), ('m/s^2',)

    time: float = parameter(2.0, 'time', unit='s', allowed=POSITIVE)
    free: int = parameter(4, 'varied parameters')
    solver: DirectSolverParameters = group(DirectSolverParameters)

    def outputs(self):
        return {'x': Output((0.0, 0.0), (0.0, 0.0), free=self.free, scale=0.5)}

    def integrated(self):
        return {'angle': Integrated(math.pi, 0.0), 'rate': Integrated(0.0, 0.0, scale=5.0)}

    def duration(self):
        return Duration(self.time, fixed=True)

    def invert(self, y, z):
        return (*y['x'][:2], z['angle'], z['rate']), y['x'][2:]

    def derivative(self, x, u):
        return x[1], u[0], x[3], (GRAVITY * np.sin(x[2]) - u[0] * np.cos(x[2])) / LENGTH

    def margins(self, t, x, u):
        return {'track': 1.0 - x[0] ** 2}

    def running_cost(self, t, x, u):
        return u[0] ** 2


PATIENT = DirectSolverParameters(deadline=60.0)


@pytest.mark.parametrize('time', [1.5, 2.0, 2.5])
def test_swing_up_ends_upright_when_flown_by_another_integrator(time):
    class Quick(CartPole):
        starts = 2

    plan = Quick(time=time, solver=PATIENT).solve().trajectory
    control = CubicSpline(plan.times, plan.control('acceleration'))

    def motion(t, x):
        a = float(control(t))
        return [x[1], a, x[3], (GRAVITY * math.sin(x[2]) - a * math.cos(x[2])) / LENGTH]

    flown = solve_ivp(motion, (0.0, time), [0.0, 0.0, math.pi, 0.0], rtol=1e-9, atol=1e-9)
    assert np.abs(flown.y[:, -1]) == pytest.approx(0.0, abs=0.02)
    assert np.abs(flown.y[0]).max() < 1.0


def test_more_parameters_cost_less():
    class Quick(CartPole):
        starts = 2

    few, more = (Quick(time=2.5, free=free, solver=PATIENT).solve().cost for free in (4, 8))
    assert more < 0.95 * few
