# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A plant that drives `/clock` and nodes that follow it; nodes before and after time begins."""

from functools import partial
import itertools
import math
from types import SimpleNamespace
from typing import Any

from closed_loop import swing_up
import numpy as np
from pendulum_rig import measured_state
import pytest
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from stepped_ros import BEGIN, Stepped
from tdm_planner.nodes import planning, tracker_plans
from tdm_planner.nodes.messages import plan_message, to_stamp
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory

STEP = 10_000_000  # ns
PLANT = '/slow/pendulum_plant'
OWN = ['-r', '/clock:=own_clock']  # a clock that only the test sets


class Told:
    """What the plant says: instants of its clock, and its states."""

    def __init__(self, ros: Stepped) -> None:
        self.ros = ros
        self.clocks = ros.subscribe('/clock', Clock, 100)
        self.states = ros.subscribe('/slow/joint_states')

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
    given = {'publish_clock': True, 'real_time_factor': 0.5, 'rate': 100.0, 'command_timeout': 1.0}
    ros.start('pendulum_plant', given, 'slow')
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
    commands = told.ros.publisher('/slow/joint_command')
    command = JointState(name=['disk'], effort=[0.0])

    def publish(stamp: int) -> int:
        command.header.stamp = to_stamp(stamp)
        commands.publish(command)
        told.ros.settle()
        return stamp

    now = int(told.listen(0.1)[-1])
    for _ in range(2):  # as one that has stopped at that instant
        publish(now)
    shown = told.listen(1.9)
    assert now <= shown[-1] <= now + STEP
    assert list(shown).count(shown[-1]) > 5  # told again: it may have got lost
    shown = told.listen(0.5)
    assert shown[-1] - shown[0] > 0.2e9
    # One that was away for five steps, and publishes in every step again.
    now = publish(int(told.listen(0.1)[-1]))
    told.ros.spin_for(2.1)
    for step in (5, 6):
        publish(now + step * STEP)
    now = publish(int(told.listen(0.1)[-1]))
    shown = told.listen(1.0)
    assert now <= shown[-1] <= now + STEP
    told.ros.node.destroy_publisher(commands)


@pytest.mark.parametrize('stamp', [0, BEGIN - 3600 * 10**9])
def test_it_does_not_wait_for_stamps_that_are_not_of_its_time(told, stamp):
    """A controller without stamps, or that goes by another clock."""
    assert told.ros.set_parameters(PLANT, real_time_factor=1.0) == ['']
    commands = told.ros.publisher('/slow/joint_command')
    command = JointState(name=['disk'], effort=[0.0])
    command.header.stamp = to_stamp(stamp)
    shown = []
    for _ in range(50):
        commands.publish(command)
        shown += [*told.listen(0.02)]
    assert shown[-1] - shown[0] > 0.9e9
    told.ros.node.destroy_publisher(commands)


def test_planner_and_tracker_follow_the_clock(told):
    ros = told.ros
    strong = {'limits.torque': 0.09}
    assert ros.set_parameters(PLANT, real_time_factor=1.0, **strong) == ['', '']
    ros.start('tracker', {'rate': 100.0, 'state_timeout': 1.0, **strong}, 'slow')
    ros.start('planner', {'start.delay': 0.5, 'torque_reserve': 0.2, **strong}, 'slow')
    commands, plans = map(ros.subscribe, ('/slow/joint_command', '/slow/trajectory'))
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
    ros, other = told.ros, told.ros.start('robot_plant', {'publish_clock': True}, 'other')
    for name in (PLANT, '/other/robot_plant'):
        assert ros.says(f'{name}: simulation', two, timeout=3.0)
    assert two in other.output
    other.end_cleanly()
    assert ros.meet(lambda: ros.node.count_publishers('/clock') == 1)
    ros.spin_for(2.5)
    assert not ros.said(f'{PLANT}: simulation', two)


class Simulation:
    """Publishes a clock of its own, and a pendulum that hangs at rest."""

    def __init__(self, ros: Stepped, namespace: str) -> None:
        self.ros = ros
        self.clock = ros.publisher(f'/{namespace}/own_clock', Clock)
        self.states = ros.publisher(f'/{namespace}/joint_states')

    def at(self, seconds: float) -> None:
        now = Time(nanoseconds=BEGIN + round(seconds * 1e9)).to_msg()
        self.clock.publish(Clock(clock=now))
        self.ros.spin_for(0.01)
        self.states.publish(measured_state(now))
        self.ros.spin_for(0.01)


def swing_up_from(start: int) -> JointTrajectory:
    return plan_message(PENDULUM, swing_up().solution.trajectory, to_stamp(start))


def test_nodes_say_that_they_do_not_know_the_time(ros):
    told = 'simulated time is not known yet (use_sim_time): nothing has come on /clock'
    names = {'pendulum_plant': 'simulation', 'tracker': 'tracking', 'planner': 'planning'}
    for role in names:
        ros.start(role, {}, 'timeless', OWN)
    tasks = [f'/timeless/{role}: {task}' for role, task in names.items()]
    assert all(ros.says(task, told, level=1) for task in tasks)
    clock = ros.publisher('/timeless/own_clock', Clock)
    clock.publish(Clock(clock=Time(nanoseconds=BEGIN).to_msg()))
    ros.spin_for(1.5)
    assert not any(told in ros.statuses[task].message for task in tasks)


