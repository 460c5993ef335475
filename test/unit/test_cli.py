# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The command line: in the test's process, and once as users run it."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys

import pytest
from replays import faults
from ros_harness import SOURCE, UNHURRIED
from tdm_planner.cli import main


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_plan_is_written_drawn_and_reaches_the_goal_when_integrated(folder, capsys):
    words = ['plan', 'pendulum', '-o', 'plan.json', '--plot', 'plan.png', *UNHURRIED]
    assert main(words) == 0
    assert 'upright' in capsys.readouterr().out
    plan = json.loads((folder / 'plan.json').read_text())
    assert plan['interpolation'] == 'zero_order_hold'
    assert list(plan['states']) == ['theta', 'psi', 'theta_dot', 'psi_dot']
    assert plan['verification']['ok'] is True
    assert (folder / 'plan.png').read_bytes().startswith(b'\x89PNG')
    assert not faults(plan)


def test_parameter_files_and_settings_as_users_run_it(folder: Path):
    (folder / 'p.yaml').write_text(
        '/**:\n  planner:\n    ros__parameters:\n      limits: {torque: 9e-2}\n'
        '      start: {source: measured, theta: 3.0}\n'
    )
    words = ['plan', 'pendulum', '--params', 'p.yaml', '--set', 'torque_reserve=0', 'start.psi=.1']
    words += ['--set', 'solver.seed=1', *UNHURRIED, '-q', '-o', 'plan.csv']
    done = subprocess.run(
        [sys.executable, '-m', 'tdm_planner.cli', *words],
        env=os.environ | {'PYTHONPATH': str(SOURCE)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, ''), done.stderr
    lines = (folder / 'plan.csv').read_text().splitlines()
    assert lines[0] == 'time,theta,psi,theta_dot,psi_dot,torque'
    first = [float(value) for value in lines[1].split(',')]
    assert first[1:3] == [3.0, 0.1]
    assert abs(first[5]) == pytest.approx(0.09)


@pytest.mark.parametrize(
    ('arguments', 'code', 'words'),
    [
        (['--set', 'limits.torque=-1'], 2, ['limits.torque', '-1', '[1e-12, 1e+12] N m']),
        (['--set', 'limits.torque=.nan'], 2, ['limits.torque', 'nan']),
        (['--set', 'plant.mas=1'], 2, ['plant.mas', 'unknown', 'plant.mass']),
        (['--set', 'plant.mass=1e300'], 2, ['plant.mass', '1e+300', '[1e-12, 1e+12] kg']),
        (['--set', 'nonsense'], 2, ['nonsense', 'name=value']),
        (['--set', 'start.psi=2.5'], 2, ['start.psi', '2.5', '[-2, 2]']),
        (['--params', 'absent.yaml'], 2, ['absent.yaml', 'cannot be read']),
        (['--params', '../wrong.yaml'], 2, ['not YAML']),
        (['--set', 'limits.torque=1e-4', '--set', 'solver.deadline=.3'], 3, []),
        (['-o', 'plan.txt'], 2, ['plan.txt', '.json, .csv, .npz']),
        (['-o', 'missing/plan.json'], 2, ['missing']),
        (['--plot', 'plan.bmp'], 2, ['plan.bmp']),
    ],
)
def test_mistakes_get_one_sentence_and_a_code(
    arguments, code, words, tmp_path, monkeypatch, capsys
):
    (tmp_path / 'wrong.yaml').write_text('a: [1, 2\nb: }')
    (tmp_path / 'folder').mkdir()
    monkeypatch.chdir(tmp_path / 'folder')
    output = [] if '-o' in arguments else ['-o', 'plan.json']
    assert main(['plan', 'pendulum', *output, *arguments]) == code
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert all(word in line for word in words), line
    assert not list((tmp_path / 'folder').iterdir())


@pytest.mark.parametrize(
    ('words', 'code'), [([], 2), (['plan', 'pendulum'], 2), (['--version'], 0)]
)
def test_usage_and_version(words: list[str], code: int, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == code
    assert capsys.readouterr().out.startswith('tdm_planner 0.' if code == 0 else '')


def test_without_ros_the_way_out_is_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    monkeypatch.delitem(sys.modules, 'tdm_sim.demo', raising=False)
    assert main(['demo', 'pendulum']) == 2
    assert "this needs 'rclpy', which is not installed" in capsys.readouterr().err


@pytest.mark.parametrize('speed', ['0', '-1', '100', 'nan'])
def test_a_demo_refuses_a_speed_that_cannot_be(speed, folder, capsys):
    pytest.importorskip('rclpy')
    assert main(['demo', 'pendulum', f'--speed={speed}', '-o', 'out']) == 2
    assert "parameter 'speed'" in capsys.readouterr().err
    assert not list(folder.iterdir())


@pytest.mark.parametrize('foreign', ['out', 'out/thesis.tex'])
def test_a_demo_leaves_alone_what_is_not_its_own(foreign, folder, capsys):
    pytest.importorskip('rclpy')
    mine = folder / foreign
    mine.parent.mkdir(exist_ok=True)
    mine.write_text('mine')
    assert main(['demo', 'pendulum', '-o', 'out']) == 2
    assert "'out'" in capsys.readouterr().err
    assert mine.read_text() == 'mine'


def test_the_live_page_says_what_it_needs(monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith('tdm_sim.live')]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'viser', None)
    assert main(['live', 'pendulum']) == 2
    assert "pip install tdm_planner[live]'" in capsys.readouterr().err
    for words in ([], ['pendulum', '--attach', '/pendulum']):
        with pytest.raises(SystemExit):
            main(['live', *words])
