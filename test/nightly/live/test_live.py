# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The live page in a headless browser: drag, reason, push, record, two pages, dead nodes."""

from __future__ import annotations

import math
import os
from pathlib import Path
import signal

from live_page import browser, DESKTOP, Live, open_page, OWN, PHONE  # noqa: F401
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from signal_scenes import survivors
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.plant_views import view_of
from tdm_planner.problems import RobotFormation
from tdm_sim.live.geometry import axes_of, view_on
from tdm_sim.live.scene import drag_handles_of
from tools.browser import set_window
from trajectory_msgs.msg import JointTrajectory

FOV = math.radians(75.0)  # of the camera, upright


def is_node(process: int, name: str) -> bool:
    """Whether a process is that of a node's executable."""
    return f'tdm_planner.nodes.{name}' in Path(f'/proc/{process}/cmdline').read_text()


def pixel(page: Live, point: np.ndarray) -> tuple[int, int]:
    """Return where the camera shows a point of the arena at first."""
    problem = RobotFormation()
    view = view_of(problem)
    states = [dict.fromkeys(view.kind.state_names, np.float64(0.0)) for _ in problem.robots]
    for state, start, yaw in zip(states, problem.task.start, problem.task.yaw, strict=True):
        state |= {'x': start[0], 'y': start[1], 'yaw': yaw}
    controls = dict.fromkeys(view.kind.control_names, np.float64(0.0))
    drawn = [shape for state in states for shape in view.drawing(state, controls)]
    seen = view_on([*view.surroundings(), *drawn])
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


@pytest.mark.timeout(900)
def test_a_goal_is_dragged_and_what_is_infeasible_says_why(ros, open_page):  # noqa: F811
    plans = ros.subscribe('/robots/robot1/trajectory', JointTrajectory, LATCHED)
    page = open_page('robots', DESKTOP)
    handle = drag_handles_of(RobotFormation())[0]
    place, turn = handle.pose({})
    ahead, _, _ = axes_of(turn)
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


@pytest.mark.timeout(900)
def test_an_own_plant_is_pushed_recorded_and_watched_from_two_pages(ros, open_page):  # noqa: F811
    space = '/double_integrator'
    states = ros.subscribe(f'{space}/joint_states', JointState)
    page = open_page(OWN)
    page.driver.switch_to.new_window('tab')
    other = open_page(space)  # joins the nodes that run
    other.click('Start a recording')
    other.wait_for('.tdm-note', 'recording to')
    other.click('Plan')
    other.wait_for('.tdm-status', 'holding')
    assert other.until(lambda: other.shows('/plants/box_100'))  # by its drawing
    begin = len(states)
    other.click('Push')
    assert other.until(lambda: any(abs(s.position[1]) > 0.05 for s in states[begin:]))  # v
    assert other.until(lambda: bool(np.abs(states[-1].position).max() < 0.01))
    other.wait_for('.tdm-status', 'holding')
    other.click('End the recording')
    other.wait_for('.tdm-note', 'recorded to')
    other.click('Make a report')
    other.wait_for('.tdm-note', 'report in')
    (report,) = other.folder.glob('*.html')
    assert '"kind":"box"' in report.read_text(encoding='utf-8')  # of its drawing
    assert other.complaints() == []
    (tracker,) = (pid for pid in survivors(page.mark) if is_node(pid, 'tracker'))
    os.kill(tracker, signal.SIGSTOP)
    other.wait_for('.tdm-fault', f'no sign of life from {space}/tracker')
    page.driver.switch_to.window(page.driver.window_handles[0])
    os.kill(tracker, signal.SIGKILL)
    page.wait_for('.tdm-fault', 'tracker ended with exit code -9')
    page.driver.switch_to.window(page.driver.window_handles[1])
    other.wait_until_gone('.tdm-status', 'no sign of life')
