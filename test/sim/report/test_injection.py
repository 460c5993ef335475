# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""``tdm report`` of recordings whose strings are attacks: names of joints, frames and topics."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from mission_bags import (
    header,
    Item,
    joint_plan,
    joint_state,
    odometry,
    pendulum_recording,
    robot_recording,
    STANDARD,
    START,
    write,
)
import numpy as np
import pytest
from tdm_planner.cli import main

pytest.importorskip('plotly')

EVIL = (
    '</script><script>hacked()</script>',
    '<img src=x onerror="hacked()">',
    """'"><svg/onload=hacked()>""",
    '<a href="javascript:hacked()">x</a>{{data}}<!--',
)


class Elements(HTMLParser):
    """Elements of a page, with their attributes; scripts are text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self._script = False
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attributes: Any) -> None:
        self.found.append((tag, dict(attributes)))
        self._script = tag == 'script'
        if self._script:
            self.scripts.append('')

    def handle_endtag(self, tag: str) -> None:
        if tag == 'script':
            self._script = False

    def handle_data(self, data: str) -> None:
        if self._script:
            self.scripts[-1] += data


def renamed(items: list[Item]) -> list[Item]:
    """Put the attacks wherever a message has a name or a frame."""
    for number, item in enumerate(items):
        message, evil = item.message, EVIL[number % len(EVIL)]
        if hasattr(message, 'header'):
            message.header.frame_id = evil
        if hasattr(message, 'child_frame_id'):
            message.child_frame_id = evil
        if hasattr(message, 'points'):
            message.header.frame_id = ''
    return items


def foreign_joints(namespace: str, at: int) -> list[Item]:
    """Messages of joints and vehicles that nobody knows, among those that belong there."""
    found = []
    for number, evil in enumerate(EVIL):
        names = [evil, 'disk' if number % 2 else 'pendulum', *EVIL]
        values = {'position': np.zeros(6), 'velocity': np.zeros(6), 'effort': np.zeros(6)}
        when = at + number * 10**7
        for topic in ('joint_states', 'joint_command', 'tracking_error'):
            message = joint_state(when, names, **values)
            message.header = header(when, evil)
            found.append(Item(f'{namespace}/{topic}', STANDARD['JointState'], when, message))
        plan = joint_plan(when, EVIL, [0.0, 1.0], positions=np.zeros((2, 4)))
        found.append(Item(f'{namespace}/trajectory', STANDARD['JointTrajectory'], when, plan))
    return found


def robots_from_elsewhere() -> list[Item]:
    items = []
    for number, evil in enumerate(EVIL):
        for k in range(20):
            when = START + (k + number) * 10**7
            message = odometry(when, evil, np.zeros(6), evil)
            items.append(Item(f'/{evil}/odom', STANDARD['Odometry'], when, message))
    return items


RECORDINGS = {
    'names and frames': lambda: renamed(pendulum_recording()),
    'foreign joints': lambda: [*pendulum_recording(), *foreign_joints('/pendulum', START)],
    'namespace': lambda: pendulum_recording(f'/{EVIL[1]}'),
    'robots': lambda: [*renamed(robot_recording()), *robots_from_elsewhere()],
}


@pytest.mark.parametrize('kind', RECORDINGS)
def test_no_string_of_a_recording_becomes_markup(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, report = tmp_path / 'plain.html', tmp_path / 'report.html'
    write(tmp_path / 'plain', robot_recording() if kind == 'robots' else pendulum_recording())
    assert main(['report', str(tmp_path / 'plain'), '-o', str(plain), '--quiet']) == 0
    write(tmp_path / 'bag', RECORDINGS[kind]())
    code = main(['report', str(tmp_path / 'bag'), '-o', str(report), '--quiet'])
    said = capsys.readouterr()
    assert 'Traceback' not in said.err
    if code != 0:  # there may be nothing in it that can be shown: then it says so
        assert said.err.startswith('error: ')
        return
    page, harmless = Elements(report.read_text()), Elements(plain.read_text())
    for tag, attributes in page.found:
        assert tag not in ('img', 'iframe', 'object', 'embed', 'base', 'form')
        assert not {name for name in attributes if name.startswith('on')}
        assert not any('javascript:' in (value or '') for value in attributes.values())
    assert len(page.scripts) == len(harmless.scripts)
    assert not any('hacked()</script' in text or '<!--' in text for text in page.scripts[:-1])
