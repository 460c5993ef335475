# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A worked plant, installed from a folder of its own, in `tdm plan` and in the planner node."""

from collections.abc import Iterator
import json
import os
from pathlib import Path
import subprocess
import sys

import pytest
from ros_harness import NodeProcess, Ros

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder as pip leaves it: the page as a module, registered by metadata."""
    folder = tmp_path_factory.mktemp('site')
    page = ROOT / 'docs' / 'plants' / 'double_integrator.py'
    (folder / 'students_plant.py').write_text(page.read_text())
    metadata = folder / 'students_plant-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text(
        'Metadata-Version: 2.1\nName: students-plant\nVersion: 1.0\n'
    )
    (metadata / 'entry_points.txt').write_text(
        '[tdm_planner.problems]\ndouble_integrator = students_plant:DoubleIntegrator\n'
    )
    return folder


def test_tdm_plan(site: Path, tmp_path: Path):
    path = os.pathsep.join([str(site), str(ROOT), os.environ.get('PYTHONPATH', '')])
    command = [sys.executable, '-m', 'tdm_planner.cli', 'plan', 'double_integrator']
    options = ['--set', 'start.x=3.0', '--set', 'solver.deadline=20.0', '-o', 'plan.json']
    done = subprocess.run(
        [*command, *options],
        cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    plan = json.loads((tmp_path / 'plan.json').read_text())
    assert plan['problem'] == 'double_integrator'
    assert plan['verification']['ok']
    assert plan['states']['x'][0] == 3.0
    assert abs(plan['states']['x'][-1]) < 1e-9
    assert 2 * 3.0**0.5 < plan['duration'] < 1.05 * 2 * 3.0**0.5


@pytest.fixture
def planner(ros: Ros, site: Path) -> Iterator[NodeProcess]:
    path = os.pathsep.join([str(site), ros.environment['PYTHONPATH']])
    process = ros.start(
        'tdm_planner.nodes.planner',
        {
            'problem': 'double_integrator',
            'start.source': 'parameters',
            'start.x': 3.0,
            'solver.deadline': 5.0,
        },
        namespace='student',
        environment={'PYTHONPATH': path},
    )
    yield process
    if process.running:
        process.end_cleanly()


def test_planner_service(ros: Ros, planner: NodeProcess):
    success, answer = ros.trigger('/student/plan')
    assert success, answer
    assert 2 * 3.0**0.5 < answer['duration'] < 1.05 * 2 * 3.0**0.5
