# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report in a real browser, headless."""

from __future__ import annotations

from importlib.util import find_spec
import json
import math
import re
import time

import numpy as np
from page_missions import ARENA_PARAMETERS, pendulum_mission, pendulum_states, robots_mission
import pytest

if find_spec('selenium') is None:
    pytest.skip('browsers are driven by selenium', allow_module_level=True)

from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from tdm_sim.report.mission import Event, Mission, PlanFigures, Severity
from tdm_sim.report.page import write_report
from tools.browser import chromium, open_browser, open_report, PATIENCE

if chromium() is None:
    pytest.skip(
        'no headless Chromium: apt-get install chromium chromium-driver', allow_module_level=True
    )

DESKTOP, PHONE = (1280, 800), (390, 844)


class Page:
    """A report that is open in the browser."""

    def __init__(self, driver):
        self.driver = driver

    def open(self, path, size=DESKTOP, scheme='light'):  # noqa: A003
        self.logs()
        open_report(self.driver, path, size, scheme)
        return self

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def wait(self, script, *arguments):
        end = time.monotonic() + PATIENCE
        while not (found := self.run(script, *arguments)):
            assert time.monotonic() < end, f'not within {PATIENCE:g} s: {script}'
            time.sleep(0.05)
        return found

    def find(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def click(self, element):
        """Click, clear of the bar at the foot of the page."""
        self.run('arguments[0].scrollIntoView({block: "center"})', element)
        element.click()

    def logs(self):
        """Console messages, and addresses requested, since the last call."""
        console = [
            entry['message']
            for entry in self.driver.get_log('browser')
            if entry['level'] in ('SEVERE', 'WARNING')
        ]
        events = [json.loads(e['message'])['message'] for e in self.driver.get_log('performance')]
        sent = [e for e in events if e['method'] == 'Network.requestWillBeSent']
        return console, [e['params']['request']['url'] for e in sent]

    def set_time(self, t):
        self.run('report.clock.set(arguments[0])', t)

    def time(self):
        return self.run('return report.clock.t')

    def ranges(self):
        return self.run(
            'return [...document.querySelectorAll(".chart")].map(c => c.layout.xaxis.range)'
        )

    def visible(self, kind):
        """For every curve of a kind, whether it is shown."""
        return self.run(
            'return [...document.querySelectorAll(".chart")].flatMap(c => c.data)'
            '.filter(t => t.meta.kind === arguments[0]).map(t => t.visible !== false)',
            kind,
        )

    def line(self, selector):
        names = ('x1', 'y1', 'x2', 'y2')
        return np.array([float(self.find(selector).get_attribute(name)) for name in names])


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp('chromium')) as driver:
        yield Page(driver)


@pytest.fixture(scope='module')
def reports(tmp_path_factory):
    folder = tmp_path_factory.mktemp('reports')
    missions = {
        'pendulum': pendulum_mission(),
        'pendulum_plan': pendulum_mission(measured=False),
        'robots': robots_mission(),
        'robots_plan': robots_mission(measured=False),
        'nothing': Mission('Nothing known', '', ()),
    }
    for name, mission in missions.items():
        write_report(mission, folder / f'{name}.html')
    return {name: folder / f'{name}.html' for name in missions}


NAMES = ('pendulum', 'pendulum_plan', 'robots', 'robots_plan', 'nothing')


@pytest.mark.parametrize('name', NAMES)
def test_no_complaint_and_nothing_from_the_network(page, reports, name):
    page.open(reports[name])
    page.run('report.clock.set(1)')
    console, addresses = page.logs()
    assert console == []
    assert addresses
    assert [a for a in addresses if not a.startswith(('file:', 'data:'))] == []


