# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The benchmark says what failed, and keeps its figures and its page together."""

from __future__ import annotations

from pathlib import Path
import shutil

from benchmark import __main__ as command
from benchmark import figures as records_of_runs
from benchmark import page, runner
from benchmark.progress import MARK
from benchmark.sections import SECTIONS
import pytest


def shell(script: str) -> tuple[str, tuple[str, ...], list[str]]:
    said: list[str] = []
    failure, log = runner._watched(['sh', '-c', script], 600.0, said.append)
    return failure, log, said


@pytest.mark.parametrize(
    ('code', 'says'),
    [
        ('', ''),
        ('echo "ValueError: a wrong number"; echo; exit 1', 'ValueError: a wrong number'),
        ('kill -ABRT $$', 'it was ended by SIGABRT'),
    ],
)
def test_how_a_section_ended(code: str, says: str) -> None:
    failure, log, said = shell(f'echo "{MARK}at work"; echo something else; {code}')
    assert (failure, said) == (says, ['at work'])
    assert 'something else' in log


def test_a_failure_is_on_the_page_and_in_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = runner.Outcome({}, 'today', 1.0, None, 'it broke', ('a line of its log',))
    monkeypatch.setattr(command, 'run', lambda *_: broken)
    assert command.main(['--quick', '--output', str(tmp_path)]) == 1
    text = (tmp_path / 'benchmarks.md').read_text()
    assert text.count('**failed** - it broke') == len(SECTIONS)


def test_the_page_is_that_of_the_figures(tmp_path: Path) -> None:
    """Written anew from the figures beside it, it is the same."""
    pytest.importorskip('casadi')
    shutil.copytree(page.DOCS / 'images', tmp_path / 'images')
    page.write(records_of_runs.read(page.DOCS), tmp_path)
    for name in ('benchmarks.md', 'images/benchmark_success.png'):
        assert (tmp_path / name).stat().st_size > 1000
    written = (tmp_path / 'benchmarks.md').read_text()
    assert written == (page.DOCS / 'benchmarks.md').read_text()
