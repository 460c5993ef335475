# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The demo as users run it: real processes, real DDS, a bag that others can read."""

import os
from pathlib import Path
import re
import subprocess
import sys

import numpy as np
import pytest
from ros_harness import ENOUGH, reserved_domain, ros_environment
from tdm_planner.plan_files import load_plan
from tdm_planner.trajectory import Trajectory

reader = pytest.importorskip('mcap_ros2.reader')


SHIPPED = Path(__file__).resolve().parents[2] / 'config' / 'pendulum.yaml'


@pytest.fixture
def unhurried(tmp_path):
    """Return options for the shipped parameters, with time enough for a plan."""
    text = SHIPPED.read_text(encoding='utf-8')
    assert text.count(' deadline: 0.5\n') == 1
    path = tmp_path / 'unhurried.yaml'
    path.write_text(text.replace(' deadline: 0.5\n', f' deadline: {ENOUGH}\n'))
    return ['--params', str(path)]


def run_demo(folder, *arguments):
    with reserved_domain() as domain:
        return subprocess.run(
            [sys.executable, '-m', 'tdm_planner.cli', 'demo', *arguments],
            cwd=folder,
            env=os.environ | ros_environment(domain, folder),
            capture_output=True,
            text=True,
            timeout=120,
        )


def topics(folder):
    (bag,) = Path(folder, 'bag').glob('*.mcap')
    counts = {}
    for message in reader.read_ros2_messages(bag):
        counts[message.channel.topic] = counts.get(message.channel.topic, 0) + 1
    return counts


def test_pendulum(tmp_path, unhurried):
    done = run_demo(tmp_path, 'pendulum', *unhurried)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'goal reached and held' in done.stdout
    folder = tmp_path / 'pendulum'
    plan = load_plan(folder / 'plan.json')
    assert plan['verification']['ok'] is True
    assert 1.0 < Trajectory.from_dict(plan).duration < 2.0
    assert (folder / 'plan.png').read_bytes().startswith(b'\x89PNG')
    assert 'report in pendulum/report.html' in done.stdout
    report = (folder / 'report.html').read_text()
    assert '<p class="verdict good">Goal reached and held' in report
    counts = topics(folder)
    assert counts['/pendulum/trajectory'] == 1
    assert counts['/pendulum/joint_states'] > 500
    assert counts['/pendulum/joint_command'] > 500
    # the same verdict, from the bag alone
    (bag,) = Path(folder, 'bag').glob('*.mcap')
    theta = [
        m.ros_msg.position[list(m.ros_msg.name).index('pendulum')]
        for m in reader.read_ros2_messages(bag, topics=['/pendulum/joint_states'])
    ]
    last = np.array(theta[-900:])  # 4.5 s at 200 Hz
    upright = 2 * np.pi * np.round(last / (2 * np.pi))
    assert np.abs(last - upright).max() < 0.05


def test_at_another_speed_the_mission_is_the_same(tmp_path, unhurried):
    done = run_demo(tmp_path, 'pendulum', '--speed', '4', '-o', 'out', *unhurried)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'goal reached and held' in done.stdout
    assert 'speed of simulated time' in done.stdout
    report = (tmp_path / 'out' / 'report.html').read_text(encoding='utf-8')
    # A busy computer holds less than it was asked for.
    assert re.search(r'simulated time at [1-4][.0-9]* times real time', report)


@pytest.mark.parametrize('speed', ['0', '-1', '100', 'nan'])
def test_a_speed_that_cannot_be_is_refused(tmp_path, speed):
    done = run_demo(tmp_path, 'pendulum', f'--speed={speed}', '-o', 'out')
    assert done.returncode == 2
    assert "parameter 'speed'" in done.stderr
    assert 'Traceback' not in done.stderr + done.stdout


def test_a_goal_that_cannot_be_planned_is_no_success(tmp_path):
    parameters = tmp_path / 'p.yaml'
    parameters.write_text(
        '/**/planner:\n  ros__parameters:\n    limits: {torque: 0.0001}\n'
        '    solver: {deadline: 0.3}\n'
    )
    done = run_demo(tmp_path, 'pendulum', '--params', parameters, '--quiet', '-o', 'out')
    assert done.returncode != 0
    assert 'no plan' in done.stderr
    assert 'Traceback' not in done.stderr + done.stdout


@pytest.mark.parametrize('content', ['file', 'foreign'])
def test_a_folder_with_other_things_is_left_alone(tmp_path, content):
    target = tmp_path / 'out'
    if content == 'file':
        target.write_text('mine')
    else:
        target.mkdir()
        (target / 'thesis.tex').write_text('mine')
    done = run_demo(tmp_path, 'pendulum', '-o', 'out')
    assert done.returncode == 2
    assert 'out' in done.stderr
    kept = target if content == 'file' else target / 'thesis.tex'
    assert kept.read_text() == 'mine'
