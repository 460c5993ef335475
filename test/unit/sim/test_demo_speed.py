# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from pathlib import Path

import pytest
from tdm_planner.resources import config_file
from tdm_sim.demo_speed import speed_settings

FILE = config_file('pendulum.yaml')


def test_at_real_time_nothing_is_changed():
    for node in ('planner', 'tracker', 'pendulum_plant', 'robot_plant'):
        assert speed_settings(node, FILE, 1.0, drives_clock=False) == {}


def test_faster_what_covers_real_time_is_longer_and_rates_are_lower():
    assert speed_settings('planner', FILE, 4.0, drives_clock=False) == {
        'use_sim_time': True,
        'start.delay': 4.0,
        'start.max_age': 2.0,
        'replan.delay': 0.6,
    }
    tracker = speed_settings('tracker', FILE, 4.0, drives_clock=False, rates=2.0)
    assert tracker['rate'] == 100.0
    assert tracker['state_timeout'] == pytest.approx(0.4)
    plant = speed_settings('pendulum_plant', FILE, 4.0, drives_clock=True, rates=2.0)
    assert plant == {
        'use_sim_time': False,
        'publish_clock': True,
        'real_time_factor': 4.0,
        'clock_followers': ['joint_command'],
        'command_timeout': pytest.approx(0.4),
        'rate': 100.0,
    }


def test_slower_nothing_is_shortened():
    planner = speed_settings('planner', FILE, 0.5, drives_clock=False)
    assert planner['start.delay'] == 1.0
    assert speed_settings('tracker', FILE, 0.5, drives_clock=False)['rate'] == 200.0


def test_the_parameter_file_is_heeded_and_ranges_are_kept(tmp_path: Path):
    file = tmp_path / 'own.yaml'
    file.write_text(
        '/**/planner:\n  ros__parameters:\n    start: {delay: 2}\n    replan: {delay: 5.0}\n'
        '/**/tracker:\n  ros__parameters:\n    rate: 50\n'
    )
    planner = speed_settings('planner', file, 4.0, drives_clock=False)
    assert planner['start.delay'] == 8.0
    assert planner['replan.delay'] == 10.0  # the most that is allowed
    assert speed_settings('tracker', file, 4.0, drives_clock=False)['rate'] == 12.5
    plant = speed_settings('pendulum_plant', file, 4.0, drives_clock=True)
    assert plant['rate'] == 50.0  # the default's quarter: the file says nothing of the plant
