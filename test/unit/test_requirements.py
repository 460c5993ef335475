# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a process does first: look for required packages, limit the threads of BLAS."""

from __future__ import annotations

import os
from pathlib import Path
import re
import subprocess
import sys

import pytest
from tdm_planner.starting import REQUIRED

SOURCE = Path(__file__).resolve().parents[2]
EXECUTABLES = {
    'planner': 'tdm_planner.nodes.planner',
    'tracker': 'tdm_planner.nodes.tracker',
    'pendulum_plant': 'tdm_sim.pendulum_plant',
    'robot_plant': 'tdm_sim.robot_plant',
    'tdm': 'tdm_planner.cli',
}
THREADS = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')
COUNT = """
import numpy as np
matrix = np.ones((500, 500))
matrix @ matrix
import os
print('threads', len(os.listdir('/proc/self/task')))
"""


def python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    others = {name: value for name, value in os.environ.items() if name not in THREADS}
    return subprocess.run(
        [sys.executable, *arguments],
        env={**others, **environment, 'PYTHONPATH': str(SOURCE)},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize('name', EXECUTABLES)
def test_executables_say_which_package_is_missing(name: str, tmp_path: Path) -> None:
    script = tmp_path / name
    script.write_text(
        "import sys; sys.modules['numba'] = None\n"
        f'from {EXECUTABLES[name]} import main; sys.exit(main())\n'
    )
    done = python(str(script))
    assert done.returncode == 1
    assert done.stdout == ''
    (line,) = done.stderr.splitlines()
    assert 'not installed: numba;' in line
    assert "'pip install numba'" in line


def test_a_node_without_ros_says_how_to_get_it(tmp_path: Path) -> None:
    script = tmp_path / 'planner'
    script.write_text("import sys; sys.modules['rclpy'] = None; import tdm_planner\n")
    done = python(str(script))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "'rclpy', which is not installed" in line


def test_users_of_the_library_get_the_same_as_an_error() -> None:
    blocked = f'import sys; sys.modules.update(dict.fromkeys({list(REQUIRED)}))\n'
    tried = (
        'try: from tdm_planner.problems import PendulumSwingUp\nexcept ImportError as e: print(e)'
    )
    done = python('-c', f'{blocked}\n{tried}')
    assert f"'pip install {' '.join(REQUIRED.values())}'" in done.stdout, done.stderr


def test_setup_requires_the_same_packages() -> None:
    setup = (SOURCE / 'setup.py').read_text(encoding='utf-8')
    (listed,) = re.findall(r'install_requires=\[(.*?)\]', setup, re.DOTALL)
    names = re.findall(r"'([\w-]+)[^']*'", listed)
    assert sorted(names) == sorted(REQUIRED.values())


def test_launch_files_need_only_what_ubuntu_has() -> None:
    """`ros2 launch` runs them in the system's Python, not in the environment of the nodes."""
    pytest.importorskip('rclpy')
    missing = ['daqp', 'mcap', 'numba', 'plotly', 'rosbags', 'zstandard']
    text = ''.join(path.read_text('utf-8') for path in (SOURCE / 'launch').glob('*.py'))
    text += (SOURCE / 'tdm_planner' / 'launching.py').read_text('utf-8')
    modules = set(re.findall(r'from (tdm_\w+[\w.]+) import', text)) - {'tdm_planner.launching'}
    assert 'tdm_planner.nodes.robot_nodes' in modules
    program = f'import sys; sys.modules.update(dict.fromkeys({missing}))\n'
    done = python('-c', program + ''.join(f'import {name}\n' for name in sorted(modules)))
    assert done.returncode == 0, done.stderr


def threads(*arguments: str, **environment: str) -> int:
    """Return how many threads there are after a product of matrices; libraries have some, too."""
    done = python(*arguments, **environment)
    assert done.returncode == 0, done.stderr
    return int(done.stdout.split()[-1])


@pytest.mark.parametrize('name', ['planner', 'pendulum_plant', 'tdm'])
def test_executables_use_one_thread_for_blas(name: str, tmp_path: Path) -> None:
    pytest.importorskip('rclpy')
    script = tmp_path / name
    script.write_text(f'import {EXECUTABLES[name]}\n{COUNT}')
    assert threads(str(script)) == threads(str(script), **dict.fromkeys(THREADS, '1'))


@pytest.mark.parametrize('module', ['tdm_planner.set_up', 'benchmark.pendulum', 'tools.load'])
def test_modules_that_are_run_use_one_thread_for_blas(module: str) -> None:
    pytest.importorskip('rclpy')
    program = f'import sys; sys.orig_argv = ["python", "-m", "{module}"]; import {module}\n{COUNT}'
    assert threads('-c', program) == threads('-c', program, **dict.fromkeys(THREADS, '1'))


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason='one core')
def test_threads_that_the_environment_asks_for_are_kept(tmp_path: Path) -> None:
    script = tmp_path / 'tdm'
    script.write_text(f'import tdm_planner\n{COUNT}')
    assert threads(str(script)) < threads(str(script), **dict.fromkeys(THREADS, '2'))


def test_processes_of_others_are_left_alone() -> None:
    done = python('-c', f'import os, tdm_planner; print([n in os.environ for n in {THREADS}])')
    assert done.stdout == '[False, False, False]\n', done.stderr
