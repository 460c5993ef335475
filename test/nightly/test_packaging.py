# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What is built, by colcon and as a wheel; kernels: compiled once, and whoever waits is told."""

from configparser import ConfigParser
import importlib.util
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import zipfile

from planned_apart import planned_apart
import pytest
from ros_harness import MODULES, ros_arguments, SOURCE
import tdm_planner
from tdm_planner.plants.compilation import COMPILING

EXECUTABLES = {*MODULES, 'tdm'}
PROBLEMS = {'pendulum_swing_up', 'robot_formation'}
COLCON = 'import sys; from colcon_core.command import main; sys.exit(main())'
NOT_SOURCES = ('.*', 'build', 'install', 'log', '__pycache__', '*.egg-info')


def run(*command: str, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, f'{" ".join(command)}\n{done.stdout}\n{done.stderr}'
    return done.stdout


@pytest.fixture(scope='module')
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the sources, so that building leaves nothing behind in the tree."""
    workspace = tmp_path_factory.mktemp('workspace')
    target = workspace / 'src' / 'tdm_planner'
    shutil.copytree(SOURCE, target, ignore=shutil.ignore_patterns(*NOT_SOURCES))
    (target / '.venv').symlink_to(sys.prefix)  # the environment of `make setup`
    return target


def files(folder: str, pattern: str) -> set[str]:
    found = (SOURCE / folder).rglob(pattern)
    return {str(path.relative_to(SOURCE)) for path in found if '__pycache__' not in path.parts}


SHARED = {'package.xml'} | files('config', '*.*') | files('launch', '*.*')


@pytest.fixture(scope='module', params=['plain', 'symlinks'])
def installed(request: pytest.FixtureRequest, copy: Path) -> Path:
    if importlib.util.find_spec('colcon_ros') is None:
        pytest.skip('colcon is not installed (pip install colcon-core colcon-ros)')
    workspace = copy.parents[1] / request.param
    options = ['--symlink-install'] if request.param == 'symlinks' else []
    workspace.mkdir()
    said = colcon(workspace, 'build', '--base-paths', str(copy.parent), *options)
    assert 'stderr' not in said, said  # which is where warnings go
    return workspace / 'install' / 'tdm_planner'


def colcon(workspace: Path, verb: str, *arguments: str) -> str:
    log = ('--log-base', str(workspace / 'log'))
    return run(sys.executable, '-c', COLCON, *log, verb, *arguments, cwd=workspace)


def test_colcon_runs_the_tests(installed, copy):
    workspace = installed.parents[1]
    said = colcon(
        *(workspace, 'test', '--base-paths', str(copy.parent)),
        *('--pytest-args', 'test/unit/test_trajectory.py', 'test/unit/test_parameters.py'),
    )
    assert 'stderr' not in said, said
    result = colcon(workspace, 'test-result')
    assert re.search(r'Summary: [1-9]\d* tests, 0 errors, 0 failures, 0 skipped', result), result


def test_colcon_installs_what_ros2_looks_for(installed, copy):
    folder, share = installed / 'lib' / 'tdm_planner', installed / 'share'
    assert {path.name for path in folder.iterdir()} == EXECUTABLES
    assert all(os.access(folder / name, os.X_OK) for name in EXECUTABLES)
    # They run in that environment, which is not activated, whichever Python colcon runs in.
    first_lines = {path.read_text().splitlines()[0] for path in folder.iterdir()}
    assert first_lines == {f'#!{copy}/.venv/bin/python'}
    assert (share / 'ament_index/resource_index/packages/tdm_planner').is_file()
    missing = {name for name in SHARED if not (share / 'tdm_planner' / name).is_file()}
    assert not missing
    answer = run_sourced(installed, f'{folder}/tdm --version')
    assert tdm_planner.__version__ in answer
    code = 'import tdm_planner.parameter_files as p; print(p.config_file("pendulum.yaml"))'
    found = run_sourced(installed, f"{sys.executable} -c '{code}'")
    assert found.strip() == str(share / 'tdm_planner/config/pendulum.yaml')


def run_sourced(installed: Path, command: str) -> str:
    prefix = installed.parent
    script = f'export COLCON_CURRENT_PREFIX={prefix}; . {prefix}/local_setup.sh && {command}'
    return run('sh', '-c', script, cwd=prefix)


def test_wheel_holds_every_module_and_file_and_declares_what_it_offers(copy):
    if importlib.util.find_spec('setuptools.command.bdist_wheel') is None:
        pytest.skip('setuptools 70.1 or newer is not installed')
    folder = copy.parents[1] / 'wheel'
    code = (
        'import os, sys; from setuptools import build_meta; '
        f'os.chdir({str(copy)!r}); build_meta.build_wheel({str(folder)!r})'
    )
    folder.mkdir()
    run(sys.executable, '-c', code, cwd=copy)
    (path,) = folder.glob('*.whl')
    wheel = zipfile.ZipFile(path)
    names, assets = set(wheel.namelist()), files('tdm_sim/report/assets', '*.*')
    assert 'tdm_sim/report/assets/page.html' in assets
    assert assets | files('tdm_planner', '*.py') | files('tdm_sim', '*.py') <= names
    assert not {name for name in names if name.startswith(('test/', 'benchmark/', 'tools/'))}
    share = f'tdm_planner-{tdm_planner.__version__}.data/data/share'
    assert {f'{share}/tdm_planner/{name}' for name in SHARED} <= names
    assert f'{share}/ament_index/resource_index/packages/tdm_planner' in names
    entry_points = ConfigParser()
    info = f'tdm_planner-{tdm_planner.__version__}.dist-info'
    entry_points.read_string(wheel.read(f'{info}/entry_points.txt').decode())
    assert set(entry_points['console_scripts']) == EXECUTABLES
    assert set(entry_points['tdm_planner.problems']) == PROBLEMS


PROGRAM = """
import numpy as np
from tdm_planner.plants.compilation import report_compilation
from tdm_planner.plants.robot_replay import replayed

report_compilation(print)
for _ in range(2):
    replayed(np.arange(2.0), np.zeros((2, 3)), np.zeros(7), True, 1.0, 1.0, np.zeros(1))
"""


def said(folder: Path, source: Path = SOURCE) -> str:
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(folder), 'PYTHONPATH': str(source)}
    command = [sys.executable, '-c', PROGRAM]
    return subprocess.check_output(command, env=environment, cwd=source, text=True, timeout=120)


def test_kernels_are_compiled_once_and_anew_when_the_sources_change(tmp_path):
    assert said(tmp_path) == f'{COMPILING}\n'
    assert said(tmp_path) == ''
    copy = tmp_path / 'copy'
    for package in ('tdm_planner', 'tdm_sim'):
        shutil.copytree(SOURCE / package, copy / package)
    assert said(tmp_path, copy) == ''
    with (copy / 'tdm_planner/plants/pendulum_kernels.py').open('a') as other:
        other.write('# changed\n')
    assert COMPILING in said(tmp_path, copy)


def test_a_planner_that_must_compile_says_so_once(ros, tmp_path):
    words = ros_arguments({'problem': 'robot_formation'})
    planner = ros.run('tdm_planner.nodes.planner', words, {'NUMBA_CACHE_DIR': str(tmp_path)})
    assert ros.spin_until(lambda: COMPILING in planner.output, 60.0), planner.output
    assert planner.end() == 0
    assert planner.output.count(COMPILING) == 1


def test_kernels_compiled_anew_change_no_plan(tmp_path):
    assert planned_apart(NUMBA_CACHE_DIR=str(tmp_path)) == planned_apart()
