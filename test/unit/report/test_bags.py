# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A recording as a mission: all that is in it, what is missing, damage and attacks in strings."""

import itertools
import json
from pathlib import Path
import shutil
import sqlite3
from typing import Any

from action_msgs.msg import GoalStatusArray
import missions
from missions import after, EVIL, Item, pendulum_recording, robot_recording, START, told, without
import numpy as np
import pytest
from std_msgs.msg import String
from tdm_planner.cli import main
from tdm_planner.exceptions import TdmError
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.tracker_plans import goal_status
from tdm_planner.plan_files import UnusableFile
from tdm_sim.report.comparison import compare
from tdm_sim.report.mission import Level
from tdm_sim.report.reader import read_mission
from trajectory_msgs.msg import JointTrajectory


@pytest.fixture
def read(tmp_path: Path) -> Any:
    number = itertools.count()
    return lambda items: read_mission(missions.write(tmp_path / f'bag{next(number)}', items))


@pytest.mark.parametrize(
    'storage', ['mcap', 'mcap storage', 'mcap message', 'mcap file', 'sqlite3', 'sqlite3 file']
)
def test_every_storage_and_compression(tmp_path: Path, storage: str) -> None:
    bag = missions.write(tmp_path / 'bag', pendulum_recording(), *storage.split())
    once = read_mission(bag / 'metadata.yaml')
    (file,) = (path for path in bag.iterdir() if path.suffix != '.yaml')
    copy = file.with_name(f'copy_of_{file.name}')
    copy.write_bytes(file.read_bytes())
    mission = read_mission(bag / 'metadata.yaml')
    missions.check_pendulum(mission)
    assert mission.missing == ()
    assert mission.vehicles[0].states.times.size == once.vehicles[0].states.times.size
    copy.unlink()
    # A folder whose recorder was killed has no metadata: its file alone, or within the folder.
    (bag / 'metadata.yaml').unlink()
    before = file.read_bytes()
    for path in (bag, file):
        missions.check_pendulum(read_mission(path))
    assert (list(bag.iterdir()), file.read_bytes()) == ([file], before)  # originals stay


def test_the_yaw_of_robots_is_that_of_an_attitude_counted_on_the_planned_turn(read: Any) -> None:
    items = robot_recording('/field/robots')
    for item in items:
        if item.topic.endswith('/odom') and item.stamp > after(1.0):
            attitude = item.message.pose.pose.orientation
            attitude.z, attitude.w = -attitude.z, -attitude.w
    mission = read(items)
    missions.check_vehicles(mission, missions.formation_mission())
    assert mission.figures[0].cost_terms == {'time': 0.5, 'sequence': 0.25, 'gas': 0.5}
    assert '/field/robots/robot1/joint_command is not in the recording' in mission.missing[0]


@pytest.mark.parametrize(
    ('recorded', 'topic', 'sentence', 'absent'),
    [
        (pendulum_recording, 'joint_states', 'motion is not known', {'states', 'applied'}),
        (pendulum_recording, 'joint_command', 'commands are not known', set()),
        (pendulum_recording, 'trajectory', 'There is no plan of pendulum in the', {'plans'}),
        (pendulum_recording, 'plan_summary', 'cost nor limits of the plans are known', set()),
        (robot_recording, 'odom', 'odom', {'states'}),
        (robot_recording, 'joint_states', 'joint_states', {'applied'}),
        (robot_recording, 'trajectory', 'no plan', {'plans'}),
        (robot_recording, 'plan_summary', 'plan_summary', set()),
    ],
)
def test_what_is_missing_is_said(read, recorded, topic, sentence, absent):
    mission = read(without(recorded(), f'/{topic}'))
    assert told(mission, sentence)
    comparison = compare(mission)
    assert all(e.achieved is None or np.isfinite(e.achieved) for e in comparison.entries)
    assert not absent or comparison.verdict is None
    for vehicle in mission.vehicles:
        parts = ('states', 'applied', 'plans')
        assert {part for part in parts if not getattr(vehicle, part)} == absent
        if vehicle.view.place and vehicle.states:
            assert ('alpha' in vehicle.states.columns) == (topic != 'joint_states')


