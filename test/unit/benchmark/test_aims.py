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

from benchmark import aims, page
from benchmark import figures as records_of_runs

MEASURED = {name: record['figures'] for name, record in records_of_runs.read(page.DOCS).items()}


def met(path: str = '', value: Any = None) -> list[str]:
    """Return the verdicts on the figures of the page, with another value of one of them."""
    figures: dict[str, Any] = json.loads(json.dumps(MEASURED))
    if path:
        *parents, key = path.split('/')
        place = figures
        for parent in parents:
            place = place[parent]
        assert key in place
        place[key] = value
    return [aim.row(figures)[-1] for aim in aims.AIMS]


def test_what_was_not_measured_is_not_met() -> None:
    assert {tuple(aim.row({})[1:]) for aim in aims.AIMS} == {(aims.NOT_MEASURED, '-')}


def test_every_figure_that_falls_short_is_seen() -> None:
    for path, enough, short in (
        ('replanning/pendulum/model errors and noise/at_once', 36, 35),
        ('replanning/pendulum/model errors and noise/held', 40, 39),
        ('replanning/pendulum/and a push half-way/at_once', 36, 35),
        ('replanning/pendulum/and a push half-way/held', 40, 39),
        ('replanning/robots/quick robots, one is pushed/arrived', 40, 39),
        ('replanning/robots/quick robots, one is pushed/separated', 40, 39),
        ('replanning/robots/quick robots, the goal moves/arrived', 40, 39),
        ('replanning/robots/quick robots, the goal moves/separated', 40, 39),
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
        good, bad = met(path, enough), met(path, short)
        (number,) = [k for k, pair in enumerate(zip(good, bad, strict=True)) if len({*pair}) == 2]
        assert (good[number], bad[number]) == ('yes', '**no**')
