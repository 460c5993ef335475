# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Planner and tracker as managed nodes, brought up and down by a lifecycle manager over DDS."""

import threading
from unittest.mock import Mock

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Time
from closed_loop import swing_up
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import GetAvailableTransitions, GetState
import numpy as np
from pendulum_rig import measured_state
from ros_harness import Space
from stepped_ros import Stepped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import plan_message
from tdm_planner.nodes.reading import seconds_of
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.problems import Problem

STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.2}
WAITING = {'autostart': False}
NODES = 'planner', 'tracker'
FROM_PARAMETERS = {**STRONG, 'start.source': 'parameters', **WAITING}


class Manager:
    """What a lifecycle manager does with one node."""

    def __init__(self, ros: Stepped, node: str) -> None:
        self.ros, self.node = ros, node
        self.title = 'planning' if node.endswith('planner') else 'tracking'

    def says(self, text: str) -> bool:
        return self.ros.says(f'{self.node}: {self.title}', text)

    @property
    def state(self) -> str:
        return str(self.ros.call(f'{self.node}/get_state', GetState).current_state.label)

    def refuses(self, transition: int | str) -> bool:
        return not self.ros.change(self.node, transition) and self.state == 'unconfigured'

    def do(self, *transitions: str) -> None:
        """Make transitions, each of which must lead where it should."""
        states = {'configure': 'inactive', 'activate': 'active', 'deactivate': 'inactive',
                  'cleanup': 'unconfigured', 'shutdown': 'finalized'}  # fmt: skip
        for transition in transitions:
            asked = {'deactivate': 4, 'cleanup': 2}.get(transition, transition)  # or by name
            assert self.ros.change(self.node, asked)
            assert self.state == states[transition]


