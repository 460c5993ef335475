# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Demos that end early, alone in the domain; nodes that are asked to end, or killed."""

import os
from pathlib import Path
import signal

from action_msgs.msg import GoalStatus
from bag_contents import read_with_mcap
from pendulum_rig import held_rig, SCENARIOS
import pytest
from ros_harness import PATIENCE, ros_arguments
from signal_scenes import SCENES, survivors


def test_a_goal_that_cannot_be_planned_is_no_success(ros, tmp_path):
    file = tmp_path / 'p.yaml'
    file.write_text('/**: {ros__parameters: {limits: {torque: 0.0001}, solver: {deadline: 0.3}}}')
    words = ['demo', 'pendulum', '-o', str(tmp_path / 'out'), '--quiet', '--params', str(file)]
    demo = ros.run('tdm_planner.cli', words)
    assert demo.process.wait(280.0) == 1
    assert 'no plan' in demo.output
    assert 'Traceback' not in demo.output
    assert not survivors(f'ROS_DOMAIN_ID={ros.domain}')


def test_a_demo_beside_nodes_in_its_namespace_is_refused(ros, tmp_path):
    plant = ros.run('tdm_sim.pendulum_plant', ros_arguments({}, '/pendulum'))
    heard = ros.subscribe('/pendulum/joint_states')
    assert ros.spin_until(lambda: heard)
    demo = ros.run('tdm_planner.cli', ['demo', 'pendulum', '-o', str(tmp_path / 'out')])
    assert demo.process.wait(PATIENCE) == 2
    assert 'DEMO_FAILED: nodes run in /pendulum already' in demo.output
    assert not (tmp_path / 'out').exists()
    assert plant.end() == 0


def test_an_interrupted_demo_ends_all_it_started_and_a_recording_beside_it_is_whole(ros, tmp_path):
    bag = tmp_path / 'bag'
    recorder = ros.run('tdm_planner.cli', ['record', '-o', str(bag), '--namespace', 'pendulum'])
    assert ros.spin_until(lambda: any(bag.glob('*.mcap'))), recorder.output
    followed = ros.subscribe('/pendulum/tracker_status')
    demo = SCENES['demo executing'](ros)
    plans = lambda: [plan.status for told in followed for plan in told.status_list]  # noqa: E731
    demo.wait(lambda: GoalStatus.STATUS_EXECUTING in plans()).end('SIGINT', (130,))
    assert survivors(f'ROS_DOMAIN_ID={ros.domain}') == [recorder.process.pid]
    assert recorder.end() == 0, recorder.output
    found = read_with_mcap(bag)
    assert all(found[f'/pendulum/{name}'] for name in ('trajectory', 'joint_states'))
    out = Path(demo.arguments[demo.arguments.index('-o') + 1])
    assert read_with_mcap(out / 'bag')['/pendulum/trajectory']


def test_the_nodes_of_a_demo_that_is_killed_end(ros):
    demo = SCENES['demo asking'](ros)
    mark = f'TDM_TEST_MARK={demo.space}'
    demo.process.process.kill()
    demo.process.process.wait()
    try:
        assert ros.spin_until(lambda: not survivors(mark), timeout=20.0)
    finally:
        for left in survivors(mark):
            os.kill(left, signal.SIGKILL)


def test_nodes_are_killed_and_the_pendulum_comes_back(ros):
    rig = held_rig(ros)
    for name in ('plant killed while holding', 'tracker killed in mid-swing',
                 'planner killed while planning'):  # fmt: skip
        rig.held_since(rig.now)
        SCENARIOS[name](rig)


ENDS = [('starting planner', 'SIGINT'), ('starting tracker', 'double Ctrl-C at once'),
        ('starting tdm', 'SIGINT'), ('solving planner', 'double Ctrl-C'),
        ('following tracker', 'SIGTERM'), ('idle tracker', 'SIGHUP')]  # fmt: skip


@pytest.mark.parametrize(('scene', 'way'), ENDS)
def test_a_node_is_ended_by_signals(ros, scene, way):
    SCENES[scene](ros).end(way, (130,) if scene == 'starting tdm' else (0,))
