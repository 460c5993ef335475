# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Kernels are compiled once; whoever must wait for it is told."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

from planned_apart import planned_apart
from ros_harness import ros_arguments, SOURCE
from tdm_planner.plants.compilation import COMPILING

PROGRAM = """
from tdm_planner.plants.compilation import tell_of_compilation
from tdm_planner.plants.robot_replay import compile_robot_replay

tell_of_compilation(print)
for _ in range(2):
    compile_robot_replay()
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
    with (copy / 'tdm_planner/plants/pendulum_lanes.py').open('a') as other:
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
