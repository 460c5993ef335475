# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line in processes of its own, as users run it."""

import json
import math
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest
from ros_harness import UNHURRIED
from scipy.integrate import solve_ivp
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

SOURCE = Path(__file__).resolve().parents[2]


def tdm(*arguments, cwd):
    return subprocess.run(
        [sys.executable, '-m', 'tdm_planner.cli', *map(str, arguments)],
        cwd=cwd,
        env=os.environ | {'PYTHONPATH': str(SOURCE)},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_a_plan_is_written_drawn_and_reaches_the_goal_when_integrated(tmp_path):
    done = tdm(
        'plan', 'pendulum', '-o', 'plan.json', '--plot', 'plan.png', *UNHURRIED, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert 'upright' in done.stdout
    plan = json.loads((tmp_path / 'plan.json').read_text())
    assert plan['interpolation'] == 'zero_order_hold'
    assert list(plan['states']) == ['theta', 'psi', 'theta_dot', 'psi_dot']
    assert plan['verification']['ok'] is True
    assert (tmp_path / 'plan.png').read_bytes().startswith(b'\x89PNG')
    end = integrate(plan)
    upright = 2 * math.pi * round(end[0] / (2 * math.pi))
    assert np.abs(end[:2] - [upright, 0]).max() < 1e-4
    assert np.abs(end[2:]).max() < 1e-3


def integrate(plan):
    """Whoever integrates the plant with the torques held so must reach the goal."""
    plant = RotaryPendulum()
    state = np.array([column[0] for column in plan['states'].values()])
    times, torques = plan['times'], plan['controls']['torque']
    for start, end, torque in zip(times[:-1], times[1:], torques[:-1], strict=True):
        held = np.array([torque])
        state = solve_ivp(
            lambda t, x, u=held: plant.derivative(x, u),
            (start, end), state, rtol=1e-10, atol=1e-12, method='DOP853',
        ).y[:, -1]  # fmt: skip
    return state


def test_parameter_files_and_settings(tmp_path):
    (tmp_path / 'p.yaml').write_text(
        '/**:\n  planner:\n    ros__parameters:\n      limits: {torque: 9e-2}\n'
        '      start: {source: measured, theta: 3.0}\n'
    )
    done = tdm(
        'plan', 'pendulum', '--params', 'p.yaml', '--set', 'torque_reserve=0', 'start.psi=.1',
        '--set', 'solver.seed=1', *UNHURRIED, '-q', '-o', 'plan.csv', cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == ''
    lines = (tmp_path / 'plan.csv').read_text().splitlines()
    assert lines[0] == 'time,theta,psi,theta_dot,psi_dot,torque'
    first = [float(value) for value in lines[1].split(',')]
    assert first[1:3] == [3.0, 0.1]
    assert abs(first[5]) == pytest.approx(0.09)


@pytest.mark.parametrize(
    ('arguments', 'code', 'words'),
    [
        (['--set', 'limits.torque=-1'], 2, ['limits.torque', '-1', '(0, 1e+12] N m']),
        (['--set', 'limits.torque=.nan'], 2, ['limits.torque', 'nan']),
        (['--set', 'plant.mas=1'], 2, ['plant.mas', 'unknown', 'plant.mass']),
        (['--set', 'plant.mass=1e300'], 2, ['plant.mass', '1e+300', '(0, 1e+12] kg']),
        (['--set', 'nonsense'], 2, ['nonsense', 'name=value']),
        (['--set', 'start.psi=2.5'], 2, ['start.psi', '2.5', '[-2, 2]']),
        (['--params', 'absent.yaml'], 2, ['absent.yaml', 'cannot be read']),
        (['--set', 'limits.torque=1e-4', '--set', 'solver.deadline=.3'], 3, []),
        (['-o', 'plan.txt'], 2, ['plan.txt', '.json, .csv, .npz']),
        (['-o', 'missing/plan.json'], 2, ['missing']),
        (['--plot', 'plan.bmp'], 2, ['plan.bmp']),
    ],
)
def test_mistakes_get_one_sentence_and_a_code(tmp_path, arguments, code, words):
    output = [] if '-o' in arguments else ['-o', 'plan.json']
    done = tdm('plan', 'pendulum', *output, *arguments, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert all(word in done.stderr for word in words), done.stderr
    assert not list(tmp_path.iterdir())


def test_an_unknown_problem_lists_the_known_ones(tmp_path):
    done = tdm('plan', 'cartpole', '-o', 'plan.json', cwd=tmp_path)
    assert done.returncode == 2
    assert 'pendulum_swing_up' in done.stderr


def test_a_file_that_is_not_yaml(tmp_path):
    (tmp_path / 'p.yaml').write_text('a: [1, 2\nb: }')
    done = tdm('plan', 'pendulum', '--params', 'p.yaml', '-o', 'plan.json', cwd=tmp_path)
    assert done.returncode == 2
    assert 'not YAML' in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_usage_and_version(tmp_path):
    assert tdm(cwd=tmp_path).returncode == 2
    assert tdm('plan', 'pendulum', cwd=tmp_path).returncode == 2
    assert tdm('--version', cwd=tmp_path).stdout.startswith('tdm_planner 0.')


def test_without_ros_the_way_out_is_named(tmp_path):
    code = (
        "import sys; sys.modules['rclpy'] = None; "
        "from tdm_planner.cli import main; sys.exit(main(['demo', 'pendulum']))"
    )
    done = subprocess.run(
        [sys.executable, '-c', code],
        cwd=tmp_path,
        env=os.environ | {'PYTHONPATH': str(SOURCE), 'ROS_LOG_DIR': str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert "this needs 'rclpy', which is not installed" in done.stderr
    assert 'Traceback' not in done.stderr
