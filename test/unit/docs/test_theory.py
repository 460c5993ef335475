# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equations of docs/theory.md written down a second time: pendulum, cost and penalty."""

from __future__ import annotations

import math

import numpy as np
import pytest
from replays import pendulum_rates
from tdm_planner.direct_method.virtual_arc import bernstein_basis, bernstein_integral
from tdm_planner.parameters import to_mapping
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.rotary_pendulum import driven
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation_verification import (
    penalty,
    robot_constraints,
    separation_constraints,
)
from tdm_planner.verification import check

RNG = np.random.default_rng(7)


def test_the_speed_factor_and_time_along_the_arc():
    b, s = np.array([0.5, 2.0, 1.0]), np.linspace(0.0, 1.0, 11)
    expected = sum(b[i] * math.comb(2, i) * s**i * (1 - s) ** (2 - i) for i in range(3))
    assert bernstein_basis(2, s) @ b == pytest.approx(expected)
    assert bernstein_integral(2, 1.0) @ b == pytest.approx(b.sum() / 3)


def test_equations_of_motion_and_energy_of_the_pendulum():
    """By the mass matrix; the energy changes by what the torque does."""
    plant, torque = RotaryPendulum(), 0.015
    constants = {f'plant.{name}': value for name, value in to_mapping(plant).items()}
    rates = pendulum_rates(constants)
    for state in RNG.normal(size=(5, 4)) * [3.0, 1.0, 5.0, 5.0]:
        expected = rates(state.tolist(), [torque])
        assert plant.derivative(state, np.array([torque])) == pytest.approx(expected)
        slope = (plant.energy(state + 1e-6 * np.array(expected)) - plant.energy(state)) / 1e-6
        assert slope == pytest.approx(torque * state[3], abs=1e-4)
        theta_ddot, found = driven(plant.coefficients, state[0], *state[2:], expected[3])
        assert (theta_ddot, found) == pytest.approx((expected[2], torque))


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
    times, n, m = np.arange(500.0), task.n, task.separation
    states, controls = RNG.normal(size=(500, 7 * n)), RNG.normal(size=(500, 3 * n))
    k = np.array([0.1, 0.2, 0.3, 0.4])

    def square(margin: np.ndarray) -> float:
        return float(np.maximum(-margin, 0.0).max() ** 2)

    delta, worst = 0.0, []
    robots = states.reshape(len(states), n, 7)
    every = robots[..., :2]
    for i in range(n):
        place, own = every[:, i], controls.reshape(len(states), n, 3)[:, i]
        f = own[:, 0] / task.plant.mass / task.thrust
        t = own[:, 2] / task.plant.inertia / task.torque
        delta += k[0] * square(np.minimum(place, task.sides - place).min(axis=1) - m / 2)
        delta += k[1] * square(np.minimum(1 - f, f))
        delta += k[2] * square(1 - np.abs(t))
        delta += k[2] * square(1 - np.abs(own[:, 1]) / task.thruster_rate)
        for other in range(i):
            apart = place - every[:, other]
            delta += k[3] * square(np.hypot(*apart.T) - m)
        worst.append(check(robot_constraints(task), times, robots[:, i], own)[0])
    pairs = check(separation_constraints(task), times, states, controls)[0]
    assert delta > 0.1
    assert penalty(task, worst, pairs, k) == pytest.approx(delta, rel=1e-9)
