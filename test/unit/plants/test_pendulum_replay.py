# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The compiled replay and the compiled feedback against independent integrations."""

from __future__ import annotations

import numpy as np
import pytest
from tdm_planner.parameters import build
from tdm_planner.plants import RotaryPendulum
from tdm_planner.plants.pendulum_feedback import FeedbackTable, roll_feedback
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.verification import dense_times, replay
from tdm_sim.integrator import integrate

PLANT = RotaryPendulum()


@pytest.mark.parametrize(('torque', 'method'), [(0.02, 'switching'), (0.09, 'smooth')])
def test_the_replay_agrees_with_scipy(
    monkeypatch: pytest.MonkeyPatch, torque: float, method: str
) -> None:
    problem = build(PendulumSwingUp, {'limits.torque': torque, 'method': method})
    trajectory = problem.solve(deadline=10.0).trajectory
    times = dense_times(trajectory, 1e-3)
    quick = PLANT.replay(trajectory, times)
    assert quick is not None
    monkeypatch.setattr(RotaryPendulum, 'replay', lambda *_: None)
    np.testing.assert_allclose(quick, replay(PLANT, trajectory, times), atol=2e-5)


def test_where_it_would_be_inaccurate_it_is_left_to_scipy() -> None:
    trajectory = build(PendulumSwingUp, {'limits.torque': 0.09}).solve(deadline=10.0).trajectory
    assert PLANT.replay(trajectory, np.array([0.0, 0.2])) is None
    grid = np.arange(0.0, trajectory.duration, 1e-3)  # switches lie between its instants
    assert PLANT.replay(trajectory, grid) is None


def test_the_feedback_table_is_what_a_tracker_does_tick_by_tick() -> None:
    rng = np.random.default_rng(0)
    references = rng.normal(size=(20, 4))
    torques, gains = 0.02 * rng.normal(size=20), 0.02 * rng.normal(size=(20, 4))
    table = FeedbackTable(references, torques, gains, 5e-3, 0.03)
    states = roll_feedback(PLANT, np.array([3.0, 0.1, 1.0, -1.0]), table)
    state = states[0]
    for k in range(20):
        error = state - references[k]
        error[0] = (error[0] + np.pi) % (2 * np.pi) - np.pi
        torque = np.clip(torques[k] - gains[k] @ error, -0.03, 0.03)
        state = integrate(PLANT, state, np.array([torque]), 5e-3)
        np.testing.assert_allclose(states[k + 1], state, atol=1e-6)
