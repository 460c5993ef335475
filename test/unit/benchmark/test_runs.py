# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The benchmark says what failed, and keeps its figures, its page and its aims together."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import reduce
import json
from operator import getitem
from pathlib import Path
from queue import Queue
import shutil
import subprocess
import time
from typing import Any

from benchmark import __main__ as command
from benchmark import aims, page, runner
from benchmark import figures as records
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


PUSHED = ('model errors and noise', 'and a push half-way')
MOVED = ('one is pushed', 'the goal moves')
REGIME = {'planned': 1.0, 'median_ms': 1.0, 'p95_ms': 1.0, 'slowest_ms': 1.0, 'memory_mb': 1.0}
REGIME |= {'peak_memory_mb': 1.0, 'failures': {}}
NODES = {'first_answer_s': [1.0], 'overrun_ms': {'0.1': 5.0}, 'strong': REGIME, 'weak': REGIME}


@pytest.fixture
def measure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Return the command, of which every section but 'nodes' breaks at once."""

    def run(section: Section, settings: Any, report: Any) -> runner.Outcome:
        report('at work')
        figures, failure = (NODES, '') if section.name == 'nodes' else (None, 'it broke')
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
    with pytest.raises(SystemExit):
        measure('latencies')
    assert "there is no section 'latencies'" in capsys.readouterr().err


def test_a_section_alone_brings_the_page_up_to_date(
    tmp_path: Path, measure: Callable[..., int]
) -> None:
    assert measure('nodes', '--no-docs') == 0
    assert not list(tmp_path.iterdir())
    assert (measure('nodes'), measure('robots')) == (0, 1)
    found = json.loads((tmp_path / 'benchmarks.json').read_text())
    assert list(found) == ['robots', 'nodes']  # in the order of the page
    assert '`python -m benchmark peers`: not measured' in (tmp_path / 'benchmarks.md').read_text()


def test_the_page_is_that_of_the_figures(tmp_path: Path) -> None:
    """Written anew from the figures beside it, it is the same."""
    pytest.importorskip('casadi')
    shutil.copytree(page.DOCS / 'images', tmp_path / 'images')
    page.write(records.read(page.DOCS), tmp_path)
    for name in ('benchmarks.md', 'images/benchmark_growth.png'):
        assert (tmp_path / name).stat().st_size > 1000
    written = (tmp_path / 'benchmarks.md').read_text()
    assert written == (page.DOCS / 'benchmarks.md').read_text()


def test_every_figure_that_falls_short_is_seen() -> None:
    """And what was not measured is not met."""
    assert {tuple(aim.row({})[1:]) for aim in aims.AIMS} == {(aims.NOT_MEASURED, '-')}
    measured = {name: record['figures'] for name, record in records.read(page.DOCS).items()}

    def met(path: str, value: float) -> list[str]:
        figures: dict[str, Any] = json.loads(json.dumps(measured))
        *parents, key = path.split('/')
        place = reduce(getitem, parents, figures)
        assert key in place
        place[key] = value
        return [aim.row(figures)[-1] for aim in aims.AIMS]

    pendulum, robots = 'replanning/pendulum/', 'replanning/robots/quick robots, '
    for path, enough, short in (
        *((f'{pendulum}{case}/at_once', 36, 35) for case in PUSHED),
        *((f'{pendulum}{case}/held', 40, 39) for case in PUSHED),
        *((f'{robots}{case}/arrived', 40, 39) for case in MOVED),
        *((f'{robots}{case}/separated', 40, 39) for case in MOVED),
        ('latency/latency/pendulum weak, warm/p50_ms', 10.0, 11.0),
        ('latency/latency/pendulum strong, cold/p50_ms', 100.0, 101.0),
        ('latency/latency/pendulum strong, warm/p99_ms', 300.0, 301.0),
        ('latency/latency/pendulum weak, cold/p99_ms', 300.0, 301.0),
        ('latency/latency/three robots, warm/p50_ms', 15.0, 16.0),
        ('latency/latency/three robots, warm/p99_ms', 60.0, 61.0),
        ('latency/overruns/late', 0, 1),
        ('latency/stream/p99_ms', 5.0, 5.1),
        ('latency/overruns/memory_mb', 230.0, 300.0),
    ):
        pairs = zip(met(path, enough), met(path, short), strict=True)
        assert [pair for pair in pairs if len({*pair}) == 2] == [('yes', '**no**')], path