@pytest.mark.parametrize(
    ('name', 'size', 'scheme'),
    [
        ('pendulum', DESKTOP, 'light'),
        ('pendulum', PHONE, 'dark'),
        ('robots', DESKTOP, 'dark'),
        ('robots', PHONE, 'light'),
    ],
)
def test_readable(page, reports, name, size, scheme):
    page.open(reports[name], size, scheme)
    width, _ = size
    assert page.run('return document.documentElement.scrollWidth') <= width
    assert page.run('return window.innerWidth') == width
    texts = page.run("""
        const found = [];
        for (const e of document.querySelectorAll('body *')) {
          const own = [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
          const box = e.getBoundingClientRect();
          if (!own || !box.width || /^(SCRIPT|STYLE|OPTION)$/.test(e.tagName)) continue;
          if (!e.checkVisibility({visibilityProperty: true, opacityProperty: true})) continue;
          found.push([e.textContent.trim().slice(0, 40), parseFloat(getComputedStyle(e).fontSize),
            box.left, box.right]);
        }
        return found;""")
    assert len(texts) > 60
    assert [t for t in texts if t[1] < 11] == []
    assert [t for t in texts if t[2] < -0.5 or t[3] > width + 0.5] == []
    for selector in ('h1', '#summary', '#scene svg', '.chart .main-svg', '#play', '#time'):
        box = page.find(selector).rect
        assert box['width'] > 10, selector
        assert box['height'] > 10, selector
    colours = page.run("""
        return ['body', '.subtitle', '.card'].map(s => {
          const style = getComputedStyle(document.querySelector(s));
          return s === '.card' ? style.backgroundColor : style.color; })""")
    text, soft, back = ([int(v) for v in re.findall(r'\d+', c)[:3]] for c in colours)
    assert contrast(text, back) > 7
    assert contrast(soft, back) > 4.5
    # titles and values of a panel stand in one line: they must not meet
    meeting = page.run("""
        const titles = [...document.querySelectorAll('.chart .annotation-text')];
        const boxes = [...document.querySelectorAll('.reading span')].map(e =>
          [e.textContent, e.getBoundingClientRect()]);
        return titles.flatMap(t => { const a = t.getBoundingClientRect();
          return boxes.filter(([, b]) => a.left < b.right && b.left < a.right
            && a.top < b.bottom && b.top < a.bottom).map(([text]) => [t.textContent, text]); });
        """)
    assert meeting == []


def contrast(one, other):
    def luminance(colour):
        share = np.array(colour) / 255
        linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize('name', ['pendulum', 'robots_plan'])
def test_the_slider_moves_the_animation(page, reports, name):
    page.open(reports[name])
    moving = '#pendulum-side .tip' if name.startswith('pendulum') else '#arena .body'
    attributes = '["cx", "cy", "transform"].map(n => e.getAttribute(n)).join()'
    script = f'const e = document.querySelector("{moving}"); return {attributes}'
    seen = {page.run(script)}
    slider = page.find('#time')
    for _ in range(4):
        slider.send_keys(Keys.PAGE_UP)
        seen.add(page.run(script))
    assert len(seen) == 5
    assert page.time() == pytest.approx(float(slider.get_attribute('value')), abs=1e-6)
    assert page.find('#instant').text == f'{page.time():.2f} s'


def pendulum_points(theta, psi, arm, rod):
    """Pivot and tip by rotations: the rod about the arm, the arm about the vertical."""
    about_z = np.array(
        [[math.cos(psi), -math.sin(psi), 0], [math.sin(psi), math.cos(psi), 0], [0, 0, 1]]
    )
    # theta turns the rod towards the tangent, y of the arm's frame: about -x
    about_x = np.array(
        [[1, 0, 0], [0, math.cos(theta), math.sin(theta)], [0, -math.sin(theta), math.cos(theta)]]
    )
    pivot = about_z @ [arm, 0, 0]
    return pivot, pivot + about_z @ about_x @ [0, 0, rod]


def test_the_pendulum_stands_where_the_markers_put_it(page, reports):
    page.open(reports['pendulum'])
    views = {'side': lambda p: (p[1], -p[2]), 'top': lambda p: (p[1], p[0])}
    for t in (0.0, 0.37, 1.1, 2.0):
        page.set_time(t)
        theta, psi = pendulum_states(t)[:2]
        pivot, tip = pendulum_points(theta, psi, 0.1, 0.12)
        for view, project in views.items():
            svg = page.find(f'#pendulum-{view}')
            scale = float(svg.get_attribute('data-scale'))
            middle = float(svg.get_attribute('width')) / 2
            drawn = page.line(f'#pendulum-{view} .rig.planned .rod')
            expected = middle + scale * np.array([*project(pivot), *project(tip)])
            assert drawn == pytest.approx(expected, abs=0.05), (t, view)


