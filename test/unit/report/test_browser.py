# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The report in a headless browser: each kind is opened once, for all that is asked of it."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from missions import pendulum_mission, pendulum_states, robots_mission
import numpy as np
import pytest

if find_spec('selenium') is None:
    pytest.skip('browsers are driven by selenium', allow_module_level=True)

from replays import pendulum_points
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait
from tdm_sim.report.mission import Mission
from tdm_sim.report.page import write_report
from tools.browser import chromium, logged, MISSING, open_browser, open_report, PATIENCE

if chromium() is None:
    pytest.skip(MISSING, allow_module_level=True)

DESKTOP, PHONE = (1280, 800), (390, 844)
LOCAL = ('file:', 'data:', 'chrome:')  # the last of the browser's own first page


class Page:
    """A report that is open in the browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(script, *arguments)

    def each(self, selector: str, script: str) -> Any:
        every = 'return [...document.querySelectorAll(arguments[0])]'
        return self.run(f'{every}.map(e => {script})', selector)

    def wait(self, script: str, *arguments: Any) -> Any:
        seen = WebDriverWait(self.driver, PATIENCE, poll_frequency=0.05)
        return seen.until(lambda _: self.run(script, *arguments), script)

    def find(self, selector: str) -> Any:
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def click(self, element: Any) -> None:
        self.run('arguments[0].scrollIntoView({block: "center"})', element)
        element.click()

    def number(self, selector: str, attribute: str) -> float:
        return float(self.find(selector).get_attribute(attribute))

    def points(self, selector: str) -> list[list[list[float]]]:
        texts = self.each(selector, 'e.getAttribute("points")')
        return [[[float(v) for v in p.split(',')] for p in text.split()] for text in texts]

    def set_time(self, t: float) -> None:
        self.run('report.clock.set(arguments[0])', t)

    def time(self) -> float:
        return float(self.run('return report.clock.t'))

    def ranges(self) -> Any:
        return self.each('.chart', 'e.layout.xaxis.range')

    def visible(self, kind: str) -> list[bool]:
        curves = self.each('.chart', 'e.data.map(t => [t.meta.kind, t.visible !== false])')
        return [shown for chart in curves for of, shown in chart if of == kind]


@pytest.fixture(scope='module')
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with open_browser(tmp_path_factory.mktemp('chromium')) as driver:
        yield driver


@pytest.fixture(scope='class')
def page(browser: Any, tmp_path_factory: pytest.TempPathFactory, request: Any) -> Page:
    file = tmp_path_factory.mktemp('report') / 'report.html'
    write_report(request.cls.mission, file)
    found = Page(browser)
    logged(browser)
    open_report(browser, file, request.cls.size, request.cls.scheme)
    return found


class Report:
    """What is asked of every report."""

    mission: ClassVar[Mission]
    size: ClassVar[tuple[int, int]] = DESKTOP
    scheme: ClassVar[str] = 'light'

    def test_no_complaint_and_nothing_from_the_network(self, page: Page) -> None:
        page.set_time(1.0)
        console, addresses = logged(page.driver, 'SEVERE', 'WARNING')
        assert console == []
        assert addresses
        assert [a for a in addresses if not a.startswith(LOCAL)] == []

    def test_readable(self, page: Page) -> None:
        width, _ = self.size
        assert page.run('return document.documentElement.scrollWidth') <= width
        assert page.run('return window.innerWidth') == width
        texts = page.run(Path(__file__).with_name('readable.js').read_text(encoding='utf-8'))
        assert len(texts) > 60
        assert [t for t in texts if t[1] < 11] == []
        assert [t for t in texts if t[2] < -0.5 or t[3] > width + 0.5] == []
        for selector in ('h1', '#summary', '#scene svg', '.chart .main-svg', '#play', '#time'):
            box = page.find(selector).rect
            assert min(box['width'], box['height']) > 10, selector
        assert 'none' not in page.each('.vehicle', 'getComputedStyle(e).stroke')

    def test_the_slider_moves_the_animation(self, page: Page) -> None:
        page.set_time(0.0)
        moving = '.vehicle:not(.goal) .body'
        seen = {page.each(moving, 'e.outerHTML')[0]}
        slider = page.find('#time')
        for _ in range(4):
            slider.send_keys(Keys.PAGE_UP)
            seen.add(page.each(moving, 'e.outerHTML')[0])
        assert len(seen) == 5
        assert page.time() == pytest.approx(float(slider.get_attribute('value')), abs=1e-6)
        assert page.find('#instant').text == f'{page.time():.2f} s'


class TestPendulum(Report):
    mission = pendulum_mission()

    def test_the_pendulum_stands_where_the_markers_put_it(self, page: Page) -> None:
        views = {'side': lambda p: (p[1], -p[2]), 'top': lambda p: (p[1], p[0])}
        problem: Any = self.mission.vehicles[0].view.problem
        plant = problem.plant
        for t in (0.0, 0.37, 1.1, 2.0):
            page.set_time(t)
            theta, psi = pendulum_states(t)[:2]
            pivot, tip = pendulum_points(plant, theta, psi)
            for view, project in views.items():
                scale = page.number(f'#scene-{view}', 'data-scale')
                rod = page.points(f'#scene-{view} .vehicle.planned .line.body')[1]
                drawn = np.subtract(rod[1], rod[0]) / scale
                expected = np.subtract(project(tip), project(pivot))
                assert drawn == pytest.approx(expected, abs=2e-3), (t, view)

    def test_the_legend_switches_curves_in_all_charts(self, page: Page) -> None:
        assert not any(page.visible('commanded'))
        measured = page.visible('measured')
        assert len(measured) == 4 + 1 + 2  # states, control, margins
        assert all(measured)
        lines = 'return document.querySelectorAll("#chart-controls .scatterlayer .trace").length'
        before = page.run(lines)
        path = 'preceding-sibling::ul//button[normalize-space()="measured"]'
        button = page.find('#chart-states').find_element(By.XPATH, path)
        page.click(button)
        assert button.get_attribute('aria-pressed') == 'false'
        page.wait(f'{lines} === {before - 1}')
        assert not any(page.visible('measured'))
        page.click(button)
        page.wait(f'{lines} === {before}')
        assert page.visible('measured') == measured

    def test_zoom_is_linked(self, page: Page) -> None:
        before = page.ranges()
        assert len({tuple(r) for r in before}) == 1
        drag = page.find('#chart-states .nsewdrag')
        page.run('arguments[0].scrollIntoView({block: "center"})', drag)
        mouse = ActionChains(page.driver, duration=50).move_to_element_with_offset(drag, -60, 0)
        mouse.click_and_hold().move_by_offset(60, 2).move_by_offset(40, 0).release().perform()
        every = 'return [...document.querySelectorAll(".chart")].map(c => c.layout.xaxis.range[0])'
        page.wait(f'{every}.every(at => Math.abs(at - arguments[0]) > 0.05)', before[0][0])
        after = page.ranges()
        assert len({tuple(np.round(r, 6)) for r in after}) == 1
        assert before[0][0] < after[0][0] < after[0][1] < before[0][1]
        page.find('[data-part=all]').click()
        page.wait(f'{every}.every(at => at === -1)')
        assert page.run('return report.clock.start') == -1

    def test_the_cursor_is_linked(self, page: Page) -> None:
        page.set_time(0.0)
        chart = page.find('#chart-controls')
        page.run('arguments[0].scrollIntoView({block: "center"})', chart)
        ActionChains(page.driver, duration=20).move_to_element_with_offset(chart, 40, 0).perform()
        first = page.wait('return report.clock.t')
        low, high = page.ranges()[0]
        assert low < first < high
        lefts = page.each('#chart-states .cursor', 'e.getBoundingClientRect().left')
        plot = page.find('#chart-states .nsewdrag').rect
        expected = plot['x'] + (first - low) / (high - low) * plot['width']
        assert lefts == pytest.approx([expected] * 4, abs=1.5)
        reading = page.find('#chart-states .reading').text.replace('\N{MINUS SIGN}', '-').split()
        theta = pendulum_states(np.clip(first, 0.0, 2.0))[0]
        assert float(reading[0]) == pytest.approx(theta + 0.02, abs=0.02)

    def test_an_event_leads_to_its_instant(self, page: Page) -> None:
        for row, instant in ((2, 1.25), (1, -0.5)):
            page.click(page.find(f'#events tbody tr:nth-child({row}) [data-instant]'))
            assert page.time() == pytest.approx(instant)

    def test_play_and_pause(self, page: Page) -> None:
        play = page.find('#play')
        page.set_time(0.0)
        play.click()
        assert play.get_attribute('aria-label') == 'Pause'
        page.wait('return report.clock.t > 0.05')
        play.click()
        assert play.get_attribute('aria-label') == 'Play'
        page.set_time(page.run('return report.clock.end - 0.05'))
        play.click()
        page.wait('return !report.clock.playing')  # it ends by itself, at the end
        assert page.time() == pytest.approx(page.run('return report.clock.end'))


class TestPlanOfThePendulum(Report):
    mission, size, scheme = pendulum_mission(measured=False), PHONE, 'dark'


class TestRobots(Report):
    mission, size = robots_mission(), PHONE

    def test_the_robot_heads_and_blows_where_it_should(self, page: Page) -> None:
        t = 1.5
        page.set_time(t)
        centres = []
        for number in range(2):
            robot = f'.vehicle.measured[data-vehicle="{number}"]'
            hull = f'{robot} .disc.body'
            centre = np.array([page.number(hull, 'cx'), -page.number(hull, 'cy')])
            (heading,) = page.points(f'{robot} .line.body')
            (jet,) = page.points(f'{robot} .force')
            ahead, back = (np.diff(line, axis=0)[0] * [1, -1] for line in (heading, jet))
            yaw, alpha = 0.3 * t, 0.5 + number
            assert np.arctan2(*ahead[::-1]) == pytest.approx(yaw, abs=0.02)
            # the jet leaves against the force, half as long at half of the thrust
            assert np.arctan2(*-back[::-1]) == pytest.approx(yaw + alpha, abs=0.02)
            assert np.hypot(*back) == pytest.approx(0.8 * page.number(hull, 'r'), rel=0.05)
            centres.append(centre)
        apart = (centres[1] - centres[0]) / page.number('#scene-plane', 'data-scale')
        assert apart == pytest.approx([0.0, 1.0], abs=0.01)

    def test_walls_zones_goals_and_safety_circles_are_drawn(self, page: Page) -> None:
        scale = page.number('#scene-plane', 'data-scale')
        walls = np.ptp(page.points('.ground.body')[0], axis=0) / scale
        assert walls == pytest.approx([4.0, 3.0], rel=1e-2)
        for selector, radius in (('.ground.disc.limit', 0.25), ('.measured .reach', 0.2)):
            assert page.number(selector, 'r') / scale == pytest.approx(radius, rel=1e-3)
        assert len(page.each('g.goal', '1')) == len(page.each('.vehicle .path', '1')) == 2


class TestPlanOfRobots(Report):
    mission, scheme = robots_mission(measured=False), 'dark'
