# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The benchmark runs, keeps its figures and says what failed; flame graphs come from stacks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import json
import math
from pathlib import Path
import shutil
import sys
import time
from typing import Any

from benchmark import __main__ as command
from benchmark import explanations, flame, page, runner
from benchmark import figures as records_of_runs
from benchmark.sections import Section, SECTIONS
import pytest
import tdm_planner

PIECE = """
from benchmark.progress import report
import os
report('at work')
print('something else')
{code}
"""


def told(tmp_path: Path, code: str, limit: float = 60.0) -> tuple[str, tuple[str, ...], list[str]]:
    file = tmp_path / 'piece.py'
    file.write_text(PIECE.format(code=code))
    said: list[str] = []
    words = ['env', f'PYTHONPATH={runner.ROOT}', sys.executable, str(file)]
    failure, log = runner._watched(words, limit, said.append)
    return failure, log, said


@pytest.mark.parametrize(
    ('code', 'says'),
    [
        ('', ''),
        ('raise ValueError("a wrong number")', 'ValueError: a wrong number'),
        ('os.abort()', 'it was ended by SIGABRT'),
    ],
)
def test_how_a_section_ended(tmp_path: Path, code: str, says: str) -> None:
    failure, log, said = told(tmp_path, code)
    assert (failure, said) == (says, ['at work'])
    assert 'something else' in log


def test_a_section_that_hangs_is_ended_with_all_that_it_started() -> None:
    words = ['sh', '-c', 'sleep 600 & echo $!; wait']
    failure, log = runner._watched(words, 3.0, lambda _: None)
    assert failure == 'it took longer than 3 s and was ended'
    child = int(next(line for line in log if line.isdigit()))
    state = Path(f'/proc/{child}/stat')
    assert not state.exists() or state.read_text().rsplit(')', 1)[1].split()[0] == 'Z'


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
    assert printed.err.startswith('failed: pendulum, robots')
    with pytest.raises(SystemExit):
        measure('latencies')
    assert "there is no section 'latencies'" in capsys.readouterr().err


def test_a_section_alone_brings_the_page_up_to_date(
    tmp_path: Path, measure: Callable[..., int]
) -> None:
    assert measure('nodes', '--no-docs') == 0
    assert not list(tmp_path.iterdir())
    assert (measure('nodes'), measure('robots')) == (0, 1)
    records = json.loads((tmp_path / 'benchmarks.json').read_text())
    assert list(records) == ['robots', 'nodes']  # in the order of the page
    text = (tmp_path / 'benchmarks.md').read_text()
    assert 'process start to first answer: 1.00 s' in text
    assert '`python -m benchmark robots`, today: **failed**' in text
    assert '`python -m benchmark peers`: not measured yet.' in text


@pytest.mark.parametrize('section', SECTIONS.values(), ids=SECTIONS)
def test_a_quick_run_has_settings_of_the_same_names(section: Section) -> None:
    assert set(section.quick) == set(section.full)
    assert section.described(section.full)


def test_the_page_is_that_of_the_figures(tmp_path: Path) -> None:
    """Written anew from the figures beside it, it is the same."""
    pytest.importorskip('casadi')
    shutil.copytree(page.DOCS / 'images', tmp_path / 'images')
    page.write(records_of_runs.read(page.DOCS), tmp_path)
    for name in ('benchmarks.md', 'images/benchmark_growth.png'):
        assert (tmp_path / name).stat().st_size > 1000
    written = (tmp_path / 'benchmarks.md').read_text()
    assert written == (page.DOCS / 'benchmarks.md').read_text()


def test_records_are_kept_beside_the_page(tmp_path: Path) -> None:
    assert records_of_runs.read(tmp_path) == {}
    figures = {'value': 1.23456789e-3, 'list': [float('nan')], 'count': 7}
    records_of_runs.write(tmp_path, {'robots': {'figures': figures}})
    found = records_of_runs.read(tmp_path)['robots']['figures']
    assert (found['value'], found['count']) == (0.00123457, 7)
    assert math.isnan(found['list'][0])


def test_what_is_explained_is_a_function_of_the_package() -> None:
    sources = {
        path.stem: path.read_text() for path in Path(tdm_planner.__file__).parent.rglob('*.py')
    }
    for label, reason in explanations.EXPLANATIONS.items():
        module, function = label.split('.')
        assert f'def {function}(' in sources[module], label
        assert reason


def test_stacks_become_a_tree_and_a_picture(tmp_path: Path) -> None:
    stacks = Counter({
        ('a.main', 'b.solve', 'c.inner'): 3,
        ('a.main', 'b.solve'): 1,
        ('a.main', 'd.other'): 5,
    })  # fmt: skip
    found = flame.below(stacks, 'b.solve')
    tree = flame.tree(found, 'b.solve')
    assert tree == flame.Frame('b.solve', 4, (flame.Frame('c.inner', 3, ()),))
    assert flame.costs(found) == [('b.solve', 1.0), ('c.inner', 0.75)]
    flame.draw(tree, {'b', 'c'}, 'a title', tmp_path / 'flame.png')
    assert (tmp_path / 'flame.png').stat().st_size > 1000


def test_the_sampler_sees_who_spends_the_time() -> None:
    def spin(seconds: float) -> None:
        until = time.process_time() + seconds
        while time.process_time() < until:
            pass

    with flame.Sampler() as sampler:
        spin(0.3)
    assert sum(sampler.stacks.values()) >= 10
    assert dict(flame.costs(sampler.stacks))['test_runs.spin'] > 0.8
