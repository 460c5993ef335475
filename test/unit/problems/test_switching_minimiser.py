# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The compiled minimiser over switching times: minima, and when it gives up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.pendulum_rollout import ARRIVED, roll_states, steer
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_minimiser import minimise
from tdm_planner.problems.switching_motion import arc_program, ArcProgram, evaluate_arcs
from tdm_planner.problems.switching_seeds import starts

PLANT = RotaryPendulum()
W0 = PLANT.natural_frequency
START = np.array([np.pi, 0.2, 1.0, -2.0])
OPTIONS = TrustRegionOptions(
    penalties=(30.0, 30.0),
    radius=0.5,
    iterations=60,
    cost_tolerance=1e-6,
    feasibility=(1e-8, 1e-8),
    corrections=4,
)


def arrivals(disk_angle: float) -> list[tuple[ArcProgram, np.ndarray]]:
    """Programs with a motion each that arrives, the quickest first."""
    task = SwingUpTask(PLANT, START, 0.09, 0.09, disk_angle, 0)
    batch = starts(task, np.random.default_rng(0), 200, 6)
    steer(PLANT, START, batch, disk_angle, 12, lambda: False)
    found = []
    totals = np.where(batch.costs < ARRIVED, batch.durations.sum(axis=1), np.inf)
    for index in np.argsort(totals)[:5]:
        assert batch.costs[index] < ARRIVED
        n = batch.arcs[index]
        torques = batch.torques[index, :n].copy()
        made = arc_program(PLANT, START, torques, 0, disk_angle, 12)
        found.append((made, batch.durations[index, :n] * W0))
    return found


def local_minimum(program: ArcProgram, xi: np.ndarray) -> float:
    """Return the least cost that SLSQP finds from there."""
    return float(
        minimize(
            np.sum,
            xi,
            jac=np.ones_like,
            method='SLSQP',
            bounds=[(0.0, None)] * xi.size,
            constraints=[
                {
                    'type': 'eq',
                    'fun': lambda x: evaluate_arcs(program, x).residual,
                    'jac': lambda x: evaluate_arcs(program, x).jacobian,
                },
                {
                    'type': 'ineq',
                    'fun': lambda x: np.minimum(evaluate_arcs(program, x).margins, 1.0),
                    'jac': lambda x: evaluate_arcs(program, x).slopes,
                },
            ],
            options={'ftol': 1e-10, 'maxiter': 200},
        ).fun
    )


@pytest.mark.parametrize('disk_angle', [2.0, 0.9])
def test_minimum_is_feasible_and_the_best_around(disk_angle):
    converged = 0
    for program, xi in arrivals(disk_angle):
        found = minimise(program, xi, OPTIONS, Budget(60.0))
        if not found.converged:
            continue
        converged += 1
        # Steering looks at |psi| at nodes only: within the limit between them takes longer.
        assert found.point.cost <= xi.sum() * (1 + 2e-3)
        assert found.point.cost <= local_minimum(program, found.point.xi) * (1 + 1e-4)
        durations = found.point.xi / W0
        states = roll_states(PLANT, START, durations, program.torques, 12)
        assert np.abs(states[-1]).max() < 1e-6
        fine = np.repeat(durations / 200, 200), np.repeat(program.torques, 200)
        assert np.abs(roll_states(PLANT, START, *fine, 1)[:, 1]).max() <= disk_angle + 1e-3
    assert converged >= 3


def test_a_spent_budget_ends_it_after_a_few_steps():
    program, xi = arrivals(2.0)[0]
    assert minimise(program, xi, OPTIONS, Budget(0.0)).iterations <= 4


def test_cutoff_gives_up():
    program, xi = arrivals(2.0)[-1]
    options = replace(OPTIONS, cutoff=1e-3, cost_tolerance=1e-12)
    found = minimise(program, xi, options, Budget(60.0))
    assert not found.converged or found.iterations <= 5


def test_from_where_nothing_can_be_computed_there_is_no_way_on():
    program = arc_program(PLANT, START, np.array([0.09, -0.09] * 2), 0, 2.0, 12)
    found = minimise(program, np.full(4, 1e6), OPTIONS, Budget(60.0))
    assert found.point.violation == np.inf
    assert found.iterations == 0
