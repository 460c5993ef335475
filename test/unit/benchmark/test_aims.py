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
LATE = {'replans': 10_002, 'late': 0, 'late_by_processor_time': 0, 'worst_late_ms': 1.0}
MEMORY = {'memory_after_100_mb': 200.0, 'memory_mb': 201.0}


def attempts(seconds: float, solved: int = 100) -> list[dict[str, Any]]:
    return [Attempt(k, True, k < solved, seconds, 5, 1.0).to_dict() for k in range(100)]


def problem(theirs: float, solved: int) -> dict[str, Any]:
    """Peers that take `theirs` s where this package takes one."""
    found = {'tdm_planner': attempts(1.0), 'tdm_planner, warm': attempts(1.0)}
    for name in ('straight line', 'best of 3 guesses', 'warm'):
        found[f'collocation, {name}'] = attempts(theirs, solved)
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
        'overruns': LATE | MEMORY,
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
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """Return the figures with another value of one of them."""
    figures: dict[str, Any] = json.loads(json.dumps(GOOD))
    *parents, key = path.split('/')
    place = figures
    for parent in parents:
        place = place[parent]
    assert key in place
    place[key] = value
    return figures


def missed(figures: dict[str, Any]) -> list[int]:
    """Return the numbers of the aims that the figures do not meet."""
    return [number for number, aim in enumerate(aims.AIMS) if aim.row(figures)[-1] != 'yes']


def test_figures_that_meet_every_aim_and_none() -> None:
    assert missed(GOOD) == []
    assert aims.table(GOOD).count('\n') == len(aims.AIMS) + 1
    assert {tuple(aim.row({})[1:]) for aim in aims.AIMS} == {(aims.NOT_MEASURED, '-')}


def test_every_figure_that_falls_short_is_seen() -> None:
    found = []
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
        found += missed(changed(path, value))
    assert len(found) == len(set(found)) == 20


def test_too_few_runs_and_as_often_as_the_peers_do_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for title in ('pendulum, strong torque', '3 robots'):
        (short,) = missed(changed(f'peers/problems/{title}', problem(100.0, 100)))
        assert aims.AIMS[short].section == 'peers'
    assert len(missed(changed('latency/overruns/replans', 120))) == 2
    # a large cost that nobody explains
    monkeypatch.setattr(aims.explanations, 'EXPLANATIONS', {'formation_search.minima': ''})
    assert missed(GOOD) == [len(aims.AIMS) - 1]
