# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings that are damaged, cut short, of others, or whose strings are attacks."""

from __future__ import annotations

import json
from pathlib import Path
import shutil
import sqlite3
from typing import Any

from missions import EVIL, Parts
import numpy as np
import pytest
from recordings import (
    check_pendulum,
    filling,
    Item,
    joint_state,
    log,
    odometry,
    pendulum_recording,
    robot_recording,
    SECOND,
    START,
    status,
    summary,
    told,
    without,
    write,
)
from std_msgs.msg import String
from tdm_planner.cli import main
from tdm_planner.exceptions import TdmError
from tdm_sim.report.comparison import compare
from tdm_sim.report.reader import read_mission


def cut(file: Path, size: int) -> Path:
    """Return a copy of the first bytes of a recording's file."""
    copy = file.with_name(f'cut_{file.name}')
    copy.write_bytes(file.read_bytes()[:size])
    return copy


@pytest.mark.parametrize(('storage', 'share'), [('mcap', 0.5), ('sqlite3', 0.95)])
def test_a_recording_cut_short_is_read_as_far_as_it_goes(tmp_path, storage, share):
    bag = write(tmp_path / 'bag', [*pendulum_recording(), *filling()], storage)
    (bag / 'metadata.yaml').unlink()
    (file,) = bag.iterdir()
    mission = read_mission(cut(file, int(share * file.stat().st_size)))
    assert told(mission, 'cut short') or told(mission, 'damaged')
    (vehicle,) = mission.vehicles
    assert vehicle.plans
    assert vehicle.states is not None
    assert vehicle.states.times[0] == pytest.approx(-1.0)
    assert 0.4 * share < vehicle.states.times.size / 500 < 1.0


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_damage_anywhere_is_read_around_or_refused(tmp_path: Path, storage: str) -> None:
    bag = write(tmp_path / 'bag', robot_recording(), storage)
    (file,) = (path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    whole, random = file.read_bytes(), np.random.default_rng(3)
    damaged = tmp_path / file.name
    outcomes = set()
    for count in (1, 10, 100, 1000) * 2:
        data = np.frombuffer(whole, dtype=np.uint8).copy()
        data[random.integers(0, data.size, count)] = random.integers(0, 256, count)
        damaged.write_bytes(data.tobytes())
        try:
            with np.errstate(all='ignore'):
                outcomes.add(bool(compare(read_mission(damaged)).entries))
        except TdmError as error:
            assert '\n' not in str(error)
    assert True in outcomes


def test_what_sqlite_had_not_yet_moved_into_its_file_is_read(tmp_path: Path) -> None:
    """A recorder that is killed leaves a write-ahead log beside the database."""
    bag = write(tmp_path / 'bag', pendulum_recording(), 'sqlite3')
    live, killed = tmp_path / 'live.db3', tmp_path / 'killed.db3'
    shutil.copyfile(bag / 'bag.db3', live)
    database = sqlite3.connect(live)
    database.execute('PRAGMA journal_mode=WAL')
    rows = database.execute('SELECT topic_id, timestamp, data FROM messages').fetchall()
    database.execute('DELETE FROM messages')
    database.commit()
    database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
    insert = 'INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)'
    database.executemany(insert, rows)
    database.commit()
    for ending in ('', '-wal'):
        shutil.copyfile(f'{live}{ending}', f'{killed}{ending}')
    database.close()
    check_pendulum(read_mission(killed))


def foreign() -> list[Item]:
    joints = joint_state(START, ('wheel_left', 'wheel_right'), position=[0.0, 1.0])
    return [
        Item('/odom', START, odometry(START, 'base', [0.0] * 6, 'odom')),
        Item('/joint_states', START, joints),
        Item('/chatter', START, String(data='hello')),
    ]


def garbage(path: Path, name: str, data: bytes) -> Path:
    path.mkdir()
    (path / name).write_bytes(data)
    return path / name


def damaged_schema(path: Path) -> Path:
    file = write(path, pendulum_recording(), 'sqlite3') / 'a.db3'
    file.write_bytes(file.read_bytes().replace(b'CREATE TABLE topics', b'CREATE TA\x95LE topics'))
    return file


@pytest.mark.parametrize(
    ('make', 'sentence'),
    [
        (lambda p: p / 'nothing', 'there is no file or folder'),
        (lambda p: garbage(p, 'x.txt', b'hi').parent, 'is no recording: it holds neither'),
        (lambda p: garbage(p, 'x.txt', b'hi'), 'is no recording: a report is made of'),
        (lambda p: garbage(p, 'old.bag', b'#ROSBAG V2.0'), 'is a bag of ROS 1: convert it'),
        (lambda p: garbage(p, 'x.mcap', b''), 'nothing can be read from the recording'),
        (lambda p: garbage(p, 'x.mcap', bytes(range(256)) * 9), 'not a valid MCAP file'),
        (lambda p: garbage(p, 'x.db3', bytes(range(256)) * 9), 'file is not a database'),
        (lambda p: garbage(p, 'x.db3.zstd', b'(\xb5/\xfdxx'), 'nothing can be read'),
        (lambda p: garbage(p, 'metadata.yaml', b'{: [').parent, 'nothing can be read'),
        (damaged_schema, 'nothing can be read'),
        (lambda p: write(p, foreign()), 'holds nothing of a planner, .* topics are /'),
        (lambda p: write(p, []), 'it holds no messages'),
    ],
)
def test_what_is_no_recording_of_ours_is_refused_in_one_sentence(tmp_path, make, sentence):
    with pytest.raises(TdmError, match=sentence) as caught:
        read_mission(make(tmp_path / 'a'))
    assert '\n' not in str(caught.value)


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
def test_no_string_of_a_recording_becomes_markup(tmp_path, robots, capsys):
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