def test_the_robot_heads_and_blows_where_it_should(page, reports):
    page.open(reports['robots'])
    t = 1.5
    page.set_time(t)
    scale = float(page.find('#arena').get_attribute('data-scale'))
    centres = []
    for number in range(2):
        points = page.run(
            """
            const robot = `.robot.measured[data-robot="${arguments[0]}"]`;
            const body = document.querySelector(`${robot} .body`);
            const to = body.getCTM();
            const at = (x, y) => { const p = new DOMPoint(x, y).matrixTransform(to);
              return [p.x, -p.y]; };
            const heading = body.querySelector('.heading');
            const plume = [...body.querySelector('.plume').points];
            const far = (p) => Math.hypot(p.x, p.y);
            const tip = plume.reduce((a, b) => (far(a) > far(b) ? a : b));
            return [at(0, 0), at(heading.x2.baseVal.value, heading.y2.baseVal.value),
              at(tip.x, tip.y)];""",
            number,
        )
        centre, front, jet = map(np.array, points)
        yaw, alpha = 0.3 * t, 0.5 + number
        assert np.arctan2(*(front - centre)[::-1]) == pytest.approx(yaw, abs=0.01)
        force = centre - jet  # the jet leaves against the force
        assert np.arctan2(*force[::-1]) == pytest.approx(yaw + alpha, abs=0.01)
        centres.append(centre)
    assert (centres[1] - centres[0]) / scale == pytest.approx([0.0, 1.0], abs=0.01)


def test_the_plume_grows_with_the_thrust_and_ends_with_it(page, reports):
    page.open(reports['robots_plan'])
    plume = '.robot.planned[data-robot="0"] .plume'
    page.set_time(1.0)
    assert page.find(plume).get_attribute('points')
    page.run('document.querySelector("[data-part=all]").click(); report.clock.set(2)')
    page.set_time(2.0)
    assert page.find(plume).get_attribute('points')  # still on at the last instant


def test_walls_zones_goals_and_safety_circles_are_drawn(page, reports):
    page.open(reports['robots'])
    scale = float(page.find('#arena').get_attribute('data-scale'))
    wall = page.find('#arena .wall')
    size = [float(wall.get_attribute(name)) / scale for name in ('width', 'height')]
    assert size == pytest.approx([4.0, 3.0], rel=1e-3)
    zone = page.find('#arena .obstacle')
    assert float(zone.get_attribute('r')) / scale == pytest.approx(0.25)
    circle = page.find('#arena .robot.measured .separation')
    assert float(circle.get_attribute('r')) / scale == pytest.approx(
        ARENA_PARAMETERS['arena.minimum_separation'] / 2
    )
    assert len(page.driver.find_elements(By.CSS_SELECTOR, '#arena g.goal')) == 2
    assert len(page.driver.find_elements(By.CSS_SELECTOR, '#arena .path')) == 2


def test_play_and_pause(page, reports):
    page.open(reports['pendulum'])
    play = page.find('#play')
    page.set_time(0.0)
    play.click()
    assert play.get_attribute('aria-label') == 'Pause'
    page.wait('return report.clock.t > 0.05')
    play.click()
    assert play.get_attribute('aria-label') == 'Play'
    stopped = page.time()
    time.sleep(0.2)
    assert page.time() == stopped
    page.run('document.getElementById("speed").value = "10";'
             'document.getElementById("speed").dispatchEvent(new Event("change"))')  # fmt: skip
    play.click()
    page.wait('return !report.clock.playing')  # it ends by itself, at the end
    assert page.time() == pytest.approx(page.run('return report.clock.end'))


def test_the_legend_switches_curves_in_all_charts(page, reports):
    page.open(reports['pendulum'])
    assert set(page.visible('commanded')) == {False}
    shown = page.visible('measured')
    assert len(shown) == 4 + 1 + 2  # states, control, margins
    assert all(shown)
    lines = 'return document.querySelectorAll("#chart-controls .scatterlayer .trace").length'
    before = page.run(lines)
    button = page.find('#chart-states').find_element(
        By.XPATH, 'preceding-sibling::ul//button[normalize-space()="measured"]'
    )
    page.click(button)
    page.wait(f'{lines} === {before - 1}')
    assert not any(page.visible('measured'))
    assert button.get_attribute('aria-pressed') == 'false'
    page.click(button)
    page.wait(f'{lines} === {before}')
    assert all(page.visible('measured'))


