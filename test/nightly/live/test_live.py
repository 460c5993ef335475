# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The live page in a headless browser: drag, reason, push, record, two pages, dead nodes."""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
import math
import os
from pathlib import Path
import re
import signal

import numpy as np
import pytest
from ros_harness import ENOUGH, Ros, SOURCE

if find_spec('selenium') is None or find_spec('viser') is None:
    pytest.skip('needs selenium and viser', allow_module_level=True)

from selenium.webdriver.common.action_chains import ActionChains
from signal_scenes import survivors
from tdm_planner.plant_views import view_of
from tdm_planner.problems import RobotFormation
from tdm_sim.live.geometry import view_on
from tdm_sim.live.scene import drag_handles_of
from tools.browser import chromium, logged, MISSING, open_browser, set_window
from viser.transforms import SO3
import yaml

if chromium() is None:
    pytest.skip(MISSING, allow_module_level=True)

FOV = math.radians(75.0)  # of the camera, upright
LONG = 180.0  # s that anything may take: drawing in space by software is slow
DESKTOP, PHONE, SMALL = (800, 500), (390, 700), (480, 320)  # px; drawing takes time by pixels
LOCAL = ('http://127.0.0.1', 'ws://127.0.0.1', 'blob:', 'data:', 'chrome:')
RELAXED = {  # for a machine that draws by software beside
    'planner': {'start': {'max_age': 2.0}, 'solver': {'deadline': ENOUGH}},
    'tracker': {'rate': 50.0, 'state_timeout': 1.0},
    **{name: {'rate': 50.0, 'command_timeout': 1.0} for name in ('robot_plant', 'plant')},
}
OWN = 'double_integrator:DoubleIntegrator'


def relaxed(plant: str, folder: Path) -> Path:
    file = SOURCE / 'config' / f'{plant}.yaml'
    document = yaml.safe_load(file.read_text(encoding='utf-8')) if file.exists() else {}
    for name, values in RELAXED.items():
        parameters = document.setdefault(f'/**/{name}', {'ros__parameters': {}})['ros__parameters']
        for key, value in values.items():
            more = isinstance(value, dict)
            parameters[key] = parameters.get(key, {}) | value if more else value
    written = folder / 'relaxed.yaml'
    written.write_text(yaml.safe_dump(document))
    return written


