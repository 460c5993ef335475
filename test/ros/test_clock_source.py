# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A plant that drives `/clock`, and nodes that follow it."""

from __future__ import annotations

import numpy as np
import pytest
from ros_harness import MODULES
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from stepped_ros import Stepped
from tdm_planner.nodes.messages import LATCHED, to_stamp
from tdm_planner.nodes.reading import nanoseconds_of
from trajectory_msgs.msg import JointTrajectory

STEP = 10_000_000  # ns
PLANT = '/slow/pendulum_plant'


class Told:
    """What the plant says: instants of its clock, and its states."""

    def __init__(self, ros: Stepped) -> None:
        self.ros = ros
        self.clocks = ros.subscribe('/clock', Clock, 100)
        self.states = ros.subscribe('/slow/joint_states', JointState, 100)

    def listen(self, seconds: float) -> np.ndarray:
        """Return the clock's instants in so many s of real time, the last one before first."""
        shown = self.clocks[-1:]
        self.clocks.clear()
        self.states.clear()
        self.ros.spin_for(seconds)
        return np.array([nanoseconds_of(clock.clock) for clock in shown + self.clocks])


@pytest.fixture(scope='module')
def told(ros: Stepped) -> Told:
    ros.leave_clock()
    made = Told(ros)
    # With use_sim_time as well, as where all nodes are given it, it still is the one that tells.
    parameters = {'publish_clock': True, 'real_time_factor': 0.5, 'rate': 100.0}
    ros.start(MODULES['pendulum_plant'], {**parameters, 'command_timeout': 1.0}, namespace='slow')
    return made


def test_the_clock_goes_on_in_whole_steps_and_stamps_are_its_instants(told):
    told.listen(0.02)
    for speed in (0.5, 2.0, 0.5):
        assert told.ros.set_parameters(PLANT, real_time_factor=speed) == ['']
        shown = told.listen(1.0)
        steps = np.diff(shown)
        assert set(steps) <= {STEP, 2 * STEP}
        assert np.median(steps) == STEP
        assert shown[-1] - shown[0] == pytest.approx(speed * 1e9, abs=2 * STEP)
        stamps = [nanoseconds_of(state.header.stamp) for state in told.states]
        assert len(stamps) > 40
        assert set(stamps) <= set(shown.tolist())


def test_it_waits_for_who_does_not_keep_up_but_not_for_the_silent(told):
    assert told.ros.set_parameters(PLANT, real_time_factor=0.5) == ['']
    commands = told.ros.publisher('/slow/joint_command', JointState)
    command = JointState(name=['disk'], effort=[0.0])
    now = told.listen(0.1)[-1]
    for _ in range(2):  # as one that has stopped at that instant
        command.header.stamp = to_stamp(int(now))
        commands.publish(command)
        told.ros.settle()
    shown = told.listen(1.9)
    assert now <= shown[-1] <= now + STEP
    shown = told.listen(0.5)
    assert shown[-1] - shown[0] > 0.2e9
    told.ros.node.destroy_publisher(commands)


def test_planner_and_tracker_follow_the_clock(told):
    ros = told.ros
    tracking = {'rate': 100.0, 'state_timeout': 1.0, 'limits.torque': 0.09}
    planning = {'start.delay': 0.5, 'limits.torque': 0.09, 'torque_reserve': 0.2}
    assert ros.set_parameters(PLANT, real_time_factor=1.0, limits__torque=0.09) == ['', '']
    nodes = (('tracker', tracking), ('planner', planning))
    for name, given in nodes:
        ros.start(MODULES[name], given, namespace='slow')
    commands = ros.subscribe('/slow/joint_command', JointState, 10)
    plans = ros.subscribe('/slow/trajectory', JointTrajectory, LATCHED)
    assert ros.spin_until(lambda: len(commands) > 5)
    before = nanoseconds_of(told.clocks[-1].clock)
    assert not (nanoseconds_of(commands[-1].header.stamp) - before) % STEP
    done, answer = ros.trigger('/slow/plan')
    assert done, answer
    assert ros.spin_until(lambda: bool(plans))
    after = nanoseconds_of(told.clocks[-1].clock)
    assert before <= nanoseconds_of(plans[-1].header.stamp) - 500_000_000 <= after
    assert ros.says('/slow/tracker: tracking', 'holding')


def test_a_second_clock_is_told_of(told):
    two = '2 nodes publish /clock: '
    other = told.ros.start(MODULES['robot_plant'], {'publish_clock': True}, namespace='other')
    for name in (PLANT, '/other/robot_plant'):
        assert told.ros.says(f'{name}: simulation', two, timeout=3.0)
    assert two in other.output
    other.end_cleanly()
    assert told.ros.meet(lambda: told.ros.node.count_publishers('/clock') == 1)
    told.ros.spin_for(2.5)
    assert not told.ros.said(f'{PLANT}: simulation', two)
