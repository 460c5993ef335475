# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from pathlib import Path
import shutil
import struct

from mission_bags import (
    DURATION,
    ERROR,
    filling,
    goal,
    instants,
    Item,
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
from page_missions import pendulum_plan, pendulum_states, robot_states
import pytest
from tdm_planner.exceptions import TdmError
from tdm_sim.report.bag_files import UnreadableRecording
from tdm_sim.report.comparison import compare
from tdm_sim.report.mission import Severity
from tdm_sim.report.reader import read_mission


def check_pendulum(mission) -> None:
    """Compare with the closed form of what was recorded."""
    (vehicle,) = mission.vehicles
    assert (vehicle.name, vehicle.plant) == ('pendulum', 'pendulum')
    (plan,) = vehicle.plans
    expected = pendulum_plan()
    assert (plan.plan_id, plan.start, plan.until) == ('1', 0.0, None)
    assert plan.trajectory.interpolation == 'zero_order_hold'
    np.testing.assert_allclose(plan.trajectory.times, expected.times, atol=1e-9)
    np.testing.assert_array_equal(plan.trajectory.states, expected.states)
    np.testing.assert_array_equal(plan.trajectory.controls, expected.controls)
    states = vehicle.states
    assert states is not None
    assert states.times.size == len(instants())
    np.testing.assert_allclose(states.times, [t for t, _ in instants()], atol=1e-8)
    np.testing.assert_allclose(
        states.values,
        pendulum_states(np.clip(states.times, 0.0, DURATION)) + np.array([ERROR, 0, 0, 0]),
        atol=1e-7,
    )
    for controls in (vehicle.applied, vehicle.commands):
        assert controls is not None
        assert controls.names == ('torque',)
        assert np.abs(controls.values).max() == 0.014
    assert vehicle.tracking_error is not None
    assert vehicle.tracking_error.column('theta').tolist() == [ERROR] * len(instants())
    (figures,) = mission.figures
    assert (figures.cost, figures.solve_time, figures.evaluations) == (1.25, 0.125, 42)
    assert figures.margins['disk_angle'].instant == 2.0
    assert mission.number('limits.torque') == 0.02
    assert mission.recorded_at == pytest.approx(START * 1e-9)


@pytest.mark.parametrize(
    ('storage', 'compression'),
    [
        ('mcap', ''),
        ('mcap', 'storage'),
        ('mcap', 'message'),
        ('mcap', 'file'),
        ('sqlite3', ''),
        ('sqlite3', 'message'),
        ('sqlite3', 'file'),
    ],
)
def test_every_storage_and_compression(tmp_path: Path, storage: str, compression: str):
    bag = write(tmp_path / 'bag', pendulum_recording(), storage, compression)
    mission = read_mission(bag)
    check_pendulum(mission)
    assert mission.missing == ()
    # A folder whose recorder was killed has no metadata: its file alone, or within the folder.
    (bag / 'metadata.yaml').unlink()
    (file,) = bag.iterdir()
    for path in (bag, file):
        check_pendulum(read_mission(path))


def test_robots(tmp_path: Path):
    mission = read_mission(write(tmp_path / 'bag', robot_recording('/field/robots')))
    assert [vehicle.name for vehicle in mission.vehicles] == ['robot1', 'robot2']
    for k, vehicle in enumerate(mission.vehicles):
        (plan,) = vehicle.plans
        np.testing.assert_allclose(
            plan.trajectory.states, robot_states(plan.trajectory.times, k), atol=1e-9
        )
        assert plan.trajectory.control('thrust').tolist() == [0.5] * 21
        assert vehicle.states is not None
        expected = robot_states(np.clip(vehicle.states.times, 0.0, DURATION), k)
        expected[:, 0] += ERROR
        np.testing.assert_allclose(vehicle.states.values, expected, atol=1e-7)
        assert vehicle.applied is not None
        assert vehicle.applied.values[100].tolist() == [0.5, 0.125, 0.001]
        assert vehicle.commands is None
    assert mission.figures[0].cost_terms == {'time': 0.5, 'sequence': 0.25, 'gas': 0.5}
    assert '/field/robots/robot1/joint_command is not in the recording' in mission.missing[0]


def test_a_robots_yaw_is_counted_on_the_planned_turn(tmp_path: Path):
    items = [item for item in robot_recording() if not item.topic.endswith('odom')]
    for k, name in enumerate(('robot1', 'robot2')):
        for t, at in instants():
            state = robot_states(np.clip(t, 0.0, DURATION), k)
            state[4] += 2 * np.pi * (3 if t > 1 else 0)  # the same attitude
            message = odometry(at, name, state)
            items.append(Item(f'/robots/{name}/odom', STANDARD['Odometry'], at, message))
    for vehicle in read_mission(write(tmp_path / 'bag', items)).vehicles:
        assert vehicle.states is not None
        np.testing.assert_allclose(
            vehicle.states.column('yaw'), 0.3 * np.clip(vehicle.states.times, 0, DURATION),
            atol=1e-7,
        )  # fmt: skip


@pytest.mark.parametrize('share', [0.95, 0.5])
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_recording_cut_short_is_read_as_far_as_it_goes(
    tmp_path: Path, storage: str, share: float
):
    bag = write(tmp_path / 'bag', [*pendulum_recording(), *filling()], storage)
    (bag / 'metadata.yaml').unlink()
    (file,) = bag.iterdir()
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    mission = read_mission(file)
    assert any('cut short' in text or 'damaged' in text for text in mission.missing)
    (vehicle,) = mission.vehicles
    assert vehicle.plans
    assert vehicle.states is not None
    assert vehicle.states.times[0] == pytest.approx(-0.5)
    assert 0.4 * share < vehicle.states.times.size / len(instants()) < 1.0


def cut(file: Path, size: int) -> Path:
    """Return a copy of the first bytes of a recording's file."""
    copy = file.with_name(f'cut_{file.name}')
    copy.write_bytes(file.read_bytes()[:size])
    return copy


@pytest.mark.parametrize('compression', ['', 'storage'])
@pytest.mark.parametrize('share', [0.15, 0.3, 0.6, 0.9])
def test_of_a_block_that_is_cut_off_the_whole_messages_are_read(
    tmp_path: Path, compression: str, share: float
):
    """All of it is in the first block; of a compressed one, what its parts hold that are whole."""
    motion = [*pendulum_recording(), *filling()[:150]] if compression else pendulum_recording()
    motion = [item for item in motion if item.stamp < START + 10**9]
    bag = write(tmp_path / 'bag', motion, 'mcap', compression)
    file = bag / 'bag.mcap'
    content = file.read_bytes()
    records = content.index(b'\x06', 8)
    (size,) = struct.unpack_from('<Q', content, records + 1)
    mission = read_mission(cut(file, records + int(share * size)))
    assert any('cut short' in text for text in mission.missing)
    (vehicle,) = mission.vehicles
    assert vehicle.states is not None
    whole = read_mission(bag).vehicles[0].states
    assert whole is not None
    if not compression:
        # Definitions and the plan come first: what is measured takes up the rest, evenly.
        first = content.index(b'joint_states') - records
        expected = (share * size - first) / (size - first) * whole.times.size
        assert vehicle.states.times.size >= 0.95 * expected - 5
    assert 0 < vehicle.states.times.size < whole.times.size
    np.testing.assert_array_equal(vehicle.states.values, whole.values[: vehicle.states.times.size])


def test_a_file_cut_anywhere_gives_all_messages_before_the_cut(tmp_path: Path):
    """Of a file of several blocks."""
    from tdm_sim.report.bag_files import salvaged

    file = write(tmp_path / 'bag', [*pendulum_recording(), *filling()]) / 'bag.mcap'
    size = file.stat().st_size
    every = list(salvaged(file, lambda *_: True, []))
    total = sum(len(item.data) for item in every)
    random = np.random.default_rng(5)
    for at in random.integers(size // 50, size, 12):
        found = list(salvaged(cut(file, int(at)), lambda *_: True, []))
        assert found == every[: len(found)]
        read = sum(len(item.data) for item in found)
        # 3 % are definitions and index, 12 kB the longest message
        assert read > 0.97 * at / size * total - 50_000


def test_a_damaged_block_does_not_cost_the_others(tmp_path: Path):
    bag = write(tmp_path / 'bag', [*pendulum_recording(), *filling()], 'mcap', 'storage')
    (file,) = bag.glob('*.mcap')
    data = bytearray(file.read_bytes())
    second = data.index(b'\x28\xb5\x2f\xfd', data.index(b'\x28\xb5\x2f\xfd') + 4)
    begin, end = second + 50, second + 70
    data[begin:end] = bytes(20)
    file.write_bytes(data)
    mission = read_mission(bag)
    assert any('1 damaged block' in text for text in mission.missing)
    assert mission.vehicles[0].plans
    assert mission.vehicles[0].states is not None
    assert 0 < mission.vehicles[0].states.times.size < len(instants())


@pytest.mark.parametrize(
    ('topic', 'sentence'),
    [
        ('joint_states', 'what the plant did is not known'),
        ('joint_command', 'what the tracker asked for is not known'),
        ('tracking_error', 'errors are computed from states and plans'),
        ('trajectory', 'There is no plan of pendulum in the recording'),
        ('plan_summary', 'limits and dimensions cannot be drawn'),
    ],
)
def test_what_is_missing_is_said(tmp_path: Path, topic: str, sentence: str):
    items = without(pendulum_recording(), f'/{topic}')
    mission = read_mission(write(tmp_path / 'bag', items))
    assert [text for text in mission.missing if sentence in text]
    (vehicle,) = mission.vehicles
    assert (vehicle.states is None) == (topic == 'joint_states')
    assert (not vehicle.plans) == (topic == 'trajectory')


@pytest.mark.parametrize(
    'topic', ['odom', 'joint_states', 'trajectory', 'controls', 'plan_summary']
)
def test_robots_with_a_topic_missing(tmp_path: Path, topic: str):
    items = without(robot_recording(), f'/{topic}')
    mission = read_mission(write(tmp_path / 'bag', items))
    assert len(mission.vehicles) == 2
    assert any(topic in text or 'no plan' in text for text in mission.missing)
    for vehicle in mission.vehicles:
        assert (vehicle.states is None) == (topic == 'odom')
        assert (vehicle.applied is None) == (topic == 'joint_states')
        assert bool(vehicle.plans) == (topic != 'trajectory')
        if topic == 'controls':
            assert vehicle.plans[0].trajectory.control_names == ()
            assert 'alpha' not in vehicle.plans[0].trajectory.state_names
        if topic == 'joint_states':
            assert vehicle.states is not None
            assert 'alpha' not in vehicle.states


def test_figures_from_diagnostics_where_there_is_no_summary(tmp_path: Path):
    said = status(
        START + 10**8, '/pendulum/planner', 0, 'plan 3 in force', problem='pendulum_swing_up',
        plan_id='3', cost='1.5',
    )  # fmt: skip
    said.status[0].values[1].key = 'plan id'
    items = [
        *without(pendulum_recording(), 'plan_summary'),
        Item('/diagnostics', STANDARD['DiagnosticArray'], START + 10**8, said),
    ]
    mission = read_mission(write(tmp_path / 'bag', items))
    assert mission.problem == 'pendulum_swing_up'
    (figures,) = mission.figures
    assert (figures.plan_id, figures.cost, figures.time) == ('3', 1.5, 0.0)
    assert mission.vehicles[0].plans[0].plan_id == '3'


def test_requests_count_from_the_first_plan_on(tmp_path: Path):
    def said(seconds: float, plan: int, requests: int, failures: int) -> Item:
        at = START + round(seconds * 1e9)
        values = {'plan_id': plan, 'requests': requests, 'failures': failures}
        text = {name: str(value) for name, value in values.items()}
        message = status(at, '/pendulum/planner', 0, 'ready', **text)
        return Item('/diagnostics', STANDARD['DiagnosticArray'], at, message)

    # asked twice before the pendulum was there, and once in vain after the plan
    early = [said(-0.4, 0, 0, 0), said(-0.3, 0, 2, 2)]
    late = [said(-0.2, 1, 3, 2), said(0.5, 1, 4, 3)]
    mission = read_mission(write(tmp_path / 'a', [*pendulum_recording(), *early, *late]))
    assert mission.counters == {'requests': 1, 'failures': 1}
    mission = read_mission(write(tmp_path / 'b', [*pendulum_recording(), *early]))
    assert mission.counters == {'requests': 2, 'failures': 2}


def replanned(second: int) -> list[Item]:
    """Return the recording with the same motion planned once more, from `second` [ns] on."""
    items = pendulum_recording()
    for item in pendulum_recording()[:2]:
        if item.topic.endswith('trajectory'):
            item.message.header.stamp.sec = second // 10**9
            item.message.header.stamp.nanosec = second % 10**9
            items.append(item._replace(stamp=START + 10**8))
    return items


def test_replans_are_in_force_one_after_the_other(tmp_path: Path):
    second = START + 5 * 10**8
    items = replanned(second)
    items.append(
        Item('/pendulum/plan_summary', STANDARD['String'], START + 10**8,
             summary(second, 'pendulum_swing_up', {}, plan_id=2))
    )  # fmt: skip
    mission = read_mission(write(tmp_path / 'bag', items))
    first, last = mission.vehicles[0].plans
    assert (first.plan_id, first.start, first.until) == ('1', 0.0, 0.5)
    assert (last.plan_id, last.start, last.until) == ('2', 0.5, None)
    assert [figures.time for figures in mission.figures] == [0.0, 0.5]
    assert mission.number('limits.torque') == 0.02  # of the plan that says it


@pytest.mark.parametrize(
    ('statuses', 'plans'),
    [([1, 2, 4], 2), ([1, 2, 5], 2), ([1], 2), ([1, 5], 1), ([6], 1)],
    ids=['succeeded', 'superseded', 'pending', 'superseded while pending', 'rejected'],
)
def test_plans_that_the_tracker_never_began_do_not_count(
    tmp_path: Path, statuses: list[int], plans: int
):
    second = START + 5 * 10**8
    told = [
        Item('/pendulum/tracker_status', STANDARD['GoalStatusArray'], START + k, goal(second, one))
        for k, one in enumerate(statuses)
    ]
    mission = read_mission(write(tmp_path / 'bag', [*replanned(second), *told]))
    assert len(mission.vehicles[0].plans) == plans
    assert any('rejected by the tracker' in text for text in mission.missing) == (plans == 1)


def test_events_are_told_once_and_in_order(tmp_path: Path):
    def said(seconds: float, level: int, text: str, node: str = '/pendulum/planner') -> Item:
        at = START + round(seconds * 1e9)
        return Item('/diagnostics', STANDARD['DiagnosticArray'], at, status(at, node, level, text))

    def logged(seconds: float, level: int, text: str) -> Item:
        at = START + round(seconds * 1e9)
        return Item('/rosout', STANDARD['Log'], at, log(at, level, 'pendulum.planner', text))

    items = [
        *pendulum_recording(),
        said(-0.9, 0, 'planning'),
        said(-0.8, 1, 'NO_STATE: none'),
        logged(-0.8, 30, 'no plan: NO_STATE: none'),
        said(-0.7, 1, 'NO_STATE: none'),
        said(-0.5, 0, 'plan 1 in force'),
        logged(-0.4, 20, 'of no interest'),
        logged(0.5, 40, 'an error'),
        said(0.6, 0, 'a stranger is well', '/camera'),
        said(0.7, 2, 'a stranger is ill', '/camera'),
    ]
    mission = read_mission(write(tmp_path / 'bag', items))
    assert [(round(e.time, 3), e.level, e.text) for e in mission.events] == [
        (-0.8, Severity.WARN, 'NO_STATE: none'),
        (-0.5, Severity.OK, 'plan 1 in force'),
        (0.5, Severity.ERROR, 'an error'),
        (0.7, Severity.ERROR, 'a stranger is ill'),
    ]


def test_values_that_are_not_finite_are_left_out(tmp_path: Path):
    items = pendulum_recording()
    bad = [item for item in items if item.topic.endswith('joint_states')][200:203]
    for item, value in zip(bad, (np.nan, np.inf, -np.inf), strict=True):
        item.message.position[0] = value
    mission = read_mission(write(tmp_path / 'bag', items))
    states = mission.vehicles[0].states
    assert states is not None
    assert np.isnan(states.column('theta')).sum() == 3
    assert np.isfinite(states.column('psi')).all()
    assert any('3 message(s) hold values that are not finite' in m for m in mission.missing)


def test_hostile_contents_are_data(tmp_path: Path):
    text = '<script>alert(1)</script>\x1b[31m\n../../etc/passwd' + 'A' * 5000
    at = START + 10**8
    cut = b'\x00\x01\x00\x00\x01'
    items = [
        *pendulum_recording(),
        Item('/diagnostics', STANDARD['DiagnosticArray'], at,
             status(at, '/pendulum/planner', 100, text)),
        Item('/pendulum/plan_summary', STANDARD['String'], at,
             summary(at, text, {text: text, 'a': {'b': 1}, 'big': 10**400}, plan_id=text,
                     cost=float('nan'), summary=text, vehicles={text: [1]},
                     verification={'worst': {text: 'x', 'y': float('inf')}})),
        Item('/pendulum/plan_summary', STANDARD['String'], at + 1, made_string('[' * 100_000)),
        Item('/pendulum/joint_states', STANDARD['JointState'], at, None, cut + b'\xff' * 60),
        Item('/pendulum/joint_states', STANDARD['JointState'], 1, joint_state(1, ('x',) * 3)),
        Item('/pendulum/trajectory', STANDARD['JointTrajectory'], at, None, cut),
    ]  # fmt: skip
    mission = read_mission(write(tmp_path / 'bag', items))
    assert len(mission.vehicles[0].plans) == 1
    strings = [e.text for e in mission.events] + list(mission.missing)
    strings += [f.summary for f in mission.figures] + [f.plan_id for f in mission.figures]
    assert all(s.isprintable() and len(s) < 700 for s in strings)
    assert mission.events[0].level == Severity.STALE
    assert mission.figures[-1].cost is None
    assert mission.figures[-1].margins == {}
    assert any('cannot be read' in text for text in mission.missing)
    assert any('not what their type says' in text for text in mission.missing)


def made_string(data: str):
    from mission_bags import made

    return made('String', data=data)


def test_a_stamp_from_another_time_does_not_stretch_the_mission(tmp_path: Path):
    wrong = joint_state(10**9, ('pendulum', 'disk'), position=[0.0, 0.0], velocity=[0.0, 0.0])
    items = [
        *pendulum_recording(),
        Item('/pendulum/joint_states', STANDARD['JointState'], START, wrong),
    ]
    start, end = read_mission(write(tmp_path / 'bag', items)).span
    assert start > -1.0
    assert end < 4.0


def test_the_planner_asked_for_of_two(tmp_path: Path):
    bag = write(tmp_path / 'bag', [*pendulum_recording(), *robot_recording()])
    robots = read_mission(bag)
    assert [vehicle.plant for vehicle in robots.vehicles] == ['robot', 'robot']
    assert any('also holds /pendulum' in text for text in robots.missing)
    check_pendulum(read_mission(bag, namespace='pendulum'))
    with pytest.raises(UnreadableRecording, match=r"'/x'; it has: .*/pendulum"):
        read_mission(bag, namespace='/x')


@pytest.mark.parametrize('absent', [('odom', 'joint_states'), ('odom',)])
def test_of_two_planners_the_one_whose_plan_was_carried_out(tmp_path: Path, absent):
    """A planner that did its work earlier still publishes its plans to whoever comes."""
    earlier = [item for item in robot_recording() if not item.topic.endswith(absent)]
    mission = read_mission(write(tmp_path / 'bag', [*earlier, *pendulum_recording()]))
    check_pendulum(mission)
    assert any('also holds /robots' in text for text in mission.missing)


def test_of_two_planners_the_one_that_moved_while_it_was_recorded(tmp_path: Path):
    """The robots have long been in place: what is measured of them is after their plans."""
    late = 60 * 10**9
    standing = [
        Item(item.topic, item.type_name, item.stamp + late,
             odometry(item.stamp + late, item.topic.split('/')[-2], [1.0] * 6))
        for item in robot_recording()
        if item.topic.endswith('/odom')
    ]  # fmt: skip
    plans = without(robot_recording(), '/odom', '/joint_states')
    check_pendulum(
        read_mission(write(tmp_path / 'bag', [*plans, *standing, *pendulum_recording()]))
    )


def test_of_two_planners_that_were_not_followed_the_one_with_a_plan(tmp_path: Path):
    idle = without(robot_recording(), '/trajectory', '/controls', '/plan_summary')
    planned = without(pendulum_recording(), '/joint_states', '/joint_command', '/tracking_error')
    mission = read_mission(write(tmp_path / 'bag', [*idle, *planned]))
    assert [vehicle.name for vehicle in mission.vehicles] == ['pendulum']


def test_the_metadata_stand_for_the_recording(tmp_path: Path):
    bag = write(tmp_path / 'bag', pendulum_recording())
    check_pendulum(read_mission(bag / 'metadata.yaml'))


def test_without_a_namespace(tmp_path: Path):
    check_pendulum(read_mission(write(tmp_path / 'bag', pendulum_recording(''))))


def test_a_third_partys_plan_by_the_names_of_its_states(tmp_path: Path):
    from mission_bags import joint_plan

    times = np.linspace(0.0, 1.0, 5)
    states = np.stack([times, 0 * times], axis=1)
    plan = [
        Item('/crane/trajectory', STANDARD['JointTrajectory'], START,
             joint_plan(START, ('sway', 'rate'), times, positions=states)),
        Item('/crane/controls', STANDARD['JointTrajectory'], START,
             joint_plan(START, ('force',), times, effort=2 * times[:, None])),
        Item('/crane/plan_summary', STANDARD['String'], START,
             summary(START, 'crane', {'limits.force': 3.0},
                     vehicles={'hook': {'interpolation': 'cubic', 'units': {'sway': 'rad'}}})),
    ]  # fmt: skip
    measured = [
        Item('/crane/joint_states', STANDARD['JointState'], at,
             joint_state(at, ('rate', 'sway'), position=[0.0, t]))
        for t, at in instants()
    ]  # fmt: skip
    mission = read_mission(write(tmp_path / 'bag', plan + measured))
    (vehicle,) = mission.vehicles
    assert (vehicle.name, vehicle.plant, mission.problem) == ('hook', 'other', 'crane')
    trajectory = vehicle.plans[0].trajectory
    assert trajectory.interpolation == 'cubic'
    assert trajectory.units == {'sway': 'rad', 'rate': '', 'force': ''}
    assert trajectory.control('force').tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert vehicle.states is not None
    np.testing.assert_allclose(vehicle.states.column('sway'), vehicle.states.times, atol=1e-6)


def foreign(path: Path) -> Path:
    items = [
        Item('/odom', STANDARD['Odometry'], START, odometry(START, 'base', [0.0] * 6, 'odom')),
        Item('/joint_states', STANDARD['JointState'], START,
             joint_state(START, ('wheel_left', 'wheel_right'), position=[0.0, 1.0])),
        Item('/chatter', STANDARD['String'], START, made_string('hello')),
    ]  # fmt: skip
    return write(path, items)


def garbage(path: Path, name: str, data: bytes) -> Path:
    path.mkdir()
    (path / name).write_bytes(data)
    return path / name


@pytest.mark.parametrize(
    ('make', 'sentence'),
    [
        (lambda p: p / 'nothing', 'there is no file or folder'),
        (lambda p: garbage(p / 'a', 'x.txt', b'hi').parent, 'is no recording: it holds neither'),
        (lambda p: garbage(p / 'a', 'x.txt', b'hi'), 'is no recording: a report is made of'),
        (lambda p: garbage(p / 'a', 'old.bag', b'#ROSBAG V2.0'), 'is a bag of ROS 1: convert it'),
        (lambda p: garbage(p / 'a', 'x.mcap', b''), 'nothing can be read from the recording'),
        (lambda p: garbage(p / 'a', 'x.mcap', bytes(range(256)) * 9), 'is not an MCAP file'),
        (
            lambda p: garbage(p / 'a', 'x.db3', bytes(range(256)) * 9),
            'cannot be read as a database',
        ),
        (lambda p: garbage(p / 'a', 'x.db3.zstd', b'(\xb5/\xfdxx'), 'nothing can be read'),
        (lambda p: garbage(p / 'a', 'metadata.yaml', b'{: [').parent, 'nothing can be read'),
        (lambda p: foreign(p / 'b'), 'holds nothing of a planner, .* topics are /'),
        (lambda p: write(p / 'c', []), 'it holds no messages'),
    ],
)
def test_what_is_no_recording_of_ours_is_refused_in_one_sentence(tmp_path, make, sentence):
    with pytest.raises(TdmError, match=sentence) as caught:
        read_mission(make(tmp_path))
    assert '\n' not in str(caught.value)


def test_originals_are_not_touched(tmp_path: Path):
    bag = write(tmp_path / 'bag', pendulum_recording(), 'sqlite3', 'file')
    (bag / 'metadata.yaml').unlink()
    before = {path: path.read_bytes() for path in bag.iterdir()}
    read_mission(bag)
    assert {path: path.read_bytes() for path in bag.iterdir()} == before


def test_what_sqlite_had_not_yet_moved_into_its_file_is_read(tmp_path: Path):
    """A recorder that is killed leaves a write-ahead log beside the database."""
    import sqlite3

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


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_damage_anywhere_is_read_around_or_refused(tmp_path: Path, storage: str):
    bag = write(tmp_path / 'bag', robot_recording(), storage)
    (file,) = (path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    whole, random = file.read_bytes(), np.random.default_rng(3)
    damaged = tmp_path / file.name
    outcomes = set()
    for count in (1, 10, 100, 1000) * 3:
        data = np.frombuffer(whole, dtype=np.uint8).copy()
        data[random.integers(0, data.size, count)] = random.integers(0, 256, count)
        damaged.write_bytes(data.tobytes())
        try:
            with np.errstate(all='ignore'):
                outcomes.add(bool(compare(read_mission(damaged)).entries))
        except TdmError as error:
            assert '\n' not in str(error)
    assert True in outcomes


def test_a_database_whose_schema_is_damaged_is_refused(tmp_path: Path):
    bag = write(tmp_path / 'bag', pendulum_recording(), 'sqlite3')
    file = bag / 'bag.db3'
    file.write_bytes(file.read_bytes().replace(b'CREATE TABLE topics', b'CREATE TA\x95LE topics'))
    with pytest.raises(UnreadableRecording, match='cannot be read as a database'):
        read_mission(file)
