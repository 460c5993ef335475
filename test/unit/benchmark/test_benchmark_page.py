# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The page of the benchmark is made from the figures of a run; flame graphs from stacks."""

from __future__ import annotations

from collections import Counter
import json
import math
from pathlib import Path
import time
from typing import Any

from benchmark import explanations, flame, page
from benchmark import figures as records_of_runs
from benchmark.peers import tables
from benchmark.peers.attempts import Attempt
from benchmark.runner import Outcome
from benchmark.sections import SECTIONS
import pytest
import tdm_planner

SOLVERS = (
    'tdm_planner', 'tdm_planner, warm', 'collocation, warm', 'collocation, swing',
    'collocation, straight line', 'collocation, best of 3 guesses',
)  # fmt: skip


def figures(cases: int = 4) -> dict[str, Any]:
    """Figures as a run writes them, read back from JSON."""
    attempts = {
        name: [
            Attempt(case, True, name != 'collocation, swing' or case > 0, 0.01 * (i + 1), 5, 1.01)
            for case in range(cases)
        ]
        for i, name in enumerate(SOLVERS)
    }
    problem = {
        'attempts': {name: [a.to_dict() for a in found] for name, found in attempts.items()},
        'known': {str(case): 1.0 for case in range(cases)},
        'build_s': 0.5,
        'variables': 256,
    }
    row = {
        'section': '3 robots', 'solver': 'tdm_planner', 'value': 7, 'variables': 27, 'cases': 4,
        'solved': 0.5, 'ms_median': 12.3, 'ratio_median': 1.05,
    }  # fmt: skip
    found = {
        'cases': cases,
        'versions': {'casadi': '1.2.3'},
        'problems': {
            'pendulum, strong torque': problem,
            'pendulum, weak torque': problem,
            '3 robots': problem,
        },
        'memory_mb': {'pendulum': {'none': 30.0, 'tdm_planner': 200.0, 'Drake': None}},
        'nodes': [row | {'solver': 'collocation', 'build_s': 0.4}],
        'parameters': [row],
        'teams': [row | {'section': 'robots', 'value': 3}],
    }
    read: dict[str, Any] = json.loads(json.dumps(found))
    return read


def cells(table: str, name: str) -> list[str]:
    line = next(line for line in table.splitlines() if line.startswith(f'| {name} |'))
    return [cell.strip() for cell in line.strip('|').split('|')]


def test_the_table_of_a_problem_states_every_solver():
    table = tables.comparison(figures()['problems']['3 robots'])
    for name in SOLVERS:
        assert cells(table, name)[1] == '4'
    swing = cells(table, 'collocation, swing')
    assert swing[2:5] == ['100 %', '75 %', '75 %']
    assert swing[-2] == '4'  # of the time of the first solver
    assert cells(table, 'collocation, warm')[-2] == '1.5'  # of that of its warm start


def test_what_was_not_measured_is_a_dash():
    assert cells(tables.memory(figures()['memory_mb']), 'pendulum')[-1] == '-'
    assert tables.ratio(None) == tables.number(float('nan')) == '-'


def a_record(found: dict[str, Any] | None, **changes: Any) -> dict[str, Any]:
    outcome = Outcome(settings={}, when='today', seconds=12.3, figures=found)
    versions = {'casadi': '1.2.3'}
    return {**outcome.to_dict(), 'machine': 'a machine', 'versions': versions, **changes}


def test_the_page_is_written_from_the_figures(tmp_path: Path):
    pytest.importorskip('casadi')
    records = {
        'peers': a_record(figures(), settings={'cases': 4}),
        'nodes': a_record(None, failure='it broke'),
        'closed_loop': a_record(None, failure='it hung', machine='another machine'),
    }
    page.write(records, tmp_path)
    text = (tmp_path / 'benchmarks.md').read_text()
    assert text.count('a machine, with casadi 1.2.3') == 1
    assert '`python -m benchmark peers`, today, 12 s.' in text
    assert '4 cases of each problem' in text
    assert '`python -m benchmark nodes`, today: **failed** - it broke' in text
    assert '`python -m benchmark latency`: not measured yet.' in text
    pictures = sorted(path.name for path in (tmp_path / 'images').iterdir())
    assert pictures == ['benchmark_growth.png', 'benchmark_success.png']
    assert all(f'images/{name}' in text for name in pictures)
    headings = [line for line in text.splitlines() if line.startswith('## ')]
    titles = [f'## {section.title}' for section in SECTIONS.values()]
    assert headings == ['## Aims and what was reached', *titles]


