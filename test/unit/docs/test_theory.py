# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equations of docs/theory.md written down a second time: speed factor, pendulum, cost."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tdm_planner.direct_method.virtual_arc import bernstein_basis, bernstein_integral
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.rotary_pendulum import driven
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation_verification import penalty

RNG = np.random.default_rng(7)
S = np.linspace(0.0, 1.0, 11)
PENDULUM = RotaryPendulum()


def test_the_speed_factor_and_time_along_the_arc():
    """Time is the integral of mu, which is positive where its coefficients are."""
    b = np.array([0.5, 2.0, 1.0])
    expected = sum(b[i] * math.comb(2, i) * S**i * (1 - S) ** (2 - i) for i in range(3))
    assert bernstein_basis(2, S) @ b == pytest.approx(expected)
    assert bernstein_integral(2, 1.0) @ b == pytest.approx(b.sum() / 3)


def test_equations_of_motion_of_the_pendulum():
    theta, psi, q, w = 0.7, 0.3, 5.0, -4.0
    torque = 0.015
    i, m, length = PENDULUM.inertia, PENDULUM.mass, PENDULUM.com_distance
    ml2, mlr = m * length**2, m * length * PENDULUM.arm_length
    a, b, c = i.z + ml2, mlr * math.cos(theta), i.x - i.y + ml2
    turning = (i.x + ml2) * math.sin(theta) ** 2 + i.y * math.cos(theta) ** 2
    j, mgl = i.disk + m * PENDULUM.arm_length**2 + turning, m * PENDULUM.gravity * length
    r1 = c / 2 * w**2 * math.sin(2 * theta) + mgl * math.sin(theta)
    r2 = torque - c * q * w * math.sin(2 * theta) + mlr * q**2 * math.sin(theta)
    d = a * j - b**2
    expected = [q, w, (j * r1 - b * r2) / d, (a * r2 - b * r1) / d]
    state = np.array([theta, psi, q, w])
    assert PENDULUM.derivative(state, np.array([torque])) == pytest.approx(expected)
    energy = a * q**2 / 2 + b * q * w + j * w**2 / 2 + mgl * math.cos(theta)
    assert PENDULUM.energy(state) == pytest.approx(energy)
    assert PENDULUM.natural_frequency == pytest.approx(math.sqrt(mgl / a))
    theta_ddot, found = driven(PENDULUM.coefficients, theta, q, w, expected[3])
    assert found == pytest.approx(torque)
    assert theta_ddot == pytest.approx((r1 - b * expected[3]) / a)


@pytest.fixture(scope='module')
def formation():
    problem = RobotFormation.from_parameters({'solver.deadline': 20.0})
    return problem, problem.solve()


def test_performance_index_is_equation_28(formation):
    problem, solution = formation
    arrivals = sorted(plan.duration for plan in solution.trajectories.values())
    intervals = np.abs(np.diff(arrivals) - problem.arrival_interval).sum()
    gas = sum(plan.control_integral(plan.duration)[0] for plan in solution.trajectories.values())
    w = problem.weights
    j = w.time * arrivals[0] + w.sequence * intervals + w.gas * gas / problem.plant.mass
    assert solution.cost == pytest.approx(j, rel=5e-3)


def test_penalty_is_equation_29_mended(formation):
    task = formation[0].task
    # Everything is violated: walls, limits of all kinds, and the distance of neighbours.
    states, controls = RNG.normal(size=(500, 7 * task.n)), RNG.normal(size=(500, 3 * task.n))
    k = np.array([0.1, 0.2, 0.3, 0.4])
    n, m = task.n, task.separation

    def square(margin: np.ndarray) -> float:
        return float(np.maximum(-margin, 0.0).max() ** 2)

    delta = 0.0
    every = states.reshape(len(states), n, 7)[:, :, :2]
    for i in range(n):
        place = every[:, i]
        f = controls[:, 3 * i] / task.plant.mass / task.thrust
        t = controls[:, 3 * i + 2] / task.plant.inertia / task.torque
        turn = controls[:, 3 * i + 1] / task.thruster_rate
        for q in range(2):
            delta += k[0] * square(place[:, q] - m / 2)
            delta += k[0] * square(task.sides[q] - m / 2 - place[:, q])
        delta += k[1] * square(np.minimum(1 - f, f))
        delta += k[2] * (square(1 - np.abs(t)) + square(1 - np.abs(turn)))
        for other in range(i):
            apart = place - every[:, other]
            delta += k[3] * square(np.hypot(*apart.T) - m)
    assert delta > 0.1
    assert penalty(task, states, controls, k) == pytest.approx(delta, rel=1e-9)
