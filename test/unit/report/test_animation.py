# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the animation draws is what was planned and measured, and nothing where nothing was."""

from dataclasses import replace

import numpy as np
from page_missions import (
    DURATION,
    pendulum_mission,
    pendulum_plan,
    pendulum_states,
    robot_states,
    robots_mission,
)
import pytest
from tdm_sim.report.animation import (
    frame_times,
    measured_frames,
    MOST_POSES,
    planned_frames,
    scene,
)
from tdm_sim.report.embedding import unpacked
from tdm_sim.report.mission import Mission, PlanInForce, Signals

NAMES = ('theta', 'psi', 'torque')


def vehicle_of(mission):
    (vehicle,) = mission.vehicles
    return vehicle


def test_planned_states_are_held_before_and_after_controls_are_off():
    at = np.array([-1.0, 0.0, 0.5, DURATION, 3.0])
    frames = planned_frames(vehicle_of(pendulum_mission()), at, NAMES)
    expected = pendulum_states(np.clip(at, 0.0, DURATION))
    assert frames['theta'] == pytest.approx(expected[:, 0], abs=1e-9)
    assert frames['psi'] == pytest.approx(expected[:, 1], abs=1e-9)
    assert frames['torque'].tolist() == [0.0, 0.014, 0.014, -0.014, 0.0]


def test_a_later_plan_takes_over_at_its_start():
    vehicle = vehicle_of(pendulum_mission())
    plan = pendulum_plan()
    plans = (PlanInForce('1', 0.0, plan, until=0.9), PlanInForce('2', 0.9, plan))
    at = np.array([0.8, 0.9, 1.0])
    frames = planned_frames(replace(vehicle, plans=plans), at, NAMES)
    expected = pendulum_states(np.array([0.8, 0.0, 0.1]))[:, 0]
    assert frames['theta'] == pytest.approx(expected, abs=1e-9)


def test_measured_where_it_was_measured_only():
    vehicle = vehicle_of(pendulum_mission())
    states = vehicle.states
    values = states.values.copy()
    values[(states.times > 0.5) & (states.times < 1.0)] = np.nan
    gappy = Signals(states.times, values, states.names, states.units)
    at = np.array([-2.0, 0.3, 0.75, 1.3, 5.0])
    frames = measured_frames(replace(vehicle, states=gappy), at, NAMES)
    assert np.isnan(frames['theta']).tolist() == [True, False, True, False, True]
    assert frames['theta'][1] == pytest.approx(pendulum_states(0.3)[0] + 0.02, abs=1e-6)


@pytest.mark.parametrize('count', [0, 1])
def test_hardly_anything_measured(count):
    vehicle = vehicle_of(pendulum_mission())
    states = vehicle.states
    few = Signals(states.times[:count], states.values[:count], states.names, states.units)
    frames = measured_frames(replace(vehicle, states=few), np.linspace(-1, 1, 9), NAMES)
    assert np.isnan(frames['theta']).all()


def test_measured_angles_run_on_where_they_were_wrapped():
    mission = robots_mission(names=('one',))
    vehicle = vehicle_of(mission)
    states = vehicle.states
    values = states.values.copy()
    column = states.names.index('yaw')
    turned = 8.0 * np.clip(states.times, 0.0, DURATION)
    values[:, column] = np.arctan2(np.sin(turned), np.cos(turned))
    wrapped = Signals(states.times, values, states.names, states.units)
    at = np.linspace(0.0, DURATION, 50)
    frames = measured_frames(replace(vehicle, states=wrapped), at, ('yaw',))
    assert frames['yaw'] == pytest.approx(8.0 * at, abs=1e-6)


def test_the_scene_of_robots():
    data = scene(robots_mission())
    assert data['kind'] == 'arena'
    assert [robot['name'] for robot in data['robots']] == ['robot1', 'robot2']
    assert data['obstacles'] == [[2.0, 0.6, 0.25]]
    end = robot_states(DURATION, 1)
    assert data['robots'][1]['goal'] == pytest.approx(end[[0, 1, 4]].tolist())
    times = unpacked(data['times'])
    x = unpacked(data['robots'][0]['planned']['x'])
    assert x == pytest.approx(robot_states(np.clip(times, 0, DURATION), 0)[:, 0], abs=1e-5)


def test_frames_are_bounded_and_hold_the_starts_and_ends_of_plans():
    mission = pendulum_mission()
    times = frame_times(mission, 100.0)
    assert {0.0, DURATION} <= set(times.tolist())
    assert (times[0], times[-1]) == mission.span
    many = robots_mission(names=[f'r{k}' for k in range(20)], after=600.0, rate=1.0)
    assert frame_times(many, 25.0).size * 20 < MOST_POSES + 20 * 3


def test_vehicles_of_another_kind_have_histories_only():
    vehicle = replace(vehicle_of(pendulum_mission()), plant='other')
    assert scene(Mission('t', 'other', (vehicle,))) is None
    assert scene(Mission('t', '', ())) is None