def test_flame_graphs_come_with_the_page_and_the_largest_costs_are_explained(tmp_path: Path):
    picture = tmp_path / 'images' / 'profile_pendulum_cold.png'
    picture.parent.mkdir()
    picture.write_bytes(b'a picture')
    costs = [
        ['search.run', 0.99],
        ['pendulum_rollout.steer', 0.3],
        ['switching_search.polish', 0.6],
    ]
    kind = {'ms': 1.0, 'costs': costs, 'picture': picture.name}
    page.write({'profile': a_record({'pendulum, cold': kind, 'again': kind})}, tmp_path)
    text = (tmp_path / 'benchmarks.md').read_text()
    assert '(images/profile_pendulum_cold.png)' in text
    polishing = explanations.EXPLANATIONS['switching_search.polish']
    assert f'`switching_search.polish`, 60%: {polishing}' in text
    assert text.count(polishing) == 1
    assert text.index('switching_search.polish`, 60%') < text.index('pendulum_rollout.steer`, 30%')


def test_what_is_explained_is_a_function_of_the_package():
    sources = {
        path.stem: path.read_text() for path in Path(tdm_planner.__file__).parent.rglob('*.py')
    }
    for label, reason in explanations.EXPLANATIONS.items():
        module, function = label.split('.')
        assert f'def {function}(' in sources[module], label
        assert reason


def test_records_are_kept_beside_the_page(tmp_path: Path):
    assert records_of_runs.read(tmp_path) == {}
    made = {'robots': a_record({'value': 1.23456789e-3, 'list': [float('nan')], 'count': 7})}
    records_of_runs.write(tmp_path, made)
    found = records_of_runs.read(tmp_path)['robots']
    assert found['figures']['value'] == 0.00123457
    assert found['figures']['count'] == 7
    assert math.isnan(found['figures']['list'][0])


def test_stacks_become_a_tree_below_the_function_asked_for():
    stacks = Counter({
        ('a.main', 'b.solve', 'c.inner'): 3,
        ('a.main', 'b.solve'): 1,
        ('a.main', 'd.other'): 5,
    })  # fmt: skip
    found = flame.below(stacks, 'b.solve')
    assert flame.tree(found, 'b.solve') == flame.Frame(
        'b.solve', 4, (flame.Frame('c.inner', 3, ()),)
    )
    assert flame.costs(found) == [('b.solve', 1.0), ('c.inner', 0.75)]


def test_the_sampler_sees_who_spends_the_time():
    def spin(seconds: float) -> None:
        until = time.process_time() + seconds
        while time.process_time() < until:
            pass

    with flame.Sampler() as sampler:
        spin(0.3)
    shares = dict(flame.costs(sampler.stacks))
    assert sum(sampler.stacks.values()) >= 10
    assert shares['test_benchmark_page.spin'] > 0.8


def test_a_flame_graph_is_drawn(tmp_path: Path):
    frame = flame.Frame('base.solve', 10, (flame.Frame('search.run', 9, ()),))
    flame.draw(frame, {'base', 'search'}, 'a title', tmp_path / 'flame.png')
    assert (tmp_path / 'flame.png').stat().st_size > 1000


def test_wins_and_losses_are_said_alike():
    found = figures()
    found['problems']['3 robots']['attempts']['collocation, swing'][1]['seconds'] = 1e-3
    text = tables.in_short(found)
    assert 'collocation, swing: 75 % at 1.010, 75 % within 1.02 (this package 100 %)' in text
    assert '4 times slower' in text
    assert tables.pace(0.25) == '4 times quicker'
    assert tables.pace(None) == 'not timed'


def test_peak_memory_is_that_of_the_process_alone():
    pytest.importorskip('casadi')
    from benchmark.peers.memory import high_water_mark

    block = b'x' * (64 << 20)
    assert len(block) >> 20 < high_water_mark() < 20_000