def test_the_legend_switches_one_robot(page, reports):
    page.open(reports['robots'])
    button = page.find('#chart-states').find_element(
        By.XPATH, 'preceding-sibling::ul//button[normalize-space()="robot2"]'
    )
    page.click(button)
    seen = page.run(
        'return [...document.querySelectorAll("#chart-states, #chart-controls")]'
        '.flatMap(c => c.data).filter(t => t.meta.kind === "planned")'
        '.map(t => [t.meta.series, t.visible])'
    )
    assert {tuple(item) for item in seen} == {('robot1', True), ('robot2', False)}


def test_zoom_is_linked(page, reports):
    page.open(reports['pendulum'])
    before = page.ranges()
    assert len({tuple(r) for r in before}) == 1
    drag = page.find('#chart-states .nsewdrag')
    page.run('arguments[0].scrollIntoView({block: "center"})', drag)
    ActionChains(page.driver, duration=50).move_to_element_with_offset(
        drag, -60, 0
    ).click_and_hold().move_by_offset(60, 2).move_by_offset(40, 0).release().perform()
    page.wait(
        'return [...document.querySelectorAll(".chart")].every('
        'c => Math.abs(c.layout.xaxis.range[0] - arguments[0]) > 0.05)',
        before[0][0],
    )
    after = page.ranges()
    assert len({tuple(np.round(r, 6)) for r in after}) == 1
    assert before[0][0] < after[0][0] < after[0][1] < before[0][1]
    page.find('[data-part=all]').click()
    page.wait(
        'return [...document.querySelectorAll(".chart")].every('
        'c => c.layout.xaxis.range[0] === -1)'
    )
    assert page.run('return report.clock.start') == -1


def test_the_cursor_is_linked(page, reports):
    page.open(reports['pendulum'])
    chart = page.find('#chart-controls')
    page.run('arguments[0].scrollIntoView({block: "center"})', chart)
    ActionChains(page.driver, duration=20).move_to_element_with_offset(chart, 40, 0).perform()
    first = page.wait('return report.clock.t')
    low, high = page.ranges()[0]
    assert low < first < high
    lefts = page.run(
        'return [...document.querySelectorAll("#chart-states .cursor")]'
        '.map(e => e.getBoundingClientRect().left)'
    )
    plot = page.find('#chart-states .nsewdrag').rect
    expected = plot['x'] + (first - low) / (high - low) * plot['width']
    assert lefts == pytest.approx([expected] * 4, abs=1.5)
    readings = page.find('#chart-states .reading').text.replace('\N{MINUS SIGN}', '-').split()
    theta = pendulum_states(min(first, 2.0))[0]
    assert float(readings[0]) == pytest.approx(theta + 0.02, abs=0.02)


def test_an_event_leads_to_its_instant(page, reports):
    page.open(reports['pendulum'])
    planned, late = page.driver.find_elements(By.CSS_SELECTOR, '#events [data-instant]')
    page.click(late)
    assert page.time() == pytest.approx(1.25)
    page.click(planned)
    assert page.time() == pytest.approx(-0.5)


EVIL = (
    '</script><script>window.hacked=1</script>',
    '<img src=x onerror="window.hacked=2">',
    '<a href="javascript:window.hacked=3">x</a>{{data}}<!--',
)


def test_what_a_recording_says_is_text(page, tmp_path):
    name = EVIL[1]
    mission = robots_mission(
        names=EVIL,
        title=EVIL[0],
        problem=EVIL[2],
        figures=(PlanFigures('1', 0.0, summary=EVIL[2], cost_terms={name: 1.0}),),
        events=(Event(0.5, Severity.ERROR, EVIL[0], EVIL[1]),),
        missing=(EVIL[0], EVIL[1]),
        parameters=ARENA_PARAMETERS | {EVIL[0]: EVIL[1]},
        source=EVIL[2],
    )
    write_report(mission, tmp_path / 'evil.html')
    page.open(tmp_path / 'evil.html')
    for link in page.driver.find_elements(By.CSS_SELECTOR, 'a, svg a'):
        page.run('arguments[0].dispatchEvent(new MouseEvent("click", {bubbles: true}))', link)
    assert page.run('return window.hacked === undefined')
    console, _ = page.logs()
    assert console == []
    assert page.driver.title == EVIL[0]
    assert page.find('h1').text == EVIL[0]
    assert EVIL[2] in page.find('.subtitle').text
    assert EVIL[1] in page.find('#events').text
    labels = [e.text for e in page.driver.find_elements(By.CSS_SELECTOR, '.legend button')]
    assert set(EVIL) <= set(labels)
    assert page.run('return document.querySelectorAll("body img, body a[href]").length') == 0
