# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every aim has its row, judged by what was measured and by nothing else."""

from __future__ import annotations

import json
from typing import Any

from benchmark import aims
from benchmark.peers.attempts import Attempt
import pytest

ROBOTS = {'runs': 40, 'arrived': 40, 'separated': 40, 'separation_least': 0.41}
PENDULUM = {'runs': 40, 'at_once': 36, 'held': 40}
QUICK = {'p50_ms': 1.0, 'p99_ms': 2.0}


def attempts(seconds: float, cost: float, solved: int = 100) -> list[dict[str, Any]]:
    return [Attempt(k, True, k < solved, seconds, 5, cost).to_dict() for k in range(100)]


def problem(theirs: float, solved: int) -> dict[str, Any]:
    """Peers that take `theirs` s where this package takes one."""
    found = {'tdm_planner': attempts(1.0, 1.0), 'tdm_planner, warm': attempts(1.0, 1.0)}
    for name in ('straight line', 'best of 3 guesses', 'warm'):
        found[f'collocation, {name}'] = attempts(theirs, 1.0, solved)
    return {'attempts': found, 'known': {str(case): 1.0 for case in range(100)}}


GOOD: dict[str, Any] = {
    'replanning': {
        'pendulum': {'model errors and noise': PENDULUM, 'and a push half-way': PENDULUM},
        'robots': {'quick robots, one is pushed': ROBOTS, 'quick robots, the goal moves': ROBOTS},
    },
    'latency': {
        'latency': {
            f'{kind}, {how}': QUICK
            for kind in ('pendulum strong', 'pendulum weak', 'three robots')
            for how in ('warm', 'cold')
        },
        'overruns': {
            'replans': 10_002, 'late': 0, 'late_by_processor_time': 0, 'worst_late_ms': 1.0,
            'memory_after_100_mb': 200.0, 'memory_mb': 201.0,
        },
        'stream': {'p99_ms': 1.0, 'worst_ms': 2.0, 'plans': 50},
    },
    'peers': {
        'problems': {
            'pendulum, strong torque': problem(11.0, 50),
            'pendulum, weak torque': problem(11.0, 50),
            '3 robots': problem(51.0, 99),
        }
    },
    'profile': {'robots, cold': {'ms': 1.0, 'costs': [['formation_search.minima', 0.6]]}},
}  # fmt: skip


def another() -> dict[str, Any]:
    """Return the figures, no part of them shared, as a file holds them."""
    found: dict[str, Any] = json.loads(json.dumps(GOOD))
    return found


def verdicts(figures: dict[str, Any]) -> list[str]:
    return [aim.row(figures)[-1] for aim in aims.AIMS]


def test_figures_that_meet_every_aim():
    assert set(verdicts(GOOD)) == {'yes'}
    assert aims.table(GOOD).count('\n') == len(aims.AIMS) + 1


def test_what_was_not_measured_is_not_met():
    assert set(verdicts({})) == {'-'}
    assert all(aim.row({})[1] == aims.NOT_MEASURED for aim in aims.AIMS)


def test_every_figure_that_falls_short_is_seen():
    missed = set()
    for path, value in (
        ('replanning/pendulum/model errors and noise/at_once', 35),
        ('replanning/pendulum/model errors and noise/held', 39),
        ('replanning/pendulum/and a push half-way/at_once', 35),
        ('replanning/pendulum/and a push half-way/held', 39),
        ('replanning/robots/quick robots, one is pushed/arrived', 39),
        ('replanning/robots/quick robots, one is pushed/separated', 39),
        ('replanning/robots/quick robots, the goal moves/arrived', 39),
        ('replanning/robots/quick robots, the goal moves/separated', 39),
        ('latency/latency/pendulum weak, warm/p50_ms', 11.0),
        ('latency/latency/pendulum strong, cold/p50_ms', 101.0),
        ('latency/latency/pendulum strong, warm/p99_ms', 301.0),
        ('latency/latency/pendulum weak, cold/p99_ms', 301.0),
        ('latency/latency/three robots, warm/p50_ms', 16.0),
        ('latency/latency/three robots, warm/p99_ms', 61.0),
        ('latency/overruns/late', 1),
        ('latency/stream/p99_ms', 5.1),
        ('latency/overruns/memory_mb', 211.0),
        ('peers/problems/pendulum, strong torque', problem(9.0, 50)),
        ('peers/problems/pendulum, weak torque', problem(9.0, 50)),
        ('peers/problems/3 robots', problem(49.0, 99)),
    ):
        figures = another()
        *parents, key = path.split('/')
        place = figures
        for parent in parents:
            place = place[parent]
        place[key] = value
        found = [number for number, verdict in enumerate(verdicts(figures)) if verdict != 'yes']
        assert len(found) == 1, path
        missed.update(found)
    assert len(missed) == 20


@pytest.mark.parametrize('title', ['pendulum, strong torque', '3 robots'])
def test_as_often_as_the_peers_is_not_oftener(title: str):
    figures = another()
    figures['peers']['problems'][title] = problem(100.0, 100)
    rows = [aim.row(figures) for aim in aims.AIMS]
    short = [row for row in rows if row[-1] != 'yes']
    assert len(short) == 1
    assert 'as often' in short[0][1]


def test_fewer_replans_than_aimed_at_do_not_count():
    figures = another()
    figures['latency']['overruns']['replans'] = 120
    assert verdicts(figures).count('**no**') == 2


def test_a_large_cost_that_nobody_explains_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(aims.explanations, 'EXPLANATIONS', {'formation_search.minima': ''})
    row = aims.AIMS[-1].row(GOOD)
    assert row[1:] == ['not explained: formation_search.minima', '**no**']
