# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The summary: the worst of several vehicles, figures as people write them."""

from dataclasses import replace
from html.parser import HTMLParser
import re

from page_missions import pendulum_mission, robots_mission
import pytest
from tdm_sim.report.comparison import Comparison, Entry
from tdm_sim.report.mission import Event, Severity
from tdm_sim.report.tables import events_table, number, parameters_table, summary_table
from tdm_sim.verdict import Verdict


class Rows(HTMLParser):
    """Texts of a table's rows, cell by cell, before any folded part."""

    def __init__(self, page):
        super().__init__()
        self.rows = []
        self.classes = []
        self.feed(page.partition('<details>')[0])

    def handle_starttag(self, tag, attrs):
        if tag == 'tr':
            self.rows.append([])
        if tag in ('td', 'th'):
            self.rows[-1].append('')
            self.classes.append(dict(attrs).get('class'))

    def handle_data(self, data):
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (None, ''),
        (0.0, '0'),
        (-1e-15, '0'),
        (1.49207, '1.492'),
        (-0.05, '\N{MINUS SIGN}0.05'),
        (1.36314e-6, '1.36&thinsp;&middot;&thinsp;10<sup>\N{MINUS SIGN}6</sup>'),
        (22.0348, '22.03'),
    ],
)
def test_numbers(value, text):
    assert number(value) == text


def test_the_worst_of_all_robots():
    entries = (
        Entry('margin', 'margin of thrust', 'N', 0.2, 0.1, 1.0, 2.0, vehicle='a'),
        Entry('margin', 'margin of thrust', 'N', 0.1, 0.3, 3.0, 4.0, vehicle='b'),
        Entry('landing', 'error of yaw at the planned end', 'rad', 0.0, -0.2, vehicle='a'),
        Entry('landing', 'error of yaw at the planned end', 'rad', 0.0, 0.1, vehicle='b'),
    )
    rows = Rows(summary_table(robots_mission(), Comparison(entries))).rows
    assert ['thrust [N]a', '0.1 at 3.00 s', '0.1 at 2.00 s'] in rows
    assert ['error of yaw [rad]a', '0', '\N{MINUS SIGN}0.2'] in rows


def test_a_violation_stands_out():
    entries = (Entry('margin', 'margin of torque', 'N m', 0.1, -0.02, 1.0, 1.5),)
    table = summary_table(pendulum_mission(), Comparison(entries))
    assert '<td class="bad">\N{MINUS SIGN}0.02' in table
    assert table.count('class="bad"') == 1


def test_figures_are_said_to_mean():
    mission = pendulum_mission()
    entries = (
        Entry('duration', 'time to the goal', 's', 1.9, 2.0),
        Entry('margin', 'margin of torque', 'N m', 0.1, 0.0, 1.0, 1.5, mark='saturated'),
        Entry('planner', 'requests without a plan', '', None, 0.0),
    )
    table = summary_table(mission, Comparison(entries, verdict=Verdict((), ())))
    assert 'theta stays within 0.05 rad of upright, planned and measured alike' in table
    assert 'Requests count from the first plan on' in table
    assert 'At the latest 3 s after the planned end' in table
    assert ['torque [N m]', '0.1 at 1.00 s', '0 at 1.50 s saturated'] in Rows(table).rows
    assert 'State at the planned end' not in table  # there is no figure of it


def test_what_came_before_the_motion_is_dimmed():
    events = (
        Event(-1.0, Severity.ERROR, '/p/tracker', 'idle'),
        Event(1.0, Severity.WARN, '/p/tracker', 'late'),
    )
    table = events_table(replace(pendulum_mission(), events=events))
    assert re.findall('<tr class="(.*?)"', table) == ['ERROR early', 'WARN']


def test_the_verdict_is_said_first():
    reached = summary_table(pendulum_mission(), Comparison((), verdict=Verdict((), ())))
    assert reached.startswith('<p class="verdict good">Goal reached and held')
    missed = summary_table(pendulum_mission(), Comparison((), verdict=Verdict(('fell <b>',), ())))
    assert 'Goal missed' in missed
    assert 'fell &lt;b&gt;' in missed
    early = Comparison((), verdict=Verdict((), (), 'the recording ends at 5.2 s'))
    undecided = summary_table(pendulum_mission(), early)
    assert undecided.startswith('<p class="verdict">Not known: the recording ends at 5.2 s</p>')


def test_a_plan_alone_has_no_column_for_what_was_achieved():
    mission = pendulum_mission(measured=False)
    entries = (
        Entry('duration', 'time to the goal', 's', 2.0),
        Entry('planner', 'time to solve', 's', 0.5, 0.125),
    )
    rows = Rows(summary_table(mission, Comparison(entries))).rows
    assert rows[0] == ['', 'planned']
    assert ['time to the goal [s]', '2'] in rows
    assert ['time to solve [s]', '0.125'] in rows


def test_parameters_are_escaped_and_sorted():
    table = parameters_table({'b': [1.0, 2], 'a<': None, 'c': True})
    assert table.index('a&lt;') < table.index('<code>b') < table.index('<code>c')
    assert '>1, 2<' in table
    assert '>unset<' in table