def test_values_that_are_not_finite_and_stamps_of_another_time_are_left_out(read: Any) -> None:
    items = pendulum_recording()
    bad = [item for item in items if item.topic.endswith('joint_states')][200:203]
    for item, value in zip(bad, (np.nan, np.inf, -np.inf), strict=True):
        item.message.position[1] = value  # of the pendulum
    old = missions.joint_state(10**9, ('pendulum', 'disk'), position=[0.0] * 2, velocity=[0.0] * 2)
    mission = read([*items, Item('/pendulum/joint_states', START, old)])
    states = mission.vehicles[0].states
    assert states.times.size == 500 - 3
    assert np.isfinite(states.table(states.columns)).all()
    assert mission.vehicles[0].applied.times.size == 500
    assert told(mission, '3 message(s) lack what is measured, or hold values that are not finite')
    assert -1.1 < mission.span[0] < mission.span[1] < 4.1


@pytest.mark.parametrize('left_out', [('trajectory', 'plan_summary'), ('plan_summary',)])
def test_a_stamp_of_zero_is_the_time_at_which_it_was_recorded(read: Any, left_out: tuple) -> None:
    items = [i for i in pendulum_recording() if i.topic.rpartition('/')[2] not in left_out]
    for item in items:
        item.message.header.stamp = to_stamp(0)
    mission = read(items)
    planned = 'trajectory' not in left_out
    assert len(mission.vehicles[0].plans) == planned
    begun = min(item.stamp for item in items if 'traj' in item.topic or not planned)
    assert mission.recorded_at == pytest.approx(begun * 1e-9)
    assert -10.0 < mission.span[0] <= 0.0 < mission.span[1] < 10.0


def test_summaries_that_cannot_be_read_are_told_of(read: Any) -> None:
    nested, huge = String(data='[' * 100_000), missions.summary(after(0.1), 'x', {}, cost=10**400)
    wrong = missions.summary(after(0.1), 'x', {}, vehicles={'a': [1]})
    strange = [Item('/pendulum/plan_summary', START, said) for said in (nested, huge, wrong)]
    mission = read([*pendulum_recording(), *strange])
    assert len(mission.figures) == 1
    assert told(mission, 'a summary of a plan cannot be read')


def said(seconds: float, level: int, text: str, node: str = '/pendulum/planner'):
    at = after(seconds)
    return Item('/diagnostics', at, missions.status(at, node, level, text))


def replanned() -> list[Item]:
    (again,) = (item for item in pendulum_recording() if item.topic.endswith('trajectory'))
    again.message.header.stamp = to_stamp(after(0.5))
    return [*pendulum_recording(), again._replace(stamp=after(0.1))]


def test_a_trajectory_that_became_empty_is_no_plan(read: Any) -> None:
    """The planner drops its plan where simulated time is set back."""
    plain = read(pendulum_recording())
    dropped = Item('/pendulum/trajectory', after(1.0), JointTrajectory())
    mission = read([*pendulum_recording(), dropped])
    assert mission.missing == plain.missing
    assert len(mission.vehicles[0].plans) == 1


@pytest.mark.parametrize('published', [0.1, 0.6])
def test_replans_are_in_force_one_after_the_other(read: Any, published: float) -> None:
    about = missions.summary(after(0.5), 'pendulum_swing_up', {}, plan_id=2)
    mission = read([*replanned(), Item('/pendulum/plan_summary', after(published), about)])
    plans = mission.vehicles[0].plans
    assert [(plan.start, plan.until) for plan in plans] == [(0.0, 0.5), (0.5, None)]
    assert [figures.late for figures in mission.figures] == [False, published > 0.5]
    assert mission.parameters['limits.torque'] == 0.02  # of the plan that says it


@pytest.mark.parametrize(('codes', 'plans'), {'124': 2, '125': 2, '1': 2, '15': 1, '6': 1}.items())
def test_plans_that_the_tracker_never_began_do_not_count(read, codes, plans):
    answers = ([goal_status(after(0.5), int(code))] for code in codes)
    told_of = [GoalStatusArray(status_list=answer) for answer in answers]
    named = [Item('/pendulum/tracker_status', START + k, told) for k, told in enumerate(told_of)]
    about = missions.summary(after(0.5), 'pendulum_swing_up', {'limits.torque': 0.03}, plan_id=2)
    mission = read([*replanned(), *named, Item('/pendulum/plan_summary', after(0.1), about)])
    assert len(mission.vehicles[0].plans) == plans
    assert told(mission, 'rejected by the tracker') == (plans == 1)
    # nor do their figures, and the goal and limits of their problem
    assert len(mission.figures) == plans
    assert mission.parameters['limits.torque'] == (0.02 if plans == 1 else 0.03)


