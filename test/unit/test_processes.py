# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What processes begin and end with: command lines, packages, threads, files, kernels, signals."""

from __future__ import annotations

from contextlib import nullcontext
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest
from ros_harness import MODULES, SOURCE
from tdm_planner import resources, set_up, starting
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems import RobotFormation
from tdm_planner.starting import Interrupted, interruptible, uninterrupted

EXECUTABLES = {**MODULES, 'tdm': 'tdm_planner.cli'}
THREADS = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')


def python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    others = {name: value for name, value in os.environ.items() if name not in THREADS}
    return subprocess.run(
        [sys.executable, *arguments],
        env={**others, **environment, 'PYTHONPATH': str(SOURCE)},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_launch_files_need_only_what_ubuntu_has() -> None:
    """`ros2 launch` runs them in the system's Python, not in the environment of the nodes."""
    pytest.importorskip('rclpy')
    missing = ['casadi', 'daqp', 'mcap', 'numba', 'plotly', 'rosbags', 'zstandard']
    text = ''.join(path.read_text('utf-8') for path in (SOURCE / 'launch').glob('*.py'))
    text += (SOURCE / 'tdm_planner' / 'launching.py').read_text('utf-8')
    modules = set(re.findall(r'from (tdm_\w+[\w.]+) import', text)) - {'tdm_planner.launching'}
    assert 'tdm_planner.nodes.robot_nodes' in modules
    program = f'import sys; sys.modules.update(dict.fromkeys({missing}))\n'
    done = python('-c', program + ''.join(f'import {name}\n' for name in sorted(modules)))
    assert done.returncode == 0, done.stderr


def test_every_problem_is_prepared_and_one_that_cannot_be_is_named(monkeypatch, capsys):
    def load(name: str) -> type[RobotFormation]:
        if name == 'theirs':
            raise InvalidProblem('its module is missing')
        return RobotFormation

    prepared: list[str] = []
    monkeypatch.setattr(RobotFormation, 'prepare', lambda self: prepared.append(self.name))
    monkeypatch.setattr(set_up, 'load_problem', load)
    for names, code in ((['robot_formation'], 0), (['theirs', 'robot_formation'], 1)):
        monkeypatch.setattr(set_up, 'problem_names', lambda names=names: names)
        assert set_up.main() == code
        assert prepared.pop() == 'robot_formation'
        captured = capsys.readouterr()
        assert 'kernels of robot_formation' in captured.out
        assert ('theirs cannot be prepared: its module is missing' in captured.err) == code


@pytest.mark.parametrize(
    ('name', 'program', 'said'),
    [
        *((name, f"{{'numba': None}}); from {module} import main; main()",
           "not installed: numba; .*'pip install numba'")
          for name, module in EXECUTABLES.items()),
        ('planner', "{'rclpy': None}); import tdm_planner", "'rclpy', which is not installed"),
    ],
)  # fmt: skip
def test_executables_say_which_package_is_missing(name, program, said, tmp_path):
    script = tmp_path / name
    script.write_text(f'import sys; sys.modules.update({program}')
    done = python(str(script))
    assert (done.returncode, done.stdout) == (1, '')
    (line,) = done.stderr.splitlines()
    assert re.search(said, line)


def test_executables_and_modules_that_are_run_use_one_thread_unless_told_otherwise(tmp_path):
    pytest.importorskip('rclpy')
    tell = f'import os; print([os.environ.get(name) for name in {THREADS}])'
    (tmp_path / 'planner').write_text(f'import tdm_planner\n{tell}')
    as_module = 'import sys; sys.orig_argv = ["python", "-m", "{0}"]; import {0}\n'
    for words in (
        [str(tmp_path / 'planner')],
        ['-c', as_module.format('tdm_planner.set_up') + tell],
        ['-c', as_module.format('benchmark.pendulum') + tell],
    ):
        assert python(*words).stdout == "['1', '1', '1']\n"
    told = python(str(tmp_path / 'planner'), **dict.fromkeys(THREADS, '2'))
    assert told.stdout == "['2', '2', '2']\n"


def make_share(prefix: Path, indexed: bool) -> Path:
    share = prefix / 'share' / 'tdm_planner'
    (share / 'config').mkdir(parents=True)
    (share / 'config' / 'mine.yaml').touch()
    if indexed:
        index = prefix / 'share/ament_index/resource_index/packages'
        index.mkdir(parents=True)
        (index / 'tdm_planner').touch()
    return share


def test_a_sourced_workspace_comes_before_the_python_environment_before_the_sources(
    tmp_path, monkeypatch
):
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'python'))
    assert resources.share_directory() == SOURCE
    assert resources.config_file('pendulum.yaml') == SOURCE / 'config' / 'pendulum.yaml'
    monkeypatch.setattr(resources, '__file__', str(tmp_path / 'site-packages/a/b.py'))
    with pytest.raises(FileNotFoundError, match=r'looked in .*python/share/tdm_planner'):
        resources.share_directory()
    share = make_share(tmp_path / 'python', indexed=False)
    assert resources.share_directory() == share
    with pytest.raises(FileNotFoundError, match=r"'pendulum.yaml'.*there is: mine\.yaml"):
        resources.config_file('pendulum.yaml')
    not_indexed, workspace = tmp_path / 'other', tmp_path / 'workspace'
    make_share(not_indexed, indexed=False)
    share = make_share(workspace, indexed=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{not_indexed}:{workspace}')
    assert resources.share_directory() == share


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_interrupts_and_the_second_does_not_disturb(number: signal.Signals):
    """What must not be interrupted is done whole."""
    before, done = signal.getsignal(number), []
    with interruptible(), uninterrupted():
        pass  # without a signal nothing happens
    assert signal.getsignal(number) is before

    def work(whole: bool):
        with interruptible():
            try:
                with uninterrupted() if whole else nullcontext():
                    signal.raise_signal(number)
                    done.append('whole')
                done.append('more')
            finally:
                signal.raise_signal(signal.SIGINT)
                signal.raise_signal(signal.SIGTERM)
                done.append('cleaned up')

    for whole, expected in ((False, ['cleaned up']), (True, ['whole', 'cleaned up'])):
        done.clear()
        with pytest.raises(Interrupted) as found:
            work(whole)
        assert (done, found.value.code) == (expected, 128 + number)
        assert signal.getsignal(number) is before


RECORD = ['tdm', 'record', '-o', 'bag']


@pytest.mark.parametrize(
    ('line', 'command', 'node'),
    [
        ('python -m tdm_planner.cli record -o bag', RECORD, False),
        ('python /opt/bin/tdm record -o bag', RECORD, False),
        ('python /opt/bin/other record', [], False),
        ('python -m pytest record', [], False),
        ('python -m pytest planner', [], False),
        ('python -m nav.planner', [], False),
        ('python -c 1', [], False),
        ('python -m tdm_planner.nodes.planner --ros-args', [], True),
        ('python -X dev -m tdm_sim.robot_plant', [], True),
        ('python -m tdm_sim.stated_plant', [], True),
        ('python /opt/lib/tdm_planner/tracker', [], True),
    ],
)
def test_processes_of_ones_own_are_told_from_others(line, command, node, monkeypatch):
    words = line.split()
    monkeypatch.setattr('sys.orig_argv', words)
    monkeypatch.setattr('sys.argv', words[1:] if words[1][0] == '/' else ['-m'])
    assert starting.command() == command
    assert starting.is_node() is node


@pytest.mark.parametrize('wheels', [True, False])
def test_wheels_beside_a_sourced_installation_are_refused(wheels, tmp_path, monkeypatch):
    (tmp_path / 'opt/ros/lib/python3.12/site-packages/rclpy').mkdir(parents=True)
    (tmp_path / 'workspace').mkdir()
    monkeypatch.setattr(starting, 'find_spec', lambda name: wheels or None)
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')
    starting.require_one_ros()
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/workspace:{tmp_path}/opt/ros')
    if not wheels:
        starting.require_one_ros()
        return
    with pytest.raises(ImportError) as error:
        starting.require_one_ros()
    assert f'{tmp_path}/opt/ros' in str(error.value)
    assert sys.prefix in str(error.value)


def test_an_interrupted_import_is_an_interruption():
    """An extension that is being imported makes an ImportError of what a signal raises."""

    def load():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as interrupted:
            raise ImportError('initialization failed') from interrupted

    with pytest.raises(Interrupted), interruptible():
        load()
