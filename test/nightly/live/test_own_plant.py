# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The live page of an own plant in a headless browser: push, record, two pages, dead nodes."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import signal

from live_page import browser, Live, open_page, OWN  # noqa: F401
import numpy as np
import pytest
from ros_harness import Ros
from sensor_msgs.msg import JointState
from signal_scenes import survivors


def is_node(process: int, name: str) -> bool:
    """Whether a process is that of a node's executable."""
    return f'tdm_planner.nodes.{name}' in Path(f'/proc/{process}/cmdline').read_text()


@pytest.mark.timeout(900)
def test_an_own_plant_is_pushed_recorded_and_watched_from_two_pages(
    ros: Ros,
    open_page: Callable[..., Live],  # noqa: F811
) -> None:
    space = '/double_integrator'
    states = ros.subscribe(f'{space}/joint_states', JointState)
    page = open_page(OWN)
    page.driver.switch_to.new_window('tab')
    other = open_page(space)  # joins the nodes that run
    other.click('Start a recording')
    other.wait_for('.tdm-note', 'recording to')
    (file,) = other.folder.glob('recording_*/*.mcap')
    assert other.until(lambda: file.stat().st_size > 100_000)  # definitions take half of that
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