class Live:
    """A page on the nodes of a plant, or on those in a namespace, open in a tab of a browser."""

    def __init__(self, ros: Ros, driver, nodes: str, folder: Path, size) -> None:
        self.ros, self.driver, self.folder = ros, driver, folder / nodes.strip('/')
        words = ['live', '--no-browser', '--port', '0', '-o', str(self.folder)]
        words += [nodes] if nodes.startswith('/') else [nodes, '--params']
        words += [] if nodes.startswith('/') else [str(relaxed(nodes, folder))]
        self.mark = f'TDM_TEST_MARK={self.folder}'  # of all that it starts
        path = os.pathsep.join([str(SOURCE), str(SOURCE / 'docs' / 'plants')])
        variables = dict([self.mark.split('=')]) | {'PYTHONPATH': path}
        self.process = ros.run('tdm_planner.cli', words, variables)
        assert ros.spin_until(lambda: 'Ctrl-C ends it' in self.process.output), self.output
        (self.address,) = re.findall(r'http://\S+', self.process.output)
        logged(driver)
        set_window(driver, size)
        driver.get(self.address)
        self.wait_for('.tdm-status', 'ready')

    def click(self, name: str, *told: str) -> None:
        """Click a button, and wait for what is to be told of it: selector and word."""
        script = (
            'const found = [...document.querySelectorAll("button")]'
            '.find(b => b.innerText.trim() === arguments[0] && !b.disabled);'
            'found?.click(); return Boolean(found)'
        )
        found = self.until(lambda: bool(self.driver.execute_script(script, name)))
        assert found, f'no button {name!r}\n{self.output}'
        if told:
            self.wait_for(*told)

    @property
    def output(self) -> str:
        return self.process.output

    def text(self, selector: str) -> str:
        script = 'return [...document.querySelectorAll(arguments[0])].map(e => e.innerText).join()'
        return str(self.driver.execute_script(script, selector))

    def wait_for(self, selector: str, word: str) -> str:
        said = self.until(lambda: word in self.text(selector))
        assert said, f'{word} not in {self.text(selector)!r}\n{self.output}'
        return self.text(selector)

    def until(self, condition: Callable[[], bool]) -> bool:
        return self.ros.spin_until(condition, LONG)

    def wait_until_drawn(self, node: str) -> None:
        """Wait until something is in the scene, and has been drawn some times."""
        script = 'return window.__viserTestpoints.rendererInfo.render.frame'
        frames = lambda: int(self.driver.execute_script(script))  # noqa: E731
        assert self.until(lambda: self.shows(node)), f'no {node}\n{self.output}'
        first = frames()
        assert self.until(lambda: frames() > first + 20), f'not drawn\n{self.output}'

    def shows(self, node: str) -> bool:
        script = (
            'const tree = window.__viserSceneTree;'
            'return Boolean(tree && window.__viserTestpoints && arguments[0] in tree.getState())'
        )
        return bool(self.driver.execute_script(script, node))

    def complaints(self) -> list[str]:
        """Return errors of the page, and what it asked of anybody but its own server."""
        found, asked = logged(self.driver, 'SEVERE')
        assert asked
        return found + [url for url in asked if not url.startswith(LOCAL)]

    def drag(self, start: tuple[int, int], way: tuple[int, int]) -> None:
        mouse = ActionChains(self.driver, duration=100)
        pointer = mouse.w3c_actions.pointer_action
        pointer.move_to_location(*start)
        mouse.pause(1.0).click_and_hold().pause(0.3)
        for share in (0.2, 0.4, 0.6, 0.8, 1.0):
            x, y = (round(at + share * by) for at, by in zip(start, way, strict=True))
            pointer.move_to_location(x, y)
            mouse.pause(0.2)
        mouse.pause(0.5).release().perform()

    def end(self) -> None:
        self.process.end_cleanly()
        assert not survivors(self.mark)


@pytest.fixture(scope='module')
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    with open_browser(tmp_path_factory.mktemp('chromium'), in_space=True) as driver:
        driver.set_script_timeout(LONG)
        yield driver


@pytest.fixture
def open_page(ros: Ros, browser, tmp_path: Path):
    opened: list[Live] = []

    def opens(nodes: str, size: tuple[int, int] = SMALL) -> Live:
        opened.append(Live(ros, browser, nodes, tmp_path, size))
        return opened[-1]

    yield opens
    for tab in browser.window_handles[1:]:
        browser.switch_to.window(tab)
        browser.close()
    browser.switch_to.window(browser.window_handles[0])
    browser.get('about:blank')
    for page in opened:
        page.end()


def pixel(page: Live, point: np.ndarray) -> tuple[int, int]:
    """Return where the camera shows a point of the arena at first."""
    view, task = view_of(RobotFormation()), RobotFormation().task
    rest = dict.fromkeys((*view.kind.state_names, *view.kind.control_names), np.float64(0.0))
    places = zip(task.start, task.yaw, strict=True)
    states = [rest | {'x': x, 'y': y, 'yaw': yaw} for (x, y), yaw in places]
    drawn = [shape for state in states for shape in view.drawing(state, rest)]
    seen = view_on([*view.surroundings, *drawn])
    ahead = (seen.target - seen.camera) / np.linalg.norm(seen.target - seen.camera)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)
    box = page.driver.execute_script(
        'const b = document.querySelector("canvas").getBoundingClientRect();'
        'return [b.left, b.top, b.width, b.height]'
    )
    away = point - seen.camera
    scale = 0.5 * box[3] / math.tan(FOV / 2) / float(away @ ahead)
    x = box[0] + 0.5 * box[2] + scale * float(away @ right)
    y = box[1] + 0.5 * box[3] - scale * float(away @ above)
    return round(x), round(y)


