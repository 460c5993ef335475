# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""``tdm report`` as users run it."""

import os
from pathlib import Path
import subprocess
import sys

import pytest
from ros_harness import UNHURRIED

SOURCE = Path(__file__).resolve().parents[3]


def tdm(*arguments, cwd):
    return subprocess.run(
        [sys.executable, '-m', 'tdm_planner.cli', *map(str, arguments)],
        cwd=cwd,
        env=os.environ | {'PYTHONPATH': str(SOURCE)},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.fixture(scope='module')
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp('plan') / 'plan.json'
    done = tdm('plan', 'robots', '-q', '-o', path, *UNHURRIED, cwd=path.parent)
    assert done.returncode == 0, done.stderr
    return path


def test_a_plan(plan, tmp_path):
    done = tdm('report', plan, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].endswith(f'reading {plan}')
    assert lines[-1] == 'written to report.html'
    page = (tmp_path / 'report.html').read_text()
    assert 'robots in formation after' in page
    assert 'nothing is measured' in page


def test_quiet(plan, tmp_path):
    done = tdm('report', plan, '-o', 'page.htm', '--quiet', cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')
    assert (tmp_path / 'page.htm').stat().st_size < 8_000_000


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['absent'], ["'absent'"]),
        (['.'], ["'.'", 'no recording']),
        (['text.json'], ['text.json', 'not JSON']),
        (['PLAN', '--namespace', 'x'], ['plan.json', 'has no namespaces']),
        (['PLAN', '-o', 'page.pdf'], ['page.pdf', '.html']),
        (['PLAN', '-o', 'missing/page.html'], ['missing', 'does not exist']),
    ],
)
def test_mistakes_get_one_sentence(plan, tmp_path, arguments, words):
    (tmp_path / 'text.json').write_text('not json')
    before = sorted(tmp_path.iterdir())
    done = tdm('report', *[plan if a == 'PLAN' else a for a in arguments], cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert 'INVALID_PROBLEM' not in done.stderr
    assert all(word in done.stderr for word in words), done.stderr
    assert sorted(tmp_path.iterdir()) == before
