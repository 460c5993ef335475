# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker: with scripted states, with the simulated pendulum."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
import itertools
import math
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
from pendulum_rig import measured_state, PARAMETERS
import pytest
from ros_harness import Space
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.exceptions import Failure
from tdm_planner.nodes import tracker_plans
from tdm_planner.nodes.messages import plan_message, to_stamp
from tdm_planner.nodes.services import create_plan_service, Request
from tdm_planner.parameters import build
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory

OK, WARN, ERROR = 0, 1, 2
STRONG = {'limits.torque': 0.09}
SOON = 0.2  # s from publishing to the start
EVERY = 0.005  # s between scripted states


@pytest.fixture(scope='module')
def plan() -> Trajectory:
    problem = build(PendulumSwingUp, {**STRONG, 'torque_reserve': 0.3})
    return problem.solve().trajectory.with_rates(problem.plant.derivative)


class Bench(Space):
    """A tracker in a namespace of its own, and what it says; states come while `theta` is set."""

    theta: float | None = None

    def __init__(self, ros: Stepped, name: str = '', **given) -> None:
        super().__init__(ros, name)
        self.given, self.name = given or STRONG, f'{self.space}/tracker: tracking'
        self.commands, self.errors = self.hear('joint_command'), self.hear('tracking_error')
        self.tracker = self.start('tracker', self.given)

    def state(self, after: float = 0.0, **changes) -> None:
        at = self.ros.now + round(after * 1e9)
        self.states.publish(measured_state(at, self.theta or math.pi, **changes))

    @property
    def status(self):
        return self.ros.statuses[self.name]

    def says(self, *texts: str, level: int | None = None, timeout: float = 2.0) -> bool:
        return self.ros.says(self.name, *texts, level=level, timeout=timeout)


def message(ros: Stepped, plan: Trajectory, delay: float = SOON) -> JointTrajectory:
    return plan_message(PENDULUM, plan, to_stamp(ros.now + round(delay * 1e9)))


@pytest.fixture
def bench(ros: Stepped):
    made = Bench(ros)
    made.states = made.publisher('joint_states')
    said = lambda: None if made.theta is None else made.state()  # noqa: E731
    timer = ros.node.create_timer(EVERY, said)
    yield made
    ros.node.destroy_timer(timer)


@pytest.fixture
def idle(bench: Bench) -> Bench:
    bench.theta = math.pi
    assert bench.says('idle', level=OK)
    return bench


@pytest.fixture
def plans(bench: Bench) -> Iterator:
    made = bench.publisher('trajectory')
    yield made
    bench.ros.node.destroy_publisher(made)


def test_a_first_state_that_is_old_is_not_an_error_at_first(ros, bench):
    bench.state(after=-0.2)
    ros.spin_for(4.9)
    assert '[ERROR]' not in bench.tracker.output
    assert bench.says('idle: waiting for the first state', level=OK)
    assert bench.says('the newest state is older than state_timeout', level=ERROR)


def test_states_that_do_not_come_or_cannot_be_read_are_told_of(ros, bench):
    """After five seconds: the middleware takes its time, and the plant may start later."""
    ros.spin_for(4.9)
    assert 'waiting for the first state' in bench.tracker.output
    assert bench.status.message.startswith('idle: waiting for the first state')
    assert '[ERROR]' not in bench.tracker.output
    ros.spin_for(1.2)
    assert bench.tracker.output.count('[ERROR]') == 1
    assert bench.says('no state has been received', level=ERROR)
    assert list(bench.commands[-1].name) == ['disk']
    assert not any(command.effort[0] for command in bench.commands)
    bench.state(name=['arm', 'pendulum'])
    bench.state(position=[0.0])
    bench.state(velocity=[0.0, math.nan])
    bench.state(after=0.2)
    ros.settle()
    assert 'state ignored: ' in bench.tracker.output
    assert bench.says('no state has been received', level=ERROR)
    ros.spin_for(1.0)
    assert ros.figure(bench.name, 'states ignored') == '4'
    bench.theta = math.pi
    assert bench.says('idle', level=OK)
    ros.spin_for(2.0)
    bench.state(after=0.12)
    ros.settle()
    assert 'its stamp lies 0.12 s in the future' in bench.tracker.output
    bench.state(after=0.09)
    ros.spin_for(1.0)
    assert ros.figure(bench.name, 'states ignored') == '5'


