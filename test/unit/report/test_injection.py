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
from dataclasses import fields, is_dataclass
import json
from pathlib import Path
from typing import Any

from missions import (
    Item,
    log,
    Parts,
    pendulum_recording,
    robot_recording,
    SECOND,
    START,
    status,
    summary,
    without,
    write,
)
import pytest
from tdm_planner.cli import main
from tdm_planner.problems import PendulumSwingUp

EVIL = (
    '</script><script>hacked()</script>',
    '<img src=x onerror="hacked()">',
    """'"><svg/onload=hacked()>""",
    '<a href="javascript:hacked()">x</a>{{data}}<!--',
)


def shows(page: Parts, string: str) -> bool:
    """Whether people can read a string: as text, or in a chart by way of the page's data."""
    written = json.dumps(string)[1:-1].replace('<', r'\u003c').replace('>', r'\u003e')
    return any(string in text for text in page.texts) or any(
        written in text for _, text in page.scripts
    )


def poisoned(message: Any, evil: str) -> Any:
    """Return a copy of a message, or of a part of it, every string of which is an attack."""
    if isinstance(message, str):
        return evil
    if isinstance(message, list):
        return [poisoned(item, evil) for item in message]
    if not is_dataclass(message):
        return message
    parts = {field.name: getattr(message, field.name) for field in fields(message)}
    return type(message)(**{
        name: value if name == '__msgtype__' else poisoned(value, evil)
        for name, value in parts.items()
    })  # fmt: skip


def with_strangers(items: list[Item]) -> list[Item]:
    """Add what others send on each topic, and on those of evil names: frames, joints, vehicles."""
    found = list(items)
    for topic in {item.topic for item in items if not item.topic.endswith('plan_summary')}:
        *_, last = [item for item in items if item.topic == topic]
        for number, evil in enumerate(EVIL):
            message, at = poisoned(last.message, evil), START + number * SECOND // 100
            found.append(Item(topic, at, message))
            found.append(Item(f'/{evil}/{topic.split("/")[-1]}', at, message))
    return found


def what_nodes_say() -> list[Item]:
    """Diagnostics, log messages and the summary of a plan, with attacks for all strings."""
    found = without(pendulum_recording(), '/plan_summary')
    for number, evil in enumerate(EVIL):
        when = START + number * SECOND // 10
        for node in (f'/pendulum/{evil}', '/pendulum/planner', f'/{evil}'):
            names = {'plan id': '1', f'margin of {evil}': '-0.5', evil: evil, 'cost': evil}
            told = status(when, node, 1 + number % 2, f'{evil} {node}', **names)
            told.status[0].name = f'{node}: {evil}'
            found.append(Item('/diagnostics', when, told))
        found.append(Item('/rosout', when, log(when, 40, f'pendulum.{evil}', f'said {evil}')))
    worst = dict.fromkeys(EVIL, -0.5)
    check = {'worst': worst, 'worst_times': worst, 'reasons': EVIL, 'terminal_error': worst}
    units = {'theta': '<b id=x>', 'psi': '<i>', 'torque': '</script>'}
    vehicle = {'interpolation': 'zero_order_hold', 'units': units}
    parameters = PendulumSwingUp().to_parameters() | {f'limits.{e}': e for e in EVIL}
    message = summary(
        START,
        'pendulum_swing_up',
        parameters | {'method': EVIL[0], 'list': list(EVIL), EVIL[1]: list(EVIL)},
        plan_id=EVIL[2],
        summary=' '.join(EVIL),
        vehicles={'pendulum': vehicle, **dict.fromkeys(EVIL, vehicle)},
        verification=check | {'units': dict.fromkeys([*EVIL, 'torque'], '<i>')},
        cost_terms=worst,
        **{evil: {evil: [evil]} for evil in EVIL},
    )
    return [*found, Item('/pendulum/plan_summary', START - SECOND, message)]


def robots_of_evil_names() -> list[Item]:
    """Return the recording with a robot, its topics and frames, that is called an attack."""
    found = []
    for item in robot_recording():
        message = item.message
        if hasattr(message, 'data'):
            message.data = message.data.replace('robot1', json.dumps(EVIL[1])[1:-1])
        if 'robot1' in getattr(message, 'joint_names', []):
            message.joint_names = [EVIL[1]]
        found.append(item._replace(topic=item.topic.replace('robot1', EVIL[1])))
    return found


def of_evil_namespaces() -> list[Item]:
    """Return a recording of two planners, one of which carries nothing out, and of strangers."""
    one, other = (pendulum_recording(f'/{evil}') for evil in EVIL[:2])
    return with_strangers([*one, *without(other, '/trajectory')])


@pytest.mark.parametrize(
    ('recording', 'shown'),
    [
        (of_evil_namespaces, EVIL[1:2]),
        (lambda: with_strangers(robots_of_evil_names()), EVIL[1:2]),
        (what_nodes_say, EVIL),
    ],
    ids=['namespaces', 'robots', 'what nodes say'],
)
def test_no_string_of_a_recording_becomes_markup(
    tmp_path: Path, recording: Any, shown: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / 'bag', recording())
    file = tmp_path / 'report.html'
    assert main(['report', str(tmp_path / 'bag'), '-o', str(file), '--quiet']) == 0
    assert 'Traceback' not in capsys.readouterr().err
    page = Parts(file.read_text())
    for tag, attributes in page.elements:
        assert tag not in ('img', 'iframe', 'object', 'embed', 'base', 'form', 'i')
        assert not {name for name in attributes if name.startswith('on')}
        assert not any('javascript:' in (value or '') for value in attributes.values())
        assert attributes.get('id') != 'x'
    assert len(page.scripts) == 3  # the data, the library of charts, the page's own
    assert not any('hacked()</script' in text or '<!--' in text for _, text in page.scripts[:-1])
    for evil in shown:
        assert shows(page, evil), evil