def test_a_goal_is_dragged_and_what_is_infeasible_says_why(ros, open_page):
    plans = ros.subscribe('/robots/robot1/trajectory')
    page = open_page('robots', DESKTOP)
    handle = drag_handles_of(RobotFormation())[0]
    place, turn = handle.pose({})
    ahead = SO3(turn).as_matrix()[:, 0]
    grab = pixel(page, place + 0.6 * handle.size * ahead)
    beside = pixel(page, place + (0.6 * handle.size + 0.4) * ahead)
    page.wait_until_drawn('/handles/robot1')
    page.drag(grab, (beside[0] - grab[0], beside[1] - grab[1]))
    assert page.until(lambda: len(plans) > 0), page.output + page.text('.tdm-note')
    page.wait_for('.tdm-status', 'robots in formation')
    end = plans[-1].points[-1].positions[:2]
    moved = np.array(end) - place[:2]
    assert float(moved @ ahead[:2]) > 0.1
    assert abs(moved[0] * ahead[1] - moved[1] * ahead[0]) < 0.02
    count, grab = len(plans), pixel(page, place + 0.6 * handle.size * ahead + [*moved, 0.0])
    page.drag(grab, (400, 0))
    reason = page.wait_for('.tdm-note', 'INVALID_PROBLEM')
    assert 'robot1' in reason
    assert page.shows('/handles/robot1/reason')
    assert len(plans) >= count
    assert page.complaints() == []
    # Who comes late, beside another, sees the present; so does who reloads.
    page.driver.switch_to.new_window('tab')
    set_window(page.driver, PHONE)
    page.driver.get(page.address)
    page.wait_for('.tdm-status', 'robots in formation')
    page.wait_for('.tdm-note', 'INVALID_PROBLEM')
    assert page.driver.execute_script('return document.documentElement.scrollWidth') <= PHONE[0]
    page.driver.refresh()
    page.wait_for('.tdm-status', 'robots in formation')


def test_an_own_plant_is_pushed_recorded_and_watched_from_two_pages(ros, open_page):
    space = '/double_integrator'
    states = ros.subscribe(f'{space}/joint_states')
    page = open_page(OWN)
    page.driver.switch_to.new_window('tab')
    other = open_page(space)  # joins the nodes that run
    other.click('Start a recording', '.tdm-note', 'recording to')
    other.click('Plan', '.tdm-status', 'holding')
    assert other.until(lambda: other.shows('/plants/box_100'))  # by its drawing
    begin = len(states)
    other.click('Push')
    assert other.until(lambda: any(abs(s.position[1]) > 0.05 for s in states[begin:]))  # v
    assert other.until(lambda: bool(np.abs(states[-1].position).max() < 0.01))
    other.wait_for('.tdm-status', 'holding')
    other.click('End the recording', '.tdm-note', 'recorded to')
    other.click('Make a report', '.tdm-note', 'report in')
    (report,) = other.folder.glob('*.html')
    assert '"kind":"box"' in report.read_text(encoding='utf-8')  # of its drawing
    assert other.complaints() == []
    (tracker,) = survivors(page.mark, 'nodes.tracker')
    os.kill(tracker, signal.SIGSTOP)
    other.wait_for('.tdm-fault', f'no sign of life from {space}/tracker')
    page.driver.switch_to.window(page.driver.window_handles[0])
    os.kill(tracker, signal.SIGKILL)
    page.wait_for('.tdm-fault', 'tracker ended with exit code -9')
    page.driver.switch_to.window(page.driver.window_handles[1])
    assert other.until(lambda: 'no sign of life' not in other.text('.tdm-status'))