def test_what_cannot_be_followed_is_refused_with_a_reason(ros, idle, plans, plan):
    plans.publish(message(ros, plan, -100.0))
    ros.settle()
    assert 'trajectory rejected: ' in idle.status.message
    assert 'past' in idle.status.message
    for data in (b'\0\1\0\0', b'\0\1\0\0' + bytes(12), b'\xff' * 40):
        count = idle.tracker.output.count('trajectory rejected: ')
        plans.publish(data)
        ros.spin_for(0.1)
        assert idle.tracker.output.count('trajectory rejected: ') == count + 1
        assert idle.says('trajectory rejected: ')
    assert idle.tracker.node.tracker.newest is None


def test_of_two_planners_plans_the_one_that_starts_last_is_followed(ros, idle, plans, plan):
    topic = f'{idle.space}/trajectory'
    other = idle.publisher('trajectory')
    assert ros.meet(lambda: ros.node.count_publishers(topic) == 2)
    assert idle.says(f'2 planners publish {topic}')
    plans.publish(message(ros, plan, 0.5))
    ros.spin_for(0.01)
    assert idle.status.message.startswith('waiting')
    other.publish(message(ros, plan, 0.39))
    ros.settle()
    told = 'it starts 0.1 s before the newest plan; with 2 planners the tracker follows'
    assert told in idle.status.message
    ros.node.destroy_publisher(other)
    assert ros.meet(lambda: ros.node.count_publishers(topic) == 1)
    plans.publish(message(ros, plan, 0.3))  # one planner may change its mind
    ros.spin_for(0.02)
    assert idle.status.message.startswith('waiting')
    assert 'rejected' not in idle.status.message


def test_a_second_source_of_states_is_told_of(ros, idle):
    told = f'2 nodes publish {idle.space}/joint_states: '
    other = idle.publisher('joint_states')
    assert idle.says(told, level=WARN)
    assert told in idle.tracker.output
    ros.node.destroy_publisher(other)
    assert idle.says('idle', level=OK)


@pytest.fixture
def busy(ros, monkeypatch):
    """Let every step of the examination of a plan take 2 ms."""
    counter = partial(next, itertools.count(0.0, 0.002))
    stand_in = SimpleNamespace(**{**vars(ros.time.as_module()), 'perf_counter': counter})
    monkeypatch.setattr(tracker_plans, 'time', stand_in)


@pytest.mark.usefixtures('busy')
def test_of_a_flood_of_plans_the_newest_is_followed(ros, bench, plans, plan):
    """Not all of them are examined; the last must not be lost."""
    followed = bench.hear('active_trajectory')
    bench.theta = math.pi
    ros.spin_for(0.1)
    for _ in range(60):
        ros.spin_for(0.01)
        for ahead in (0.5, 0.45, 0.4):
            newest = message(ros, plan, ahead)
            plans.publish(newest)
    before, begun = len(bench.commands), bench.tracker.output.count('accepted')
    assert 30 <= begun <= 70
    ros.spin_for(0.1)
    assert len(bench.commands) - before >= 20
    assert followed[-1].header.stamp == newest.header.stamp
    assert bench.tracker.output.count('accepted') <= begun + 2


@pytest.mark.usefixtures('busy')
def test_commands_go_on_while_gains_are_computed(ros, idle, plans, plan):
    """Those of a long plan take many times as long as an interval between commands."""
    states, times = np.repeat(plan.states[:1], 2, axis=0), np.array([0.0, 20.0])
    at_rest = replace(plan, times=times, states=states, controls=np.zeros((2, 1)), rates=None)
    before = len(idle.commands)
    plans.publish(message(ros, at_rest, 1.0))
    ros.spin_for(0.05)
    assert len(idle.commands) - before > 8
    assert 'accepted' not in idle.tracker.output
    idle.set('tracker', weights__theta=2.0)  # the gains are others then
    ros.spin_for(0.3)
    assert idle.tracker.output.count('accepted') == 1
    assert idle.status.message.startswith('waiting')


class Rig(Bench):
    """The tracker and its plant, 5 % wrong and noisy."""

    def __init__(self, ros: Stepped) -> None:
        plant = {**PARAMETERS['pendulum_plant'], **STRONG, 'mismatch': 0.05}
        ros.start('pendulum_plant', plant, 'rig')
        again = {'replan.on_deviation': True, 'replan.interval': 0.2}
        super().__init__(ros, 'rig', **STRONG, **again)
        self.measured = self.hear('joint_states')
        self.plans = self.publisher('trajectory')

    def follow(self, plan: Trajectory, delay: float = SOON) -> None:
        self.plans.publish(message(self.ros, plan, delay))
        self.ros.spin_for(0.02)

    def put(self, theta: float) -> None:
        self.set('pendulum_plant', initial__theta=theta)
        self.trigger('reset')
        self.ros.spin_for(0.02)


