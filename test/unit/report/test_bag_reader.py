# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A recording as a mission: all that is in it, what is missing, and of damage what is left."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import itertools
from pathlib import Path
from typing import Any

from missions import formation_mission
import numpy as np
import pytest
from recordings import (
    after,
    check_pendulum,
    check_vehicles,
    goal,
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
from tdm_sim.report.bag_files import UnreadableRecording
from tdm_sim.report.mission import Mission, Severity
from tdm_sim.report.reader import read_mission
from trajectory_msgs.msg import JointTrajectory

Read = Callable[[Iterable[Item]], Mission]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Return what reads a mission from messages."""
    number = itertools.count()
    return lambda items: read_mission(write(tmp_path / f'bag{next(number)}', items))


@pytest.mark.parametrize(
    'storage', ['mcap', 'mcap storage', 'mcap message', 'mcap file', 'sqlite3', 'sqlite3 file']
)
def test_every_storage_and_compression(tmp_path: Path, storage: str) -> None:
    bag = write(tmp_path / 'bag', pendulum_recording(), *storage.split())
    mission = read_mission(bag / 'metadata.yaml')
    check_pendulum(mission)
    assert mission.missing == ()
    # A folder whose recorder was killed has no metadata: its file alone, or within the folder.
    (bag / 'metadata.yaml').unlink()
    (file,) = bag.iterdir()
    before = file.read_bytes()
    for path in (bag, file):
        check_pendulum(read_mission(path))
    assert (list(bag.iterdir()), file.read_bytes()) == ([file], before)  # originals stay


def test_robots(read: Read) -> None:
    """Their yaw is that of an attitude, counted on the planned turn."""
    items = robot_recording('/field/robots')
    for item in items:
        if item.topic.endswith('/odom') and item.stamp > after(1.0):
            attitude = item.message.pose.pose.orientation
            attitude.z, attitude.w = -attitude.z, -attitude.w
    mission = read(items)
    check_vehicles(mission, formation_mission())
    assert mission.figures[0].cost_terms == {'time': 0.5, 'sequence': 0.25, 'gas': 0.5}
    assert '/field/robots/robot1/joint_command is not in the recording' in mission.missing[0]


# What is missing, strange or hostile


@pytest.mark.parametrize(
    ('recorded', 'topic', 'sentence', 'absent'),
    [
        (pendulum_recording, 'joint_states', 'motion is not known', {'states', 'applied'}),
        (pendulum_recording, 'joint_command', 'commands are not known', set()),
        (pendulum_recording, 'tracking_error', 'errors are those of states and plans', set()),
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
    for vehicle in mission.vehicles:
        parts = ('states', 'applied', 'plans')
        assert {part for part in parts if getattr(vehicle, part) in (None, ())} == absent
        if vehicle.view.place and vehicle.states is not None:
            assert ('alpha' in vehicle.states) == (topic != 'joint_states')


def test_values_that_are_not_finite_and_stamps_of_another_time_are_left_out(read: Read) -> None:
    items = pendulum_recording()
    bad = [item for item in items if item.topic.endswith('joint_states')][200:203]
    for item, value in zip(bad, (np.nan, np.inf, -np.inf), strict=True):
        item.message.position[1] = value  # of the pendulum
    old = joint_state(10**9, ('pendulum', 'disk'), position=[0.0, 0.0], velocity=[0.0, 0.0])
    mission = read([*items, Item('/pendulum/joint_states', START, old)])
    states = mission.vehicles[0].states
    assert states is not None
    assert np.isnan(states.column('theta')).sum() == 3
    assert np.isfinite(states.column('psi')).all()
    assert told(mission, '3 message(s) hold values that are not finite')
    start, end = mission.span
    assert -1.1 < start < end < 4.1


def test_hostile_contents_are_data(read: Read) -> None:
    text = '<script>alert(1)</script>\x1b[31m\n../../etc/passwd' + 'A' * 5000
    at, short = after(0.1), b'\x00\x01\x00\x00\x01'
    more = {'plan_id': text, 'cost': float('nan'), 'summary': text, 'vehicles': {text: [1]}}
    more['verification'] = {'worst': {text: 'x', 'y': float('inf')}}
    evil = summary(at, text, {text: text, 'a': {'b': 1}, 'big': 10**400}, **more)
    joints = joint_state(1, ('x',) * 3)
    mission = read(
        [
            *pendulum_recording(),
            said(0.1, 100, text),
            Item('/pendulum/plan_summary', at, evil),
            Item('/pendulum/plan_summary', at + 1, String(data='[' * 100_000)),
            Item('/pendulum/joint_states', at, joints, short + b'\xff' * 60),
            Item('/pendulum/joint_states', 1, joints),
            Item('/pendulum/trajectory', at, JointTrajectory(), short),
        ]
    )
    assert len(mission.vehicles[0].plans) == 1
    strings = [e.text for e in mission.events] + list(mission.missing)
    strings += [f.summary for f in mission.figures]
    assert all(s.isprintable() and len(s) < 700 for s in strings)
    assert mission.events[0].level == Severity.STALE
    assert mission.figures[-1].cost is None
    assert mission.figures[-1].margins == {}
    assert told(mission, 'cannot be read')
    assert told(mission, 'do not match their type')


# Plans, figures and events


def said(seconds: float, level: int, text: str, node: str = '/pendulum/planner', **values: Any):
    at = after(seconds)
    return Item('/diagnostics', at, status(at, node, level, text, **values))


def replanned(second: int) -> list[Item]:
    """Return the recording with the same motion planned once more, from `second` [ns] on."""
    (again,) = (item for item in pendulum_recording() if item.topic.endswith('trajectory'))
    again.message.header.stamp.sec, again.message.header.stamp.nanosec = divmod(second, 10**9)
    return [*pendulum_recording(), again._replace(stamp=after(0.1))]


def test_replans_are_in_force_one_after_the_other(read: Read) -> None:
    second = after(0.5)
    about = summary(second, 'pendulum_swing_up', {}, plan_id=2)
    mission = read([*replanned(second), Item('/pendulum/plan_summary', after(0.1), about)])
    first, last = mission.vehicles[0].plans
    assert (first.start, first.until) == (0.0, 0.5)
    assert (last.start, last.until) == (0.5, None)
    assert [figures.time for figures in mission.figures] == [0.0, 0.5]
    assert mission.parameters['limits.torque'] == 0.02  # of the plan that says it


@pytest.mark.parametrize(
    ('statuses', 'plans'),
    [([1, 2, 4], 2), ([1, 2, 5], 2), ([1], 2), ([1, 5], 1), ([6], 1)],
    ids=['succeeded', 'superseded', 'pending', 'superseded while pending', 'rejected'],
)
def test_plans_that_the_tracker_never_began_do_not_count(read, statuses, plans):
    second = after(0.5)
    answers = [
        Item('/pendulum/tracker_status', START + k, goal(second, one))
        for k, one in enumerate(statuses)
    ]
    mission = read([*replanned(second), *answers])
    assert len(mission.vehicles[0].plans) == plans
    assert told(mission, 'rejected by the tracker') == (plans == 1)


def test_events_are_told_once_and_in_order(read: Read) -> None:
    logged = ((-0.8, 30, 'no plan: NO_STATE: none'), (-0.4, 20, 'of no'), (0.5, 40, 'an error'))
    logs = [log(after(t), level, 'pendulum.planner', text) for t, level, text in logged]
    mission = read(
        [
            *pendulum_recording(),
            *(Item('/rosout', after(logged[k][0]), item) for k, item in enumerate(logs)),
            said(-0.9, 0, 'planning'),
            said(-0.8, 1, 'NO_STATE: none'),
            said(-0.7, 1, 'NO_STATE: none'),
            said(-0.5, 0, 'plan 1 active'),
            said(0.6, 0, 'a stranger is well', '/camera'),
            said(0.7, 2, 'a stranger is ill', '/camera'),
        ]
    )
    assert [(round(e.time, 3), e.level, e.text) for e in mission.events] == [
        (-0.8, Severity.WARN, 'NO_STATE: none'),
        (-0.5, Severity.OK, 'plan 1 active'),
        (0.5, Severity.ERROR, 'an error'),
        (0.7, Severity.ERROR, 'a stranger is ill'),
    ]


# Several planners, and others' plans


def test_the_planner_asked_for_of_two(tmp_path: Path) -> None:
    bag = write(tmp_path / 'bag', [*pendulum_recording(), *robot_recording()])
    robots = read_mission(bag)
    assert [vehicle.view.place for vehicle in robots.vehicles] == [('x', 'y')] * 2
    assert told(robots, 'also holds /pendulum')
    check_pendulum(read_mission(bag, namespace='pendulum'))
    with pytest.raises(UnreadableRecording, match=r"'/x'; it has: .*/pendulum"):
        read_mission(bag, namespace='/x')


def test_of_several_planners_the_one_that_was_followed_or_has_a_plan(read: Read) -> None:
    """A planner that did its work earlier still publishes its plans to whoever comes."""
    for absent in (('odom', 'joint_states'), ('odom',)):
        mission = read([*without(robot_recording(), *absent), *pendulum_recording('')])
        check_pendulum(mission)
        assert told(mission, 'also holds /robots')
    # robots that have long been in place: what is measured of them is after their plans
    standing = [
        Item(topic, at + 60 * SECOND, odometry(at + 60 * SECOND, 'robot1', [1.0] * 6))
        for topic, at, *_ in robot_recording()
        if topic.endswith('/odom')
    ]
    plans = without(robot_recording(), '/odom', '/joint_states')
    check_pendulum(read([*plans, *standing, *pendulum_recording()]))
    # none was followed
    idle = without(robot_recording(), '/trajectory', '/plan_summary')
    planned = without(pendulum_recording(), '/joint_states', '/joint_command', '/tracking_error')
    assert [vehicle.name for vehicle in read([*idle, *planned]).vehicles] == ['pendulum']
