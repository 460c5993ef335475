# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The nonlinear program over switching times: derivatives, peaks of the disk angle, curvature."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.pendulum_rollout import roll_states
from tdm_planner.problems.switching_motion import (
    arc_program,
    ArcProgram,
    curvature,
    evaluate_arcs,
    SMALLEST_CURVATURE,
)

PLANT = RotaryPendulum()
W0 = PLANT.natural_frequency
START = np.array([np.pi, 0.2, 1.0, -2.0])
DURATIONS = st.lists(st.floats(0.02, 0.12), min_size=4, max_size=7).map(np.array)


def program(arcs: int, disk_angle: float = 2.0) -> ArcProgram:
    return arc_program(PLANT, START, 0.09 * (-1.0) ** np.arange(arcs), 0, disk_angle, 12)


def differences(xi: np.ndarray, read, step: float = 1e-6) -> np.ndarray:
    changes = step * np.eye(xi.size)
    return np.stack([(read(xi + c) - read(xi - c)) / (2 * step) for c in changes], axis=-1)


@given(DURATIONS)
@settings(deadline=None, derandomize=True, max_examples=25)
def test_end_conditions_match_finite_differences(durations):
    made, xi = program(durations.size), durations * W0
    expected = differences(xi, lambda x: evaluate_arcs(made, x).residual)
    np.testing.assert_allclose(
        evaluate_arcs(made, xi).jacobian, expected, atol=1e-5 * (1 + np.abs(expected).max())
    )


@given(DURATIONS)
@settings(deadline=None, derandomize=True, max_examples=25)
def test_disk_angle_margins_match_finite_differences(durations):
    made, xi = program(durations.size, disk_angle=0.3), durations * W0
    point = evaluate_arcs(made, xi)
    step = 1e-6
    for i in range(xi.size):
        change = step * (np.arange(xi.size) == i)
        ahead, behind = (evaluate_arcs(made, x).margins for x in (xi + change, xi - change))
        central = (ahead - behind) / (2 * step)
        # Where the peak changes its node or its side the margin has a kink: not differentiable.
        smooth = np.abs(ahead - 2 * point.margins + behind) < 1e-9
        np.testing.assert_allclose(point.slopes[smooth, i], central[smooth], atol=1e-4, rtol=1e-4)


@given(DURATIONS, st.integers(0, 100))
@settings(deadline=None, derandomize=True, max_examples=10)
def test_curvature_along_the_end_conditions_matches_finite_differences(durations, seed):
    made, xi = program(durations.size), durations * W0
    point, duals = evaluate_arcs(made, xi), np.random.default_rng(seed).normal(size=4)
    found = curvature(made, point, duals)
    basis = np.linalg.svd(point.jacobian)[2]
    across, along = basis[:4], basis[4:]
    second = differences(xi, lambda x: duals @ evaluate_arcs(made, x).jacobian, 1e-5)
    values = np.linalg.eigvalsh(along @ (0.5 * (second + second.T)) @ along.T)
    expected = np.sort(np.maximum(np.abs(values), SMALLEST_CURVATURE))
    reduced = np.linalg.eigvalsh(along @ found @ along.T)
    np.testing.assert_allclose(reduced, expected, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(across @ found, SMALLEST_CURVATURE * across, atol=1e-9)


def test_peak_between_the_nodes_is_found():
    made, durations = program(2, disk_angle=0.3), np.array([0.1, 0.12])
    margins = evaluate_arcs(made, durations * W0).margins
    fine = roll_states(
        PLANT, START, np.repeat(durations / 2000, 2000), np.repeat(made.torques, 2000), 1
    )
    peaks = np.abs(fine[1:, 1]).reshape(2, 2000).max(axis=1)
    np.testing.assert_allclose(0.3 - margins, peaks, atol=2e-4)


def test_violations_count_both_groups():
    point = evaluate_arcs(program(4, disk_angle=0.21), np.full(4, 0.1 * W0))
    assert point.ends == pytest.approx(np.abs(point.residual).max())
    assert point.beyond == pytest.approx(-point.margins.min())
    assert point.beyond > 0
    assert point.cost == pytest.approx(0.4 * W0)


def test_motions_that_run_away_are_infinitely_bad():
    point = evaluate_arcs(program(4), np.full(4, 1e6))
    assert point.ends == point.beyond == np.inf