def test_events_are_told_once_and_in_order(read: Any) -> None:
    items = pendulum_recording()
    items += [said(-0.9, 0, 'planning'), said(-0.5, 0, 'plan 1 active')]
    items += [said(at, 1, 'NO_STATE: none') for at in (-0.8, -0.7)]
    items.append(said(0.6, 0, 'a stranger is well', '/camera'))
    items.append(said(0.7, 2, 'a stranger is ill', '/camera'))
    mission = read(items)
    assert [(round(e.time, 3), e.level, e.text) for e in mission.events] == [
        (-0.8, Level.WARN, 'NO_STATE: none'),
        (-0.5, Level.OK, 'plan 1 active'),
        (0.7, Level.ERROR, 'a stranger is ill'),
    ]


def test_the_planner_asked_for_of_two(tmp_path: Path) -> None:
    bag = missions.write(tmp_path / 'bag', [*pendulum_recording(''), *robot_recording()])
    robots = read_mission(bag, namespace='robots/')
    assert [vehicle.view.place for vehicle in robots.vehicles] == [('x', 'y')] * 2
    missions.check_pendulum(read_mission(bag, namespace='/'))
    for namespace in (None, '/x'):
        with pytest.raises(UnusableFile, match='plants in /, /robots: choose one of them'):
            read_mission(bag, namespace=namespace)


@pytest.mark.parametrize(('storage', 'share'), [('mcap', 0.5), ('sqlite3', 0.95)])
def test_a_recording_cut_short_is_read_as_far_as_it_goes(tmp_path, storage, share):
    random = np.random.default_rng(1)  # 3 MB of other messages, so that a file has several blocks
    times = [START + k * 10**7 for k in range(-50, 250)]
    others = [Item('/chatter', t, String(data=random.bytes(5000).hex())) for t in times]
    bag = missions.write(tmp_path / 'bag', [*pendulum_recording(), *others], storage)
    (file,) = (path for path in bag.iterdir() if path.suffix != '.yaml')
    copy = file.with_name(f'cut_{file.name}')
    copy.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    mission = read_mission(copy)
    assert told(mission, 'cut short') or told(mission, 'damaged')
    assert mission.vehicles[0].plans
    times = mission.vehicles[0].states.times
    assert times[0] == pytest.approx(-1.0)
    assert 0.4 * share < times.size / 500 < 1.0


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_damage_anywhere_is_read_around_or_refused(tmp_path: Path, storage: str) -> None:
    bag = missions.write(tmp_path / 'bag', robot_recording(), storage)
    (file,) = (path for path in bag.iterdir() if path.suffix != '.yaml')
    whole, random = file.read_bytes(), np.random.default_rng(3)
    damaged, outcomes = tmp_path / file.name, set()
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
    bag = missions.write(tmp_path / 'bag', pendulum_recording(), 'sqlite3')
    live, killed = bag / 'bag.db3', tmp_path / 'killed.db3'
    database = sqlite3.connect(live, isolation_level=None)
    database.execute('PRAGMA journal_mode=WAL')
    rows = database.execute('SELECT * FROM messages').fetchall()
    database.execute('DELETE FROM messages')
    database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
    places = ', '.join('?' * len(rows[0]))
    database.executemany(f'INSERT INTO messages VALUES ({places})', rows)
    for ending in ('', '-wal'):
        shutil.copyfile(f'{live}{ending}', f'{killed}{ending}')  # as a killed recorder leaves it
    database.close()
    missions.check_pendulum(read_mission(killed))


FOREIGN = [
    Item('/odom', START, missions.odometry(START, 'base', [0.0] * 6, 'odom')),
    Item('/joint_states', START, missions.joint_state(START, ('a', 'b'), position=[0.0, 1.0])),
    Item('/chatter', START, String(data='hello')),
]


def garbage(path: Path, name: str, data: bytes) -> Path:
    path.mkdir()
    (path / name).write_bytes(data)
    return path / name


def damaged_schema(path: Path) -> Path:
    file = missions.write(path, pendulum_recording(), 'sqlite3') / 'a.db3'
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
        (lambda p: missions.write(p, FOREIGN), 'holds nothing of a planner, .* topics are /'),
        (lambda p: missions.write(p, []), 'it holds no messages'),
    ],
)
def test_what_is_no_recording_of_ours_is_refused_in_one_sentence(tmp_path, make, sentence):
    with pytest.raises(TdmError, match=sentence) as caught:
        read_mission(make(tmp_path / 'a'))
    assert '\n' not in str(caught.value)


