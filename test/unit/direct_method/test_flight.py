# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The compiled replay of a plan is that of scipy, to its tolerances."""

from typing import ClassVar

import numpy as np
import pytest
from tdm_planner.direct_method import Budget, Duration, Formulation, Output
from tdm_planner.direct_method.flight import Flown
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from tdm_planner.verification import fly


class Pendulum(Formulation):
    """A damped pendulum, whose `damping` makes it as stiff as one likes."""

    state_names: ClassVar = ('angle', 'rate')
    state_units: ClassVar = ('rad', 'rad/s')
    control_names: ClassVar = ('torque',)
    control_units: ClassVar = ('1/s^2',)
    damping = 0.1

    def outputs(self):
        return {'angle': Output((0.3, 0.0), (1.0, 0.0), free=1)}

    def duration(self):
        return Duration(2.0)

    def invert(self, y, z):
        angle, rate, acceleration = y['angle']
        return (angle, rate), (acceleration + 9.81 * np.sin(angle) + self.damping * rate,)

    def derivative(self, x, u):
        return x[1], u[0] - 9.81 * np.sin(x[0]) - self.damping * x[1]

    def final_cost(self, t, x):
        return t


class Escaping(Pendulum):
    """A plant that is at infinity before long."""

    def invert(self, y, z):
        angle, rate, acceleration = y['angle']
        return (angle, rate), (acceleration - rate**3,)

    def derivative(self, x, u):
        return x[1], u[0] + x[1] ** 3


def plan(intervals, interpolation='linear', size=20.0):
    controls = size * np.random.default_rng(0).normal(size=(intervals + 1, 1))
    times = to_nanoseconds(np.linspace(0.0, 2.0, intervals + 1))
    return Trajectory.of(
        Pendulum, times, np.tile([0.3, -0.5], (intervals + 1, 1)), controls, interpolation
    )


class Plain(DirectPlant):
    """It is left to scipy."""

    def fly(self, trajectory, until):
        return None


@pytest.mark.parametrize('interpolation', ['linear', 'zero_order_hold'])
@pytest.mark.parametrize('intervals', [1, 5, 40])
@pytest.mark.parametrize('damping', [0.1, 300.0])
def test_it_flies_as_scipy_does(intervals, damping, interpolation):
    pendulum = type('Damped', (Pendulum,), {'damping': damping})()
    trajectory, times = plan(intervals, interpolation), np.linspace(0.0, 2.0, 777)
    compiled, plain = (fly(plant(pendulum), trajectory) for plant in (DirectPlant, Plain))
    assert isinstance(compiled, Flown)
    assert len(plain.pieces) == intervals
    np.testing.assert_allclose(compiled.states(times), plain.states(times), rtol=0, atol=1e-6)
    assert set(trajectory.times) <= set(compiled.steps)


def test_a_plan_that_cannot_be_flown_is_left_to_scipy():
    trajectory = plan(4, size=5.0)
    compiled, plain = (fly(plant(Escaping()), trajectory) for plant in (DirectPlant, Plain))
    times = trajectory.times
    np.testing.assert_allclose(compiled.states(times), plain.states(times), rtol=1e-9)
    assert np.isnan(compiled.states(times)).any()


def test_cubic_controls_and_a_spent_budget_are_left_to_scipy():
    plant = DirectPlant(Pendulum())
    assert plant.fly(plan(4, 'cubic'), None) is None
    assert plant.fly(plan(4), Budget(0.0)) is None
