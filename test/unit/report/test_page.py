# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report's page: complete, small, figures as people write them, and nothing is markup."""

from __future__ import annotations

import base64
from dataclasses import replace
import hashlib
import json
from pathlib import Path
import re
from typing import Any

from missions import Parts, pendulum_mission, robots_mission, unpacked
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_sim.report.comparison import Comparison, Entry
from tdm_sim.report.mission import Event, Mission, Severity
from tdm_sim.report.page import motion_span, playing_speed, report_page, write_report
from tdm_sim.report.tables import events_table, number, summary_table

LARGEST = 8_000_000
MINUS = '\N{MINUS SIGN}'


def rows(table: str) -> list[list[str]]:
    return Parts(table.partition('<details>')[0]).rows


@pytest.mark.parametrize('make', [pendulum_mission, robots_mission])
@pytest.mark.parametrize('measured', [True, False])
def test_self_contained(make: Any, measured: bool) -> None:
    page = report_page(make(measured=measured))
    parts = Parts(page)
    addresses = [a[key] for _, a in parts.elements for key in ('src', 'href') if key in a]
    assert addresses == ['data:,']
    assert not re.search(r'url\(\s*["\']?https?:', page)
    policy = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)[0]
    assert policy.startswith("default-src 'none'")
    scripts = [script for attributes, script in parts.scripts if 'type' not in attributes]
    assert len(scripts) == 2
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


def test_size_stays_below_the_limit_and_peaks_survive_thinning(tmp_path: Path) -> None:
    names = [f'robot{k}' for k in range(16)]
    mission = robots_mission(names=names, rate=200.0, after=58.0)
    states = mission.vehicles[0].states
    assert states is not None
    states.values[1_234, 0] = 3.9
    file = tmp_path / 'report.html'
    assert write_report(mission, file) == file.stat().st_size < LARGEST
    (data,) = [s for a, s in Parts(file.read_text()).scripts if a.get('id') == 'report-data']
    (chart,) = [chart for chart in json.loads(data)['charts'] if chart['key'] == 'states']
    measured = next(t for t in chart['data'] if t['meta']['kind'] == 'measured')
    y = unpacked(measured['y'])
    assert y.max() == np.float32(3.9)
    assert y.size < 4000
    with pytest.raises(InvalidProblem, match='cannot be written'):
        write_report(mission, tmp_path)


def test_the_time_shown_first_is_the_motions() -> None:
    start, end = motion_span(pendulum_mission())
    assert -0.5 <= start <= 0.0
    assert 2.0 < end <= 4.0
    assert playing_speed(pendulum_mission()) < 1.0
    for mission in (Mission('t', '', ()), Mission('t', 'other', (), missing=('x',))):
        assert '<h1>t</h1>' in report_page(mission)


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (None, ''),
        (0.0, '0'),
        (-1e-15, '0'),
        (1.49207, '1.492'),
        (-0.05, f'{MINUS}0.05'),
        (1.36314e-6, f'1.36&thinsp;&middot;&thinsp;10<sup>{MINUS}6</sup>'),
        (22.0348, '22.03'),
    ],
)
def test_numbers(value: float | None, text: str) -> None:
    assert number(value) == text


def test_the_worst_of_all_robots_violations_and_saturation_stand_out() -> None:
    entries = (
        Entry('margin', 'margin of thrust', 'N', 0.2, 0.1, 1.0, 2.0, vehicle='a'),
        Entry('margin', 'margin of thrust', 'N', 0.1, 0.3, 3.0, 4.0, vehicle='b'),
        Entry('landing', 'error of yaw at the planned end', 'rad', 0.0, -0.2, vehicle='a'),
        Entry('landing', 'error of yaw at the planned end', 'rad', 0.0, 0.1, vehicle='b'),
        Entry('margin', 'margin of torque', 'N m', 0.1, -0.02, 1.0, 1.5),
        Entry('margin', 'margin of walls', 'm', 0.1, 0.0, 1.0, 1.5, mark='saturated'),
    )
    table = summary_table(robots_mission(), Comparison(entries)).partition('<details>')[0]
    assert ['thrust [N]a', '0.1 at 3.00 s', '0.1 at 2.00 s'] in rows(table)
    assert ['error of yaw [rad]a', '0', f'{MINUS}0.2'] in rows(table)
    assert ['walls [m]', '0.1 at 1.00 s', '0 at 1.50 s saturated'] in rows(table)
    assert re.findall('<td class="bad">([^ ]*)', table) == [f'{MINUS}0.02']


def test_events_are_dimmed_before_the_motion_and_counted_beyond_a_page() -> None:
    events = (
        Event(-1.0, Severity.ERROR, '/p/tracker', 'idle'),
        Event(1.0, Severity.WARN, '/p/tracker', 'late'),
    )
    table = events_table(replace(pendulum_mission(), events=events))
    assert re.findall('<tr class="(.*?)"', table) == ['ERROR early', 'WARN']
    many = tuple(Event(0.1 * k, Severity.OK, 'n', f'event {k}') for k in range(1000))
    table = events_table(pendulum_mission(events=many))
    assert 'event 299<' in table
    assert 'event 300<' not in table
    assert 'and 700 more' in table
