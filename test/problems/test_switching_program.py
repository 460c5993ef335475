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

"""The nonlinear program over switching times: derivatives, peaks of the disk angle, minimum."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.pendulum_rollout import ARRIVED, roll, steer
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_program import SwitchingProgram
from tdm_planner.problems.switching_seeds import starts

PLANT = RotaryPendulum()
W0 = PLANT.natural_frequency
START = np.array([np.pi, 0.2, 1.0, -2.0])
DURATIONS = st.lists(st.floats(0.02, 0.12), min_size=4, max_size=7).map(np.array)


def program(arcs: int, disk_angle: float = 2.0, torque: float = 0.09) -> SwitchingProgram:
    torques = torque * (-1.0) ** np.arange(arcs)
    return SwitchingProgram(PLANT, START, torques, 0, disk_angle, 12)


def differences(made: SwitchingProgram, xi: np.ndarray, read) -> np.ndarray:
    step = 1e-6
    columns = []
    for i in range(xi.size):
        change = step * (np.arange(xi.size) == i)
        columns.append((read(made, xi + change) - read(made, xi - change)) / (2 * step))
    return np.stack(columns, axis=-1)


@given(DURATIONS)
@settings(deadline=None, derandomize=True, max_examples=25)
def test_end_conditions_match_finite_differences(durations):
    made, xi = program(durations.size), durations * W0
    found = made.linearise(made.evaluate(xi), None)
    expected = differences(made, xi, lambda p, x: p.evaluate(x).cache.residual)
    np.testing.assert_allclose(
        found.equality_jacobian, expected, atol=1e-5 * (1 + np.abs(expected).max())
    )


@given(DURATIONS)
@settings(deadline=None, derandomize=True, max_examples=25)
def test_disk_angle_margins_match_finite_differences(durations):
    made, xi = program(durations.size, disk_angle=0.3), durations * W0
    point = made.evaluate(xi)
    step = 1e-6
    for i in range(xi.size):
        change = step * (np.arange(xi.size) == i)
        ahead = made.evaluate(xi + change).cache.margins
        behind = made.evaluate(xi - change).cache.margins
        central = (ahead - behind) / (2 * step)
        # Where the peak changes its node or its side the margin has a kink: not differentiable.
        here = point.cache.margins
        smooth = np.abs(ahead - 2 * here + behind) < 1e-9
        np.testing.assert_allclose(
            point.cache.margins_jacobian[smooth, i], central[smooth], atol=1e-4, rtol=1e-4
        )


def test_peak_between_the_nodes_is_found():
    made = program(2, disk_angle=0.3)
    durations = np.array([0.1, 0.12])
    margins = made.evaluate(durations * W0).cache.margins
    fine, _ = roll(PLANT, START, durations, made.torques, 2000)
    peaks = np.abs(fine[1:, 1]).reshape(2, 2000).max(axis=1)
    np.testing.assert_allclose(0.3 - margins, peaks, atol=2e-4)


def test_violations_count_both_groups():
    far = program(4, disk_angle=0.21)
    point = far.evaluate(np.full(4, 0.1 * W0))
    ends, limit = point.violations
    assert ends == pytest.approx(np.abs(point.cache.residual).max())
    assert limit == pytest.approx(-point.cache.margins.min())
    assert limit > 0
    assert point.cost == pytest.approx(0.4 * W0)


def test_motions_that_run_away_are_infinitely_bad():
    point = program(4).evaluate(np.full(4, 1e6))
    assert point.violation == np.inf


@pytest.mark.parametrize('disk_angle', [2.0, 0.9])
def test_minimum_is_feasible_and_no_slower(disk_angle):
    task = SwingUpTask(PLANT, START, 0.09, 0.09, disk_angle, 0)
    batch = starts(task, np.random.default_rng(0), 200, 6)
    steer(PLANT, START, batch, disk_angle, 12, lambda: False)
    totals = np.where(batch.costs < ARRIVED, batch.durations.sum(axis=1), np.inf)
    options = TrustRegionOptions(
        penalties=(30.0, 30.0),
        radius=0.5,
        iterations=60,
        cost_tolerance=1e-6,
        feasibility=(1e-8, 1e-8),
        corrections=4,
    )
    converged = 0
    for index in np.argsort(totals)[:5]:
        durations, torques = batch.durations[index], batch.torques[index]
        made = SwitchingProgram(PLANT, START, torques, 0, disk_angle, 12)
        found = minimise(made, durations * W0, options)
        if not found.converged:
            continue
        converged += 1
        # Steering looks at |psi| at nodes only: within the limit between them takes longer.
        assert found.point.cost <= totals[index] * W0 * (1 + 2e-3)
        states, _ = roll(PLANT, START, found.point.xi / W0, torques, 12)
        assert np.abs(states[-1] - [0.0, 0.0, 0.0, 0.0]).max() < 1e-6
        fine, _ = roll(PLANT, START, found.point.xi / W0, torques, 200)
        assert np.abs(fine[:, 1]).max() <= disk_angle + 1e-3
    assert converged >= 3
