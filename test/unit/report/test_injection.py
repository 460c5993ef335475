# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""``tdm report`` of recordings whose strings are attacks: names, parameters, what nodes say."""

from __future__ import annotations

from collections.abc import Sequence
from html.parser import HTMLParser
import json
from pathlib import Path
from typing import Any

from mission_bags import (
    header,
    Item,
    joint_plan,
    joint_state,
    log,
    odometry,
    pendulum_recording,
    robot_recording,
    STANDARD,
    START,
    status,
    summary,
    without,
    write,
)
import numpy as np
import pytest
from tdm_planner.cli import main
from tdm_planner.problems import PendulumSwingUp

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
        self.texts: list[str] = []
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
        else:
            self.texts.append(data)

    def shows(self, string: str) -> bool:
        """Whether people can read a string: as text, or in a chart by way of the page's data."""
        written = json.dumps(string)[1:-1].replace('<', r'\u003c').replace('>', r'\u003e')
        return any(string in text for text in self.texts) or any(
            written in text for text in self.scripts
        )


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


def what_nodes_say(namespace: str, at: int) -> list[Item]:
    """Diagnostics and log messages, of this planner's nodes and of others."""
    found = []
    for number, evil in enumerate(EVIL):
        for node in (f'{namespace}/{evil}', f'{namespace}/planner', f'/{evil}'):
            when = at + number * 10**8
            names = {'plan id': '1', f'margin of {evil}': '-0.5', evil: evil, 'cost': evil}
            told = status(when, node, 1 + number % 2, f'{evil} {node}', **names)
            told.status[0].name = f'{node}: {evil}'
            told.status[0].hardware_id = evil
            found.append(Item('/diagnostics', STANDARD['DiagnosticArray'], when, told))
        said = log(at + number * 10**8, 40, f'pendulum.{evil}', f'said {evil}')
        said.file = said.function = evil
        found.append(Item('/rosout', STANDARD['Log'], at + number * 10**8, said))
    return found


def said_of_a_plan() -> list[Item]:
    """Return a recording whose summary has the attacks wherever it has a string."""
    found = []
    for item in pendulum_recording():
        if item.topic.endswith('/plan_summary'):
            worst = dict.fromkeys(EVIL, -0.5)
            check = {'worst': worst, 'worst_times': worst, 'reasons': EVIL}
            check |= {'units': dict.fromkeys([*EVIL, 'torque'], '<i>'), 'terminal_error': worst}
            units = {'theta': '<b id=x>', 'psi': '<i>', 'torque': '</script>'}
            vehicle = {'interpolation': 'zero_order_hold', 'units': units}
            parameters = PendulumSwingUp().to_parameters() | {f'limits.{e}': e for e in EVIL}
            more: dict[str, Any] = {e: {e: [e]} for e in EVIL}
            message = summary(
                START,
                'pendulum_swing_up',
                parameters | {'method': EVIL[0], 'list': list(EVIL), EVIL[1]: list(EVIL)},
                plan_id=EVIL[2],
                summary=' '.join(EVIL),
                vehicles={'pendulum': vehicle, **dict.fromkeys(EVIL, vehicle)},
                verification=check,
                cost_terms=worst,
                **more,
            )
            item = item._replace(message=message)
        found.append(item)
    return found


def robots_of_evil_names() -> list[Item]:
    """Return the recording with a robot, its topics and frames, that is called an attack."""
    found = []
    for item in robot_recording():
        message = item.message
        if hasattr(message, 'data'):
            message.data = message.data.replace('robot1', json.dumps(EVIL[1])[1:-1])
        for name in ('joint_names', 'name'):
            given = getattr(message, name, [])
            if 'robot1' in given:
                setattr(message, name, [EVIL[1]])
        found.append(item._replace(topic=item.topic.replace('robot1', EVIL[1])))
    return renamed(found)


def another_planner() -> list[Item]:
    """Return the recording with the topics of a second planner, which carries nothing out."""
    return [*pendulum_recording(), *without(pendulum_recording(f'/{EVIL[1]}'), '/trajectory')]


RECORDINGS = {
    'frames': lambda: renamed(pendulum_recording()),
    'foreign joints': lambda: [*pendulum_recording(), *foreign_joints('/pendulum', START)],
    'namespace': lambda: pendulum_recording(f'/{EVIL[1]}'),
    'another planner': another_planner,
    'robots from elsewhere': lambda: [*renamed(robot_recording()), *robots_from_elsewhere()],
    'robots of evil names': robots_of_evil_names,
    'diagnostics': lambda: [*pendulum_recording(), *what_nodes_say('/pendulum', START)],
    'summary': said_of_a_plan,
}
# Which of the attacks people can read in the page, as the plain strings that they are.
SHOWN: dict[str, Sequence[str]] = {
    'foreign joints': EVIL[:1],
    'another planner': EVIL[1:2],
    'robots of evil names': EVIL[1:2],
    'diagnostics': EVIL,
    'summary': EVIL,
}


@pytest.mark.parametrize('kind', RECORDINGS)
def test_no_string_of_a_recording_becomes_markup(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page has no element and no script that the same recording without attacks has not."""
    plain, report = tmp_path / 'plain.html', tmp_path / 'report.html'
    write(tmp_path / 'plain', robot_recording() if 'robots' in kind else pendulum_recording())
    assert main(['report', str(tmp_path / 'plain'), '-o', str(plain), '--quiet']) == 0
    write(tmp_path / 'bag', RECORDINGS[kind]())
    code = main(['report', str(tmp_path / 'bag'), '-o', str(report), '--quiet'])
    said = capsys.readouterr()
    assert 'Traceback' not in said.err
    assert code == 0, said.err
    page, harmless = Elements(report.read_text()), Elements(plain.read_text())
    for tag, attributes in page.found:
        assert tag not in ('img', 'iframe', 'object', 'embed', 'base', 'form', 'i')
        assert not {name for name in attributes if name.startswith('on')}
        assert not any('javascript:' in (value or '') for value in attributes.values())
        assert attributes.get('id') != 'x'
    assert len(page.scripts) == len(harmless.scripts)
    assert not any('hacked()</script' in text or '<!--' in text for text in page.scripts[:-1])
    for evil in SHOWN.get(kind, ()):
        assert page.shows(evil), evil