def poisoned(message: Any, evil: str) -> Any:
    if isinstance(message, str):
        return evil
    if isinstance(message, list):
        return [poisoned(item, evil) for item in message]
    if not hasattr(message, 'get_fields_and_field_types'):
        return message
    names = message.get_fields_and_field_types()
    return type(message)(**{name: poisoned(getattr(message, name), evil) for name in names})


def with_strangers(items: list[Item]) -> list[Item]:
    found = list(items)
    for topic, last in {item.topic: item for item in without(items, 'plan_summary')}.items():
        for number, evil in enumerate(EVIL):
            message, at = poisoned(last.message, evil), START + number * 10**7
            found.append(Item(topic, at, message))
            found.append(Item(f'/{evil}/{topic.split("/")[-1]}', at, message))
    return found


def what_nodes_say() -> list[Item]:
    found = []
    for number, evil in enumerate(EVIL):
        when = START + number * 10**8
        for node in (f'/robots/{evil}', '/robots/planner', f'/{evil}'):
            names = {'plan id': '1', f'margin of {evil}': '-0.5', evil: evil, 'cost': evil}
            told = missions.status(when, node, 1 + number % 2, f'{evil} {node}', **names)
            told.status[0].name = f'{node}: {evil}'
            found.append(Item('/diagnostics', when, told))
    worst = dict.fromkeys(EVIL, -0.5)
    check = {'worst': worst, 'worst_times': worst, 'reasons': EVIL, 'terminal_error': worst}
    units = {'x': '<b id=x>', 'thrust': '</script>'}
    vehicle = {'interpolation': 'linear', 'units': units, 'states': ['x', 'u'], 'controls': EVIL}
    vehicle['joints'] = {evil: {'position': 'x', 'effort': evil} for evil in EVIL}
    more = {'plan_id': EVIL[2], 'summary': ' '.join(EVIL), 'cost_terms': worst}
    more['vehicles'] = dict.fromkeys([*EVIL, 'robot2'], vehicle)
    more['verification'] = check | {'units': dict.fromkeys([*EVIL, 'thrust'], '<i>')}
    more |= {evil: {evil: [evil]} for evil in EVIL}
    parameters = {'method': EVIL[0], 'list': list(EVIL), EVIL[1]: list(EVIL)}
    message = missions.summary(START, 'robot_formation', parameters, **more)
    return [*found, Item('/robots/plan_summary', START - missions.SECOND, message)]


@pytest.mark.parametrize('robots', [True, False])
def test_no_string_of_a_recording_becomes_markup(tmp_path, robots, capsys):
    items, other = (pendulum_recording(f'/{evil}') for evil in EVIL[:2])
    if robots:  # one of them is called an attack
        named = without(robot_recording(), '/plan_summary')
        items = [item._replace(topic=item.topic.replace('robot1', EVIL[1])) for item in named]
        items += what_nodes_say()
    items += without(other, '/trajectory')
    bag, file = missions.write(tmp_path / 'bag', with_strangers(items)), tmp_path / 'report.html'
    space = 'robots' if robots else EVIL[0]
    words = ['report', str(bag), '-o', str(file), '--quiet', '--namespace']
    assert main([*words, '/x']) == 2
    assert main([*words, space]) == 0
    assert 'Traceback' not in capsys.readouterr().err
    page = missions.Parts(file.read_text())
    for tag, attributes in page.elements:
        assert tag not in ('img', 'iframe', 'object', 'embed', 'base', 'form', 'i')
        assert not [name for name in attributes if name.startswith('on')]
        assert not [v for n, v in attributes.items() if 'javascript:' in (v or '')]
        assert attributes.get('id') != 'x'
    data, library, own = (text for _, text in page.scripts)
    assert '<' not in data
    assert 'hacked' not in library + own
    texts = [*page.texts, data.replace(r'\u003c', '<').replace(r'\u003e', '>')]
    for evil in EVIL if robots else EVIL[:1]:
        assert any(form in text for text in texts for form in (evil, json.dumps(evil)[1:-1])), evil


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_file_that_may_not_be_read_is_not_called_damaged(storage, tmp_path, monkeypatch):
    bag = missions.write(tmp_path / 'bag', pendulum_recording(), storage)
    begin = Path.open

    def denied(self, mode='r', *given, **more):
        if mode == 'rb':
            raise PermissionError(13, 'Permission denied', str(self))
        return begin(self, mode, *given, **more)

    monkeypatch.setattr(Path, 'open', denied)
    with pytest.raises(UnusableFile, match=r'bag\.\w+ cannot be read: Permission denied$'):
        read_mission(bag)