def test_the_pendulum_is_swung_up_held_and_planned_for_again_when_it_falls(ros, plan):
    """Afterwards the next plan is tracked, also by a tracker that joins late."""
    rig = Rig(ros)
    assert rig.says('idle', level=OK)
    rig.follow(plan)
    for word in ('waiting', 'tracking', 'holding'):
        assert rig.says(word, level=OK)
    ros.spin_for(1.0)
    first, taken = len(rig.measured), len(rig.errors)
    ros.spin_for(0.5)
    assert len(rig.measured) - first == pytest.approx(100, abs=1)
    assert len(rig.errors) - taken == pytest.approx(100, abs=1)
    held = [math.remainder(s.position[0], math.tau) for s in rig.measured[first:]]
    assert np.abs(held).max() < 0.06
    assert np.abs([e.position[0] for e in rig.errors[taken:]]).max() < 0.06
    assert np.abs([c.effort[0] for c in rig.commands]).max() <= STRONG['limits.torque']
    # It falls: a new plan is asked for, over and over; between two searches others may ask.
    asked, answered = list[int](), list[int]()

    def serve(request: Request, _):
        asked.append(ros.now)

        def answer() -> None:
            ros.node.destroy_timer(timer)
            answered.append(ros.now)
            request.answer(Failure('INFEASIBLE', 'test'))

        timer = ros.node.create_timer(0.3, answer)

    rig.put(2.8)
    assert rig.says('recovering', 'tolerance.path', level=ERROR)
    assert ros.spin_until(lambda: 'no planner serves plan: ' in rig.tracker.output)
    create_plan_service(ros.node, Trigger, '/rig/plan', serve)
    assert ros.spin_until(lambda: len(asked) >= 3)
    pauses = np.subtract(asked[1:3], answered[:2])
    assert 0.2e9 <= pauses.min() <= pauses.max() < 0.22e9
    assert 'no new plan: {"code": "INFEASIBLE", "reason": "test"}' in rig.tracker.output
    # at rest nothing is commanded, as plans assume
    assert rig.commands[-1].effort[0] == 0.0
    rig.put(math.pi)
    rig.follow(plan)
    assert rig.says('holding', level=OK)
    rig.tracker.end_cleanly()
    rig.put(math.pi)
    rig.follow(plan, 0.5)
    rig.tracker = rig.start('tracker', rig.given)
    assert ros.spin_until(lambda: rig.status.message.startswith('waiting'), 0.5)
    assert rig.says('holding', level=OK)


@pytest.mark.parametrize('step', [-0.1, 30.0])
def test_a_plan_that_comes_again_after_the_clock_was_set_is_the_one_that_is_followed(
    ros, plan, step
):
    """As from a planner that was restarted, which takes it from `active_trajectory`."""
    set_wrong, given = Space(ros), {'use_sim_time': False, **STRONG}
    set_wrong.start('pendulum_plant', given)
    tracker, sent = set_wrong.start('tracker', given), message(ros, plan)
    plans = set_wrong.publisher('trajectory')
    ros.spin_for(0.1)
    plans.publish(sent)
    ros.spin_for(SOON + 0.1)
    ros.time_of_day = step
    ros.spin_for(0.1)
    plans.publish(sent)
    ros.spin_for(plan.duration)
    ros.time_of_day = 0.0
    assert tracker.output.count('accepted') == 1
    assert 'rejected' not in tracker.output
    assert tracker.output.rstrip().endswith('holding')


def test_faults_of_the_program_are_called_so_and_end_nothing(ros, idle, plans, plan, monkeypatch):
    tracker, broken = idle.tracker.node.tracker, Mock(side_effect=KeyError('a bug'))
    with monkeypatch.context() as patch:
        patch.setattr(tracker, 'prepare', broken)
        plans.publish(message(ros, plan))
        assert idle.says("trajectory rejected: INTERNAL: KeyError: 'a bug'")
    with monkeypatch.context() as patch:
        patch.setattr(tracker.estimator, 'predict', broken)
        assert idle.says("the feedback broke down: INTERNAL: KeyError: 'a bug'", level=ERROR)
        assert idle.commands[-1].effort[0] == 0.0
    assert 'Traceback' in idle.tracker.output
    plans.publish(message(ros, plan))
    assert idle.says('waiting', level=OK)
    assert "KeyError: 'a bug'" in ros.figure(idle.name, 'last rejection')
    ros.log.clear()  # or it would be taken for a crash
