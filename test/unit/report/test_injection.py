# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""``tdm report`` of a recording whose strings are attacks: names, parameters, what nodes say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from missions import EVIL, Parts
import pytest
from recordings import (
    Item,
    log,
    pendulum_recording,
    robot_recording,
    SECOND,
    START,
    status,
    summary,
    without,
    write,
)
from tdm_planner.cli import main


def poisoned(message: Any, evil: str) -> Any:
    """Return a copy of a message, or of a part of it, every string of which is an attack."""
    if isinstance(message, str):
        return evil
    if isinstance(message, list):
        return [poisoned(item, evil) for item in message]
    if not hasattr(message, 'get_fields_and_field_types'):
        return message
    names = message.get_fields_and_field_types()
    return type(message)(**{name: poisoned(getattr(message, name), evil) for name in names})


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
    found = []
    for number, evil in enumerate(EVIL):
        when = START + number * SECOND // 10
        for node in (f'/robots/{evil}', '/robots/planner', f'/{evil}'):
            names = {'plan id': '1', f'margin of {evil}': '-0.5', evil: evil, 'cost': evil}
            told = status(when, node, 1 + number % 2, f'{evil} {node}', **names)
            told.status[0].name = f'{node}: {evil}'
            found.append(Item('/diagnostics', when, told))
        found.append(Item('/rosout', when, log(when, 40, f'robots.{evil}', f'said {evil}')))
    worst = dict.fromkeys(EVIL, -0.5)
    check = {'worst': worst, 'worst_times': worst, 'reasons': EVIL, 'terminal_error': worst}
    vehicle = {'interpolation': 'linear', 'units': {'x': '<b id=x>', 'thrust': '</script>'}}
    message = summary(
        START,
        'robot_formation',
        {'method': EVIL[0], 'list': list(EVIL), EVIL[1]: list(EVIL)},
        plan_id=EVIL[2],
        summary=' '.join(EVIL),
        vehicles=dict.fromkeys([*EVIL, 'robot2'], vehicle),
        verification=check | {'units': dict.fromkeys([*EVIL, 'thrust'], '<i>')},
        cost_terms=worst,
        **{evil: {evil: [evil]} for evil in EVIL},
    )
    return [*found, Item('/robots/plan_summary', START - SECOND, message)]


def robots_of_evil_names() -> list[Item]:
    """Return the recording with a robot, its topics and frames, that is called an attack."""
    found = []
    for item in without(robot_recording(), '/plan_summary'):
        found.append(item._replace(topic=item.topic.replace('robot1', EVIL[1])))
    return found


@pytest.mark.parametrize('robots', [True, False])
def test_no_string_of_a_recording_becomes_markup(
    tmp_path: Path, robots: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of robots, their planner and another one; or of planners in two evil namespaces."""
    one, other = (pendulum_recording(f'/{evil}') for evil in EVIL[:2])
    items = [*robots_of_evil_names(), *what_nodes_say()] if robots else one
    write(tmp_path / 'bag', with_strangers([*items, *without(other, '/trajectory')]))
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
    data, *others = (text for _, text in page.scripts)
    assert '<' not in data
    assert not any('hacked' in text for text in others)
    texts = [*page.texts, data.replace(r'\u003c', '<').replace(r'\u003e', '>')]
    for evil in EVIL if robots else EVIL[1:2]:
        assert any(form in text for text in texts for form in (evil, json.dumps(evil)[1:-1])), evil
