# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Charts show every state and control, with limits, switches, and planned beside measured."""

from dataclasses import replace

import numpy as np
from page_missions import (
    ARENA_PARAMETERS,
    DURATION,
    pendulum_mission,
    pendulum_plan,
    pendulum_states,
    robots_mission,
)
import pytest
from tdm_sim.report.charts import Chart, Curve, Panel, plotly_figure, plotly_json
from tdm_sim.report.comparison import compare
from tdm_sim.report.comparison_charts import distance_chart, error_chart, margin_chart
from tdm_sim.report.embedding import unpacked
from tdm_sim.report.histories import (
    control_chart,
    limits_of,
    plan_instants,
    state_chart,
    switching_instants,
)
from tdm_sim.report.mission import PlanInForce


def curves(panel, kind):
    return [curve for curve in panel.curves if curve.kind == kind]


def test_every_state_and_control_planned_and_measured():
    for mission in (pendulum_mission(), robots_mission()):
        plan = mission.vehicles[0].plans[0].trajectory
        count = len(mission.vehicles)
        for chart, names in (
            (state_chart(mission), plan.state_names),
            (control_chart(mission), plan.control_names),
        ):
            assert tuple(panel.title for panel in chart.panels) == names
            for panel in chart.panels:
                assert len(curves(panel, 'planned')) == count
                assert len(curves(panel, 'measured')) == count


def test_planned_values_and_switches():
    (torque,) = control_chart(pendulum_mission()).panels
    (planned,) = curves(torque, 'planned')
    assert planned.held
    assert torque.limits == (-0.02, 0.02)
    assert torque.unit == 'N m'
    assert torque.switches == pytest.approx([0.8])
    theta = state_chart(pendulum_mission()).panels[0]
    (planned,) = curves(theta, 'planned')
    known = np.isfinite(planned.values)
    expected = pendulum_states(planned.times[known])[:, 0]
    assert planned.values[known] == pytest.approx(expected, abs=1e-9)


def test_a_plan_is_drawn_as_long_as_it_was_followed():
    mission = pendulum_mission()
    plan = pendulum_plan()
    plans = (PlanInForce('1', 0.0, plan, until=0.7), PlanInForce('2', 0.7, plan))
    mission = replace(mission, vehicles=(replace(mission.vehicles[0], plans=plans),))
    theta = state_chart(mission).panels[0]
    (planned,) = curves(theta, 'planned')
    gaps = np.flatnonzero(np.isnan(planned.values))
    assert planned.times[gaps] == pytest.approx([0.7, 0.7 + DURATION])
    first = planned.times[: gaps[0]]
    assert first[0] == 0.0
    assert first[-1] == pytest.approx(0.7)
    assert switching_instants(plans[0]) == []
    assert switching_instants(plans[1]) == pytest.approx([1.5])


@pytest.mark.parametrize('most', [20, 200, 3000])
def test_instants_of_a_plan_increase_and_hold_its_switches(most):
    plan = PlanInForce('1', 0.1, pendulum_plan())
    at = plan_instants(plan, most)
    assert (np.diff(at) > 0).all()
    assert at.size <= most + 2
    assert np.abs(at - 0.9).min() < 1e-9
    assert (at[0], at[-1]) == pytest.approx((0.1, 0.1 + DURATION))


def test_limits_of_robots():
    mission = robots_mission()
    half = ARENA_PARAMETERS['arena.minimum_separation'] / 2
    assert limits_of(mission, 'robot', 'x') == (half, 4.0 - half)
    assert limits_of(mission, 'robot', 'y') == (half, 3.0 - half)
    assert limits_of(mission, 'robot', 'thrust') == (0.0, 1.0)
    assert limits_of(mission, 'robot', 'torque') == (-0.02, 0.02)
    assert limits_of(mission, 'robot', 'yaw') == ()
    assert limits_of(replace(mission, parameters={}), 'robot', 'thrust') == ()


def test_distances_of_the_closest_pairs():
    mission = robots_mission(names=[f'r{k}' for k in range(5)])
    chart = distance_chart(mission, compare(mission))
    (panel,) = chart.panels
    assert panel.limits == (0.4,)
    series = {curve.series for curve in panel.curves}
    assert {f'r{k} - r{k + 1}' for k in range(4)} <= series  # neighbours, 1 m apart
    assert len(series) == 6
    assert 'of 10 pairs' in chart.note
    nearest = next(c for c in curves(panel, 'planned') if c.series == 'r0 - r1')
    assert nearest.values == pytest.approx(np.ones(nearest.values.size))


def test_margins_and_errors():
    mission = pendulum_mission(parameters={})
    assert margin_chart(mission, compare(mission)).panels == ()
    mission = pendulum_mission()
    margins = {p.title: p for p in margin_chart(mission, compare(mission)).panels}
    assert set(margins) == {'torque', 'disk_angle'}
    (planned,) = curves(margins['torque'], 'planned')
    assert planned.values[:-1] == pytest.approx(np.full(planned.values.size - 1, 0.006))
    errors = error_chart(mission, compare(mission)).panels
    assert [panel.title for panel in errors] == ['theta', 'psi', 'theta_dot', 'psi_dot']
    (error,) = errors[0].curves
    assert error.values[np.isfinite(error.values)] == pytest.approx(0.02, abs=1e-6)


def test_one_plotly_figure_for_a_chart():
    t = np.array([0.0, 1.0])
    first = Panel(
        'a<b', 'm', (Curve('planned', t, np.array([0.0, np.nan]), 0, 'x&y'),), '', (2.0,)
    )
    second = Panel('c', '', (Curve('measured', t, t, 9),))
    data = plotly_json(plotly_figure(Chart('key', 'title', (first, second)), (0.0, 1.0)))
    planned, limit, measured = data['data']
    assert planned['name'] == 'x&amp;y planned'
    assert (planned['yaxis'], measured['yaxis']) == ('y', 'y2')
    assert unpacked(limit['y'])[:2].tolist() == [2.0, 2.0]
    assert np.isnan(unpacked(planned['y'])[1])
    assert data['layout']['annotations'][0]['text'] == '<b>a&lt;b</b>'
    domains = [data['layout'][axis]['domain'] for axis in ('yaxis', 'yaxis2')]
    assert 0.0 <= domains[1][0] < domains[1][1] < domains[0][0] < domains[0][1] <= 1.0
    low, high = data['layout']['yaxis']['range']
    assert low < 0.0 < 2.0 < high
