# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The curves: what was measured lately, beside the plan."""

from __future__ import annotations

import numpy as np
import pytest
from tdm_planner.plant_views import view_of
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.trajectory import TimedTrajectory, Trajectory
from tdm_sim.live.history import History, MARGINS, RATE, SolveTimes, SOLVING, SPAN

BEGIN = 1_800_000_000.0  # s, as clocks show
VIEW = view_of(PendulumSwingUp())


def plan() -> TimedTrajectory:
    times = np.linspace(0.0, 2.0, 21)
    states = np.stack([times, 0.5 * times, 1.0 + 0.0 * times, 0.5 + 0.0 * times], axis=1)
    return TimedTrajectory(
        Trajectory.of(VIEW.kind, times, states, np.full((21, 1), 0.01), 'linear'), BEGIN
    )


def history(seconds: float) -> History:
    made = History(VIEW)
    for t in np.arange(0.0, seconds, 0.005):  # states come at 200 Hz
        made.add(BEGIN + t, np.array([t, 0.5 * t + 0.1, 1.0, 0.5]), np.array([0.012]))
    return made


def test_states_and_controls_by_unit_with_the_plan_and_the_margins() -> None:
    charts = history(1.0).charts(plan())
    assert [chart.title for chart in charts] == [
        'theta, psi [rad]', 'theta_dot, psi_dot [rad/s]', 'torque [N m]', MARGINS,
    ]  # fmt: skip
    angles = charts[0]
    assert set(angles.curves) == {'theta', 'psi', 'theta, planned', 'psi, planned'}
    assert angles.planned == {'theta, planned', 'psi, planned'}
    assert angles.curves['theta'] == pytest.approx(angles.curves['theta, planned'], abs=1e-6)
    assert angles.curves['psi'] - angles.curves['psi, planned'] == pytest.approx(0.1, abs=1e-6)
    assert angles.x[-1] == 0.0
    assert 0.8 * RATE < angles.x.size < 1.3 * RATE
    margins = charts[-1]
    assert set(margins.curves) == {'torque', 'disk_angle'}
    assert (margins.curves['torque'] > 0.0).all()
    for chart in charts:
        assert all(np.isfinite(curve).all() for curve in chart.curves.values())


def test_only_the_last_seconds_are_kept_and_a_clock_that_begins_anew_begins_anew() -> None:
    made = history(SPAN + 5.0)
    x = made.charts(None)[0].x
    assert -SPAN - 1.0 < x[0] < -SPAN / 2
    made.add(5.0, np.zeros(4), np.zeros(1))
    assert made.charts(None) == []


def test_the_times_to_solve_are_those_of_different_plans() -> None:
    times = SolveTimes()
    assert times.chart() is None
    for number, solve_time in ((1, 0.1), (1, 0.1), (2, 0.3)):
        times.add(number, solve_time)
    chart = times.chart()
    assert chart is not None
    assert chart.title == SOLVING
    assert chart.x.tolist() == [1.0, 2.0]
    assert chart.curves['time to solve'] == pytest.approx([100.0, 300.0])
    times.add(1, 0.2)  # the planner was started anew
    assert times.chart() is None