def test_a_planner_waits_for_its_manager_and_goes_through_the_cycle_twice(ros):
    space = Space(ros, 'twice')
    events = space.hear('planner/transition_event', TransitionEvent)
    plans, markers = space.hear('trajectory'), space.hear('markers')
    space.start('planner', FROM_PARAMETERS)
    manager = Manager(ros, '/twice/planner')
    for cycle in (1, 2):
        assert manager.state == 'unconfigured'
        assert manager.says('unconfigured')
        count = len(plans)
        manager.do('configure')
        assert space.refusal()[0] == 'INACTIVE'
        manager.do('activate')
        assert space.plan()['plan_id'] == cycle
        assert ros.spin_until(lambda: bool(markers))
        assert len(plans) == count + 1
        manager.do('deactivate')
        assert manager.says('inactive')
        assert space.refusal()[0] == 'INACTIVE'
        assert ros.silent(plans)
        assert space.latched('trajectory')  # the plan stays active
        manager.do('cleanup')
        assert ros.meet(lambda: not ros.node.count_publishers('/twice/trajectory'))
    assert not ros.node.count_services('/twice/plan')
    assert ros.change(manager.node, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert manager.says('finalized')
    assert ros.spin_until(lambda: bool(events) and events[-1].goal_state.label == 'finalized')


def test_wrong_transitions_and_parameters_leave_a_node_unconfigured(ros, monkeypatch):
    space = Space(ros, 'wrong')
    process = space.start('tracker', {**WAITING, 'plant.mass': 1e9})
    manager = Manager(ros, '/wrong/tracker')
    assert all(manager.refuses(transition) for transition in (3, 'take off', 255))
    assert process.output.count('Transition is not registered') == 2
    service = '/wrong/tracker/get_available_transitions'
    possible = ros.call(service, GetAvailableTransitions).available_transitions
    assert {item.transition.label for item in possible} == {'configure', 'shutdown'}
    assert manager.refuses('configure')
    assert manager.says(said := "cannot configure: parameters 'plant.*' do not make a rig")
    assert said in process.output
    space.set('tracker', plant__mass=0.024)
    manager.do('configure', 'activate')
    # One without a manager starts by itself then.
    other = Space(ros, 'odd')
    process = other.start('tracker', {'plant.mass': 1e9})
    manager = Manager(ros, '/odd/tracker')
    assert manager.state == 'unconfigured'
    assert manager.says(said)
    other.set('tracker', plant__mass=0.024)
    assert manager.state == 'active'
    assert manager.says('no state has been received')
    # One that cannot recover is finalized and says so.
    manager.do('deactivate')
    monkeypatch.setattr(process.node, 'cleanup', Mock(side_effect=InvalidProblem('no way out')))
    assert not ros.change(manager.node, 'cleanup')
    assert manager.state == 'finalized'
    assert not process.node.configured
    assert 'after the error: no way out' in process.output


def test_deactivated_while_it_plans_a_planner_answers_and_publishes_nothing(ros, monkeypatch):
    space = Space(ros, 'undecided')
    plans = space.hear('trajectory')
    space.start('planner', FROM_PARAMETERS)
    manager = Manager(ros, '/undecided/planner')
    manager.do('configure', 'activate')
    ros.settle()
    solve, go_on = Problem.solve, threading.Event()
    later = lambda *asked, **options: go_on.wait(60.0) and solve(*asked, **options)  # noqa: E731
    monkeypatch.setattr(Problem, 'solve', later)
    pending = ros.request('/undecided/plan')
    assert manager.says('planning')
    assert space.refusal()[0] == 'BUSY'
    space.set('planner', start__theta=3.0)
    assert not pending.done()
    manager.do('deactivate')
    assert ros.spin_until(pending.done)
    assert not pending.result().success
    assert 'deactivated before there was a plan' in pending.result().message
    manager.do('cleanup', 'configure', 'activate')
    assert space.refusal()[0] == 'BUSY'
    go_on.set()
    ros.spin_for(0.1)
    assert not plans
    space.plan()
    assert len(plans) == 1


class Rig(Space):
    """A pendulum with its tracker, and a planner that plans from what is measured."""

    def __init__(self, ros: Stepped, name: str) -> None:
        super().__init__(ros, name)
        # Without the tracker's last command the plant would go on as commanded.
        self.start('pendulum_plant', {'limits.torque': 0.09, 'command_timeout': 1e6})
        given = {'limits.torque': 0.09, 'tolerance.path': 1.5, **WAITING}
        self.process = self.start('tracker', given)
        self.start('planner', {**STRONG, **WAITING, 'start.delay': 0.3})
        self.states, self.commands = self.hear('joint_states'), self.hear('joint_command')
        self.plans, self.statuses = self.hear('trajectory'), self.hear('tracker_status')
        self.planner, self.tracker = (Manager(ros, f'{self.space}/{n}') for n in NODES)
        assert ros.spin_until(lambda: bool(self.states))

    def status(self) -> list[int]:
        return [item.status for told in self.statuses[-1:] for item in told.status_list]

    def tracked(self) -> None:
        self.commands.clear()
        assert self.ros.spin_until(lambda: any(abs(c.effort[0]) > 1e-3 for c in self.commands[2:]))


def test_in_the_middle_of_a_swing_the_actuators_are_switched_off_at_once(ros):
    rig = Rig(ros, 'swing')
    assert ros.silent(rig.commands)
    rig.tracker.do('configure', 'activate')
    rig.planner.do('configure', 'activate')
    rig.plan()
    for _ in range(2):
        rig.tracked()
        assert ros.spin_until(lambda: rig.status() == [GoalStatus.STATUS_EXECUTING])
        start = rig.statuses[-1].status_list[0].goal_info.stamp
        assert start == rig.plans[-1].header.stamp
        assert ros.change(rig.tracker.node, 'deactivate')
        assert ros.spin_until(lambda: rig.status() == [GoalStatus.STATUS_CANCELED])
        ros.settle()
        count, last = len(rig.commands), rig.commands[-1]
        assert list(last.effort) == [0.0]
        assert any(command.effort[0] != 0.0 for command in rig.commands)
        rig.states.clear()
        ros.spin_for(0.2)
        assert len(rig.commands) == count
        assert not any(state.effort[1] for state in rig.states)
        # Nothing of the interrupted motion is taken up again.
        assert ros.change(rig.tracker.node, 'activate')
        assert ros.spin_until(lambda: rig.status() == [])
        rig.commands.clear()
        assert ros.spin_until(lambda: len(rig.commands) > 20)
        assert all(command.effort[0] == 0.0 for command in rig.commands)
        rig.trigger('reset')
        ros.spin_for(0.02)
        rig.plan()
    rig.tracked()
    rig.process.end()  # which ends the torque as well
    ros.spin_for(0.02)
    assert rig.commands[-1].effort[0] == rig.states[-1].effort[1] == 0.0


def test_a_plan_that_came_while_the_tracker_was_inactive_is_followed(ros):
    rig = Rig(ros, 'late')
    rig.tracker.do('configure')
    rig.planner.do('configure', 'activate')
    rig.set('planner', start__delay=1.0)
    rig.plan()
    assert ros.silent(rig.commands)
    rig.tracker.do('activate')
    rig.tracked()
    rig.planner.do('deactivate', 'cleanup')  # the tracker has the plan
    rig.tracked()
    rig.tracker.do('shutdown')
    rig.planner.do('shutdown')
    ros.settle()
    assert rig.commands[-1].effort[0] == 0.0
    assert ros.silent(rig.commands)


def test_a_plan_that_begins_when_it_comes_is_not_kept_while_the_tracker_is_inactive(ros):
    process = ros.start('tracker', WAITING, 'at_once')
    manager = Manager(ros, '/at_once/tracker')
    manager.do('configure')
    plans = ros.publisher('/at_once/trajectory')
    plans.publish(plan_message(PENDULUM, swing_up().solution.trajectory, Time()))
    ros.spin_for(30.0)
    assert 'trajectory rejected: its stamp is zero' in process.output
    manager.do('activate')
    states = ros.publisher('/at_once/joint_states')
    for _ in range(20):
        states.publish(measured_state(ros.now))
        ros.spin_for(0.01)
    assert 'accepted' not in process.output
    assert manager.says('idle')


def test_the_first_request_after_a_planner_was_set_up_anew_is_planned_along_the_active_plan(ros):
    rig = Rig(ros, 'anew')
    rig.tracker.do('configure', 'activate')
    rig.planner.do('configure', 'activate')
    rig.plan()
    rig.tracked()
    rig.planner.do('deactivate', 'cleanup')
    rig.plans.clear()
    ros.change(rig.planner.node, 'configure')
    ros.change(rig.planner.node, 'activate')
    rig.plan()
    assert ros.spin_until(lambda: len(rig.plans) == 2)
    active, new = rig.plans
    start = seconds_of(new.header.stamp) - seconds_of(active.header.stamp)
    times = [seconds_of(point.time_from_start) for point in active.points]
    followed = np.interp(start, times, [point.positions[0] for point in active.points])
    assert start > 0.1
    # It begins on the active plan, not where a pendulum gets that nothing drives.
    assert abs(new.points[0].positions[0] - followed) < 0.02
    assert ros.spin_until(lambda: rig.status() == [GoalStatus.STATUS_SUCCEEDED])


def test_requests_that_are_busy_do_not_wait_for_a_tracker_that_says_nothing_yet(ros):
    rig = Rig(ros, 'silent')
    rig.tracker.do('configure')
    rig.planner.do('configure', 'activate')
    begun = ros.now
    asked = [ros.request(f'{rig.space}/plan') for _ in range(8)]
    assert ros.spin_until(lambda: all(one.done() for one in asked))
    assert sum(one.result().success for one in asked) == 1
    assert sum('BUSY' in one.result().message for one in asked) == 7
    assert ros.now - begun < 1e9


def test_what_breaks_down_leaves_the_node_unconfigured_and_the_plant_safe(ros, monkeypatch):
    process = ros.start('tracker', WAITING, 'fragile')
    commands = ros.subscribe('/fragile/joint_command')
    manager = Manager(ros, '/fragile/tracker')
    manager.do('configure')
    activate = process.node.activate
    broken = Mock(side_effect=RuntimeError('something\nbroke'))
    monkeypatch.setattr(process.node, 'activate', lambda: (activate(), broken()))
    assert manager.refuses('activate')
    assert manager.says(said := 'cannot activate: INTERNAL: RuntimeError: something broke')
    assert said in process.output
    monkeypatch.undo()
    manager.do('configure', 'activate')
    states = ros.publisher('/fragile/joint_states')
    for _ in range(20):
        states.publish(measured_state(ros.now))
        ros.spin_for(0.01)
    assert commands
    monkeypatch.setattr(process.node, 'deactivate', broken)
    assert manager.refuses('deactivate')
    assert 'cannot deactivate: INTERNAL: RuntimeError: something broke' in process.output
    assert ros.silent(commands)
    assert commands[-1].effort[0] == 0.0
    monkeypatch.undo()
    manager.do('configure', 'activate')
    process.end()
    assert process.output.count('Traceback') == 2
    ros.log.clear()  # whatever else ends in one is a fault
