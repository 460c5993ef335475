# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The compiled minimiser over switching times takes the same way as the general one."""

from __future__ import annotations

import numpy as np
import pytest
from tdm_planner.direct_method import trust_region
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.compilation import COMPILED
from tdm_planner.plants.pendulum_rollout import ARRIVED, steer
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_minimiser import minimise
from tdm_planner.problems.switching_motion import curvature, evaluate_arcs
from tdm_planner.problems.switching_program import SwitchingProgram
from tdm_planner.problems.switching_seeds import starts

pytestmark = pytest.mark.skipif(not COMPILED, reason='needs numba')

PLANT = RotaryPendulum()
W0 = PLANT.natural_frequency
START = np.array([np.pi, 0.2, 1.0, -2.0])
OPTIONS = TrustRegionOptions(
    penalties=(30.0, 30.0),
    radius=0.5,
    iterations=25,
    cost_tolerance=1e-4,
    feasibility=(1e-8, 1e-8),
    corrections=4,
)


def arrivals(disk_angle: float) -> list[tuple[SwitchingProgram, np.ndarray]]:
    task = SwingUpTask(PLANT, START, 0.09, 0.09, disk_angle, 0)
    batch = starts(task, np.random.default_rng(0), 150, 8)
    steer(PLANT, START, batch, disk_angle, 12, lambda: False)
    found = []
    for index in np.flatnonzero(batch.costs < ARRIVED)[:8]:
        n = batch.arcs[index]
        made = SwitchingProgram(PLANT, START, batch.torques[index, :n].copy(), 0, disk_angle, 12)
        found.append((made, batch.durations[index, :n] * W0))
    assert len(found) >= 4
    return found


@pytest.mark.parametrize('disk_angle', [2.0, 0.9])
def test_values_and_derivatives_are_those_of_the_program(disk_angle):
    rng = np.random.default_rng(1)
    for program, xi in arrivals(disk_angle):
        moved = xi * rng.uniform(0.9, 1.1, size=xi.size)
        point, compiled = program.evaluate(moved), evaluate_arcs(program.numbers, moved)
        np.testing.assert_allclose([compiled.ends, compiled.beyond], point.violations, atol=1e-12)
        at, scale = program.linearise(point, None), 1.0 + np.abs(compiled.jacobian).max()
        near = at.tags
        np.testing.assert_allclose(compiled.residual, at.equalities, atol=1e-12)
        np.testing.assert_allclose(compiled.jacobian, at.equality_jacobian, atol=1e-11 * scale)
        np.testing.assert_allclose(compiled.margins[near], at.inequalities, atol=1e-12)
        np.testing.assert_allclose(
            compiled.slopes[near], at.inequality_jacobian, atol=1e-10 * scale
        )
        duals = rng.normal(size=4)
        expected = program._hessian(moved, at.equality_jacobian, duals)
        np.testing.assert_allclose(
            curvature(program.numbers, compiled, duals),
            expected,
            atol=1e-4 * (1.0 + np.abs(expected).max()),
        )


@pytest.mark.parametrize('disk_angle', [2.0, 0.9])
def test_minima_are_those_of_the_general_minimiser(disk_angle):
    same = 0
    for program, xi in arrivals(disk_angle):
        found = minimise(program, xi, OPTIONS, Budget(60.0))
        expected = trust_region.minimise(program, xi, OPTIONS, Budget(60.0))
        assert found.point.violation < 1e-6 or expected.point.violation > 1e-6
        np.testing.assert_allclose(
            program.evaluate(found.point.xi).violations, found.point.violations, atol=1e-12
        )
        same += found.point.cost == pytest.approx(expected.point.cost, rel=1e-5)
    assert same >= len(arrivals(disk_angle)) - 1


def test_a_spent_budget_ends_it_after_a_few_steps():
    program, xi = arrivals(2.0)[0]
    assert minimise(program, xi, OPTIONS, Budget(0.0)).iterations <= 4


def test_cutoff_gives_up():
    program, xi = arrivals(2.0)[-1]
    options = TrustRegionOptions(**{**vars(OPTIONS), 'cutoff': 1e-3, 'cost_tolerance': 1e-12})
    found = minimise(program, xi, options, Budget(60.0))
    assert not found.converged or found.iterations <= 5


def test_from_where_nothing_can_be_computed_there_is_no_way_on():
    program = SwitchingProgram(PLANT, START, np.array([0.09, -0.09] * 2), 0, 2.0, 12)
    found = minimise(program, np.full(4, 1e6), OPTIONS, Budget(60.0))
    assert found.point.violation == np.inf
    assert found.iterations == 0
