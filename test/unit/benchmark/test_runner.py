# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A section that fails, crashes or hangs takes no other with it; the command says so."""

from __future__ import annotations

from dataclasses import replace
import json
import os
from pathlib import Path
import sys
from typing import Any

from benchmark import __main__ as command
from benchmark import runner
from benchmark.sections import Section, SECTIONS
import pytest

PIECE = """
from benchmark.progress import report
import os, subprocess, sys, time
report('at work')
print('something else')
{code}
"""


def told(tmp_path: Path, code: str, limit: float = 60.0) -> tuple[str, tuple[str, ...], list[str]]:
    file = tmp_path / 'piece.py'
    file.write_text(PIECE.format(code=code))
    said: list[str] = []
    environment = {**os.environ, 'PYTHONPATH': str(runner.ROOT)}
    failure, log = runner._watched(
        ['env', f'PYTHONPATH={environment["PYTHONPATH"]}', sys.executable, str(file)],
        limit,
        said.append,
    )
    return failure, log, said


@pytest.mark.parametrize(
    ('code', 'says'),
    [
        ('', ''),
        ('raise ValueError("a wrong number")', 'ValueError: a wrong number'),
        ('os.abort()', 'it was ended by SIGABRT'),
    ],
)
def test_how_a_section_ended(tmp_path: Path, code: str, says: str):
    failure, log, said = told(tmp_path, code)
    assert failure == says
    assert said == ['at work']
    assert 'something else' in log


def test_a_section_that_hangs_is_ended_with_all_that_it_started(tmp_path: Path):
    code = 'print(subprocess.Popen(["sleep", "600"]).pid, flush=True); time.sleep(600)'
    failure, log, _ = told(tmp_path, code, limit=3.0)
    assert failure == 'it took longer than 3 s and was ended'
    child = int(next(line for line in log if line.isdigit()))
    state = Path(f'/proc/{child}/stat')
    assert not state.exists() or state.read_text().rsplit(')', 1)[1].split()[0] == 'Z'


def test_one_section_for_real(tmp_path: Path):
    section = replace(
        SECTIONS['robots'], quick={'scenarios': 1, 'teams': False, 'variants': False}
    )
    outcome = runner.run(section, section.quick, lambda _: None)
    assert not outcome.failure
    assert outcome.figures is not None
    assert outcome.figures['3 robots']['verified'] == 1
    assert '1/1' in section.table(outcome.figures)


@pytest.fixture
def outcomes(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Outcomes of sections by name, instead of running them."""
    found: dict[str, Any] = {}

    def run(section: Section, settings: Any, report: Any) -> runner.Outcome:
        report('at work')
        figures, failure = found.get(section.name, (None, 'it broke'))
        return runner.Outcome(settings, 'today', 1.0, figures, failure, ('a line of its log',))

    monkeypatch.setattr(command, 'run', run)
    return found


NODES = {
    'first_answer_s': [1.0],
    'overrun_ms': {'0.1': 5.0},
    **{
        regime: {
            'planned': 1.0, 'median_ms': 1.0, 'p95_ms': 1.0, 'slowest_ms': 1.0, 'memory_mb': 1.0,
            'peak_memory_mb': 1.0, 'failures': {},
        }
        for regime in ('strong', 'weak')
    },
}  # fmt: skip


def test_a_failure_is_on_the_page_and_in_the_exit_code(
    tmp_path: Path, outcomes: dict[str, Any], capsys: pytest.CaptureFixture[str]
):
    outcomes['nodes'] = NODES, ''
    assert command.main(['--quick', '--output', str(tmp_path)]) == 1
    text = (tmp_path / 'benchmarks.md').read_text()
    assert text.count('**failed** - it broke') == len(SECTIONS) - 1
    assert 'process start to first answer: 1.00 s' in text
    assert 'a quick run' in text.lower()
    printed = capsys.readouterr()
    assert 'a line of its log' in printed.out
    assert printed.err.startswith('failed: pendulum, robots')


def test_a_section_alone_brings_the_page_up_to_date(tmp_path: Path, outcomes: dict[str, Any]):
    outcomes['nodes'] = NODES, ''
    assert command.main(['nodes', '--output', str(tmp_path)]) == 0
    assert command.main(['robots', '--output', str(tmp_path)]) == 1
    records = json.loads((tmp_path / 'benchmarks.json').read_text())
    assert list(records) == ['robots', 'nodes']  # in the order of the page
    text = (tmp_path / 'benchmarks.md').read_text()
    assert 'process start to first answer: 1.00 s' in text
    assert '`python -m benchmark robots`, today: **failed**' in text
    assert '`python -m benchmark peers`: not measured yet.' in text


def test_without_docs_nothing_is_written(tmp_path: Path, outcomes: dict[str, Any]):
    outcomes['nodes'] = NODES, ''
    assert command.main(['nodes', '--no-docs', '--output', str(tmp_path)]) == 0
    assert not list(tmp_path.iterdir())


def test_a_section_that_there_is_not(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        command.main(['latencies'])
    assert "there is no section 'latencies'" in capsys.readouterr().err


@pytest.mark.parametrize('section', SECTIONS.values(), ids=SECTIONS)
def test_a_quick_run_has_settings_of_the_same_names(section: Section):
    assert set(section.quick) == set(section.full)
    assert section.described(section.full)
