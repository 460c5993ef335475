# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The demo as users run it: real processes, real DDS, a bag that others can read.

Simulated time waits for the tracker: a busy machine makes a mission longer, and no other.
"""

from collections import Counter
import os
from pathlib import Path

import numpy as np
import pytest
from ros_harness import ENOUGH, Ros, SOURCE
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plan_files import load_plan
from tdm_planner.trajectory import Trajectory
import yaml

reader = pytest.importorskip('mcap_ros2.reader')
DRIFT = 0.05  # m/s
LONG = 280.0  # s for a process that ends by itself


def parameters(folder: Path, file: str, without: str = '', drifts: str = '') -> list[str]:
    """Return options for the shipped parameters, with time for a plan, less one robot."""
    document = yaml.safe_load((SOURCE / 'config' / f'{file}.yaml').read_text(encoding='utf-8'))
    planner = document['/**/planner']['ros__parameters']
    planner.setdefault('solver', {})['deadline'] = ENOUGH
    planner.setdefault('start', {})['delay'] = 3.0
    if drifts:
        planner[drifts]['start']['u'] = DRIFT
    if without:
        planner['robots'].remove(without)
        del planner[without], planner['formation'][without]
    (folder / 'unhurried.yaml').write_text(yaml.safe_dump(document))
    return ['--params', str(folder / 'unhurried.yaml')]


def demo(ros: Ros, folder: Path, *words: str, **environment: str) -> str:
    """Return what a demo says that is successful."""
    arguments = ['demo', *words, '-o', str(folder / 'out')]
    process = ros.run('tdm_planner.cli', arguments, environment)
    assert process.process.wait(LONG) == 0, process.output
    assert 'goal reached and held' in process.output
    return process.output


def messages(bag: Path, *topics: str) -> list:
    (file,) = bag.glob('*.mcap')
    return list(reader.read_ros2_messages(file, topics=topics or None))


def test_the_pendulum_is_swung_up_and_held(ros, tmp_path):
    folder = tmp_path / 'out'
    demo(ros, tmp_path, 'pendulum', '--speed=0.9', *parameters(tmp_path, 'pendulum'))
    plan = load_plan(folder / 'plan.json')
    assert plan['verification']['ok'] is True
    assert 1.0 < Trajectory.from_dict(plan).duration < 2.0
    report = (folder / 'report.html').read_text(encoding='utf-8')
    assert '<p class="verdict good">Goal reached and held' in report
    # The same verdict, from the bag alone.
    assert len(messages(folder / 'bag', '/pendulum/trajectory')) == 1
    states = [message.ros_msg for message in messages(folder / 'bag', '/pendulum/joint_states')]
    times = np.array([nanoseconds_of(state.header.stamp) for state in states]) * 1e-9
    theta = np.array([state.position[list(state.name).index('pendulum')] for state in states])
    last = theta[times > times.max() - 4.5]
    assert last.size > 100
    assert np.abs((last + np.pi) % (2 * np.pi) - np.pi).max() < 0.05


def test_the_robots_reach_their_places_and_stay(ros, tmp_path):
    given = parameters(tmp_path, 'robots', without='robot3', drifts='robot1')
    demo(ros, tmp_path, 'robots', '--speed=2', *given)
    begins = load_plan(tmp_path / 'out' / 'plan.json')['robots']['robot1']['states']['x'][0]
    start = yaml.safe_load((tmp_path / 'unhurried.yaml').read_text())['/**/planner']
    away = begins - start['ros__parameters']['robot1']['start']['x']
    assert 6.0 < away / DRIFT < 8.0  # s, of which start.delay takes 6: it does not drift before
    counts = Counter(message.channel.topic for message in messages(tmp_path / 'out' / 'bag'))
    for k in (1, 2):
        assert counts[f'/robots/robot{k}/trajectory'] == 1
        assert counts[f'/robots/robot{k}/odom'] > 100


def test_a_plant_of_one_s_own_flies(ros, tmp_path):
    path = os.pathsep.join([str(SOURCE / 'docs' / 'plants'), ros.environment['PYTHONPATH']])
    demo(ros, tmp_path, 'moon_lander:MoonLander', '--speed=0.9', PYTHONPATH=path)
    plan = load_plan(tmp_path / 'out' / 'plan.json')
    assert plan['verification']['ok']
    assert abs(plan['states']['h'][-1]) < 1e-2
    assert all((tmp_path / 'out' / name).exists() for name in ('bag', 'report.html'))
