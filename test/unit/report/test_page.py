# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report's page as a file: complete, small, and nothing from a recording is markup."""

import base64
import hashlib
from html.parser import HTMLParser
import json
import re

import numpy as np
from page_missions import pendulum_mission, robots_mission
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_sim.report.embedding import json_for_html, packed, unpacked
from tdm_sim.report.mission import Event, Mission, Severity
from tdm_sim.report.page import motion_span, playing_speed, report_page, write_report

LARGEST = 8_000_000


class Parts(HTMLParser):
    """Scripts, texts and addresses of a page."""

    def __init__(self, page):
        super().__init__()
        self.scripts, self.addresses, self.text = [], [], []
        self._script = None
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.addresses += [v for k, v in attributes.items() if k in ('src', 'href')]
        if tag == 'script':
            self._script = len(self.scripts)
            self.scripts.append((attributes, ''))

    def handle_endtag(self, tag):
        if tag == 'script':
            self._script = None

    def handle_data(self, data):
        if self._script is None:
            self.text.append(data)
        else:
            attributes, text = self.scripts[self._script]
            self.scripts[self._script] = attributes, text + data


def embedded(page):
    (data,) = [s for a, s in Parts(page).scripts if a.get('id') == 'report-data']
    return json.loads(data)


@pytest.mark.parametrize('make', [pendulum_mission, robots_mission])
@pytest.mark.parametrize('measured', [True, False])
def test_self_contained(make, measured):
    page = report_page(make(measured=measured))
    parts = Parts(page)
    assert parts.addresses == ['data:,']
    assert not re.search(r'url\(\s*["\']?https?:', page)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1)
    assert policy.startswith("default-src 'none'")
    scripts = [s for a, s in parts.scripts if 'type' not in a]
    assert len(scripts) == 2
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


def test_size_stays_below_the_limit_however_much_was_recorded(tmp_path):
    names = [f'robot{k}' for k in range(16)]
    mission = robots_mission(names=names, rate=200.0, after=58.0)
    size = write_report(mission, tmp_path / 'report.html')
    assert size == (tmp_path / 'report.html').stat().st_size < LARGEST


def test_peaks_survive_thinning():
    mission = robots_mission(names=['one'], rate=200.0, after=120.0)
    states = mission.vehicles[0].states
    states.values[12_345, 0] = 3.9
    data = embedded(report_page(mission))
    (chart,) = [c for c in data['charts'] if c['key'] == 'states']
    measured = next(t for t in chart['data'] if t['meta']['kind'] == 'measured')
    y = unpacked(measured['y'])
    assert y.max() == np.float32(3.9)
    assert y.size < 4000


def test_the_time_shown_first_is_the_motions():
    start, end = motion_span(pendulum_mission())
    assert -0.5 <= start <= 0.0
    assert 2.0 < end <= 4.0
    assert playing_speed(pendulum_mission()) < 1.0


@pytest.mark.parametrize(
    'mission', [Mission('t', '', ()), Mission('t', 'other', (), missing=('x',))]
)
def test_a_mission_of_nothing_is_still_a_page(mission):
    assert '<h1>t</h1>' in report_page(mission)


def test_events_beyond_a_page_are_counted():
    events = tuple(Event(0.1 * k, Severity.OK, 'n', f'event {k}') for k in range(1000))
    page = report_page(pendulum_mission(events=events))
    assert 'event 299<' in page
    assert 'event 300<' not in page
    assert 'and 700 more' in page


def test_a_file_that_cannot_be_written(tmp_path):
    with pytest.raises(InvalidProblem, match='cannot be written'):
        write_report(Mission('t', '', ()), tmp_path)


@pytest.mark.parametrize('text', ['</script>', '<!--', ']]>', '&lt;', '\u2028', '"\\'])
def test_json_can_stand_in_html(text):
    written = json_for_html({text: [text]})
    assert json.loads(written) == {text: [text]}
    assert not set('<>&\u2028') & set(written)


def test_json_refuses_what_it_cannot_hold():
    with pytest.raises(ValueError, match='JSON'):
        json_for_html({'x': float('nan')})


def test_numbers_are_packed_in_single_precision_with_gaps():
    values = [0.0, -1.5, np.nan, 1e-20, 3.14159265]
    assert unpacked(packed(values)) == pytest.approx(np.float32(values), nan_ok=True)
