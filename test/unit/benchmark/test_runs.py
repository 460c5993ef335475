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

from collections.abc import Callable
from contextlib import suppress
import json
from pathlib import Path
from queue import Queue
import shutil
import subprocess
import time
from typing import Any

from benchmark import __main__ as command
from benchmark import figures as records_of_runs
from benchmark import page, runner
from benchmark.progress import MARK
from benchmark.sections import Section, SECTIONS
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


def test_a_section_that_hangs_is_ended_with_all_that_it_started(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The limit is over once the section has said what it started."""
    said: Queue[str] = Queue()
    children: list[int] = []

    class Hanging(subprocess.Popen):  # type: ignore[type-arg]
        """Whose limit is over at once."""

        def wait(self, timeout: float | None = None) -> int:
            if timeout == 3.0:
                children.append(int(said.get(timeout=60.0)))
                raise subprocess.TimeoutExpired(self.args, timeout)
            return super().wait(timeout)

    monkeypatch.setattr(subprocess, 'Popen', Hanging)
    words = ['sh', '-c', f'sleep 600 & echo "{MARK}$!"; wait']
    failure, _ = runner._watched(words, 3.0, said.put)
    assert failure == 'it took longer than 3 s and was ended'
    state = Path(f'/proc/{children[0]}/stat')
    with suppress(FileNotFoundError, ProcessLookupError):
        while state.read_text().rsplit(')', 1)[1].split()[0] != 'Z':
            time.sleep(0.01)


FIGURES = {
    'parameters': 3,
    'evaluations_per_second': 1.0,
    'batched_evaluations_per_second': 1.0,
    'linearisations_per_second': 1.0,
    'lines': {},
    'double_integrator': {},
    'brachistochrone': 1.5,
    'landing': {'ratio': {}, 'reference': 1.0, 'reference_half_grid': 1.0},
}


@pytest.fixture
def measure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Return the command, of which every section but 'library' breaks at once."""

    def run(section: Section, settings: Any, report: Any) -> runner.Outcome:
        report('at work')
        figures, failure = (FIGURES, '') if section.name == 'library' else (None, 'it broke')
        return runner.Outcome(settings, 'today', 1.0, figures, failure, ('a line of its log',))

    monkeypatch.setattr(command, 'run', run)
    return lambda *words: command.main([*words, '--output', str(tmp_path)])


def test_a_failure_is_on_the_page_and_in_the_exit_code(
    tmp_path: Path, measure: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert measure('--quick') == 1
    text = (tmp_path / 'benchmarks.md').read_text()
    assert text.count('**failed** - it broke') == len(SECTIONS) - 1
    printed = capsys.readouterr()
    assert 'a line of its log' in printed.out
    assert printed.err.startswith('failed: pendulum, rigs, robots')
    for words, said in (
        (['latencies'], "there is no section 'latencies'"),
        (['peers', '--set', 'seeds=1'], "'peers' has no setting 'seeds': must be of cases"),
    ):
        with pytest.raises(SystemExit):
            measure(*words)
        assert said in capsys.readouterr().err


def test_a_section_alone_brings_the_page_up_to_date(
    tmp_path: Path, measure: Callable[..., int]
) -> None:
    assert measure('library', '--no-docs') == 0
    assert not list(tmp_path.iterdir())
    assert (measure('library', '--set', 'free=[2]'), measure('robots')) == (0, 1)
    records = json.loads((tmp_path / 'benchmarks.json').read_text())
    assert list(records) == ['robots', 'library']  # in the order of the page
    assert records['library']['settings']['free'] == [2]
    text = (tmp_path / 'benchmarks.md').read_text()
    assert 'brachistochrone, time over the cycloid: 1.5' in text
    assert '`python -m benchmark robots`, today: **failed**' in text
    assert '`python -m benchmark peers`: not measured yet.' in text


def test_the_page_is_that_of_the_figures(tmp_path: Path) -> None:
    """Written anew from the figures beside it, it is the same."""
    pytest.importorskip('casadi')
    shutil.copytree(page.DOCS / 'images', tmp_path / 'images')
    page.write(records_of_runs.read(page.DOCS), tmp_path)
    for name in ('benchmarks.md', 'images/benchmark_success.png'):
        assert (tmp_path / name).stat().st_size > 1000
    written = (tmp_path / 'benchmarks.md').read_text()
    assert written == (page.DOCS / 'benchmarks.md').read_text()