def test_a_plan_that_comes_before_the_time_is_followed_when_it_is_known(ros):
    tracker = ros.start('tracker', {'rate': 100.0}, 'early', OWN)
    followed, commands = map(ros.subscribe, ('/early/active_trajectory', '/early/joint_command'))
    ros.publisher('/early/trajectory').publish(swing_up_from(BEGIN + 200_000_000))
    assert ros.says('/early/tracker: tracking', '/clock')
    assert not followed
    simulation = Simulation(ros, 'early')
    for k in range(60):
        simulation.at(0.01 * k)
    assert any(one.points for one in followed), tracker.output
    assert any(any(command.effort) for command in commands)
    assert 'rejected' not in tracker.output
    ros.spin_for(1.1)
    assert not ros.said('/early/tracker: tracking', '/clock')


def test_a_plan_is_recovered_as_it_is_where_the_trackers_are_heard_before_the_clock(ros):
    """Instants of a time that is not known yet are off by some ns: the tracker would reject it."""
    start = BEGIN + 4_000_000_007
    planner = ros.start('planner', {'limits.torque': 0.02}, 'back', OWN)
    ros.publisher('/back/active_trajectory').publish(swing_up_from(start))
    plans = ros.subscribe('/back/trajectory')
    ros.spin_for(2.0)
    assert not plans
    simulation = Simulation(ros, 'back')
    assert ros.publish_until(lambda: simulation.at(0.0), lambda: bool(plans)), planner.output
    assert nanoseconds_of(plans[0].header.stamp) == start


def test_a_plan_is_given_up_when_simulated_time_begins_anew(ros):
    """A state measured then is planned from as it is: nobody follows the plan before."""
    given = {'limits.torque': 0.09, 'start.max_age': 10.0}
    planner = ros.start('planner', given, 'anew', OWN)
    simulation = Simulation(ros, 'anew')
    plans = ros.subscribe('/anew/trajectory')
    pending = ros.request('/anew/plan')
    assert ros.publish_until(lambda: simulation.at(100.0), pending.done)
    assert pending.result().success, pending.result().message
    # Half way up, by the plan, where the pendulum never was.
    simulation.at(100.98)
    simulation.at(99.9)
    assert 'simulated time was set back' in planner.output
    # Nor does a tracker that starts now, when the time of that plan comes.
    assert not plans[-1].points
    tracker = ros.start('tracker', {'limits.torque': 0.09}, 'anew', OWN)
    for seconds in (100.9, 101.0, 101.2):
        simulation.at(seconds)
    assert ros.said('/anew/tracker: tracking', 'idle')
    assert 'rejected' not in tracker.output
    done, answer = ros.trigger('/anew/plan')
    assert done, answer
    assert ros.spin_until(lambda: len(plans) == 3)
    np.testing.assert_allclose(plans[-1].points[0].positions, [np.pi, 0.0], atol=1e-9)


def test_a_request_under_way_is_not_planned_from_a_state_of_the_time_before(ros, monkeypatch):
    planner = ros.start('planner', {'limits.torque': 0.09}, 'between', OWN)
    simulation, solve = Simulation(ros, 'between'), PendulumSwingUp.solve

    def slowly(*of: Any, **options: Any) -> Any:
        planning.time.sleep(0.5)
        return solve(*of, **options)

    monkeypatch.setattr(PendulumSwingUp, 'solve', slowly)
    plans, pending = ros.subscribe('/between/trajectory'), ros.request('/between/plan')
    for k in range(10):
        simulation.at(100.0 + 0.02 * k)
    assert not pending.done()
    simulation.at(50.0)
    told = 'NO_STATE", "reason": "simulated time was set back before there was a plan'
    assert told in pending.result().message
    ros.spin_for(1.0)
    assert not plans
    assert ros.says('/between/planner: planning', 'NO_STATE: simulated time was set back')
    assert 'Traceback' not in planner.output


@pytest.mark.parametrize(('back', 'stays'), [(0.0005, True), (0.02, False)])
def test_planner_and_tracker_agree_by_how_much_time_may_be_set_back(ros, back, stays):
    name, given = f'back{back * 1e4:.0f}', {'limits.torque': 0.09, 'start.max_age': 1.0}
    planner = ros.start('planner', given, name, OWN)
    tracker = ros.start('tracker', {'limits.torque': 0.09, 'state_timeout': 1.0}, name, OWN)
    simulation, pending = Simulation(ros, name), ros.request(f'/{name}/plan')
    assert ros.publish_until(lambda: simulation.at(100.0), pending.done)
    assert pending.result().success, pending.result().message
    simulation.at(100.1)
    assert 'accepted' in tracker.output
    simulation.at(100.1 - back)
    simulation.at(100.11 - back)
    for node in (planner, tracker):
        assert ('was set back' in node.output) is not stays


def test_a_plan_that_is_examined_when_time_is_set_back_is_dropped(ros, monkeypatch):
    """Its gains are computed between commands: it is a plan of the time before."""
    counter = partial(next, itertools.count(0.0, 1.0))  # s that a step takes: one a tick
    stand_in = SimpleNamespace(**{**vars(ros.time.as_module()), 'perf_counter': counter})
    monkeypatch.setattr(tracker_plans, 'time', stand_in)
    tracker = ros.start('tracker', {'limits.torque': 0.09, 'state_timeout': 1.0}, 'long', OWN)
    simulation, plans = Simulation(ros, 'long'), ros.publisher('/long/trajectory')
    simulation.at(100.0)
    times, rest = np.array([0.0, 20.0]), np.tile([math.pi, 0.0, 0.0, 0.0], (2, 1))
    plan = Trajectory.of(swing_up().problem.plant, times, rest, np.zeros((2, 1)))
    plans.publish(plan_message(PENDULUM, plan, to_stamp(BEGIN + 101 * 10**9)))
    for seconds in (100.02, 100.04, 50.0):
        simulation.at(seconds)
    for k in range(1, 100):
        simulation.at(50.0 + 0.02 * k)
    assert 'accepted' not in tracker.output
    assert ros.says('/long/tracker: tracking', 'idle')
