# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Planner and tracker as managed nodes, brought up and down by a lifecycle manager over DDS."""

from __future__ import annotations

from functools import partial
import math
import threading
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from ros_harness import MODULES, ros_arguments
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.nodes.messages import LATCHED, to_stamp
from tdm_planner.nodes.tracker import TrackerNode
from tdm_planner.problems import Problem
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

PLANNER, TRACKER = MODULES['planner'], MODULES['tracker']
STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.2}
FROM_PARAMETERS = {**STRONG, 'start.source': 'parameters'}
WAITING = {'autostart': False}


class Manager:
    """What a lifecycle manager does with one node."""

    def __init__(self, ros: Stepped, node: str) -> None:
        self.ros, self.node = ros, node
        self.title = 'planning' if node.endswith('planner') else 'tracking'

    def says(self, text: str) -> bool:
        return self.ros.says(f'{self.node}: {self.title}', text)

    def state(self) -> str:
        return str(self.ros.call(f'{self.node}/get_state', GetState).current_state.label)

    def change(self, transition: int | str) -> bool:
        named = isinstance(transition, str)
        asked = Transition(label=transition) if named else Transition(id=transition)
        request = ChangeState.Request(transition=asked)
        return bool(self.ros.call(f'{self.node}/change_state', ChangeState, request).success)

    def become(self, transition: int | str, state: str) -> None:
        assert self.change(transition)
        assert self.state() == state

    def bring_up(self) -> None:
        self.become(Transition.TRANSITION_CONFIGURE, 'inactive')
        self.become(Transition.TRANSITION_ACTIVATE, 'active')

    def bring_down(self) -> None:
        self.become(Transition.TRANSITION_DEACTIVATE, 'inactive')
        self.become(Transition.TRANSITION_CLEANUP, 'unconfigured')


def silent(ros: Stepped, received: list[Any]) -> bool:
    """Whether nothing more comes."""
    ros.settle()
    count = len(received)
    ros.spin_for(0.3)
    return len(received) == count


def test_a_planner_waits_for_its_manager_and_goes_through_the_cycle_twice(ros):
    events = ros.subscribe('/twice/planner/transition_event', TransitionEvent)
    plans = ros.subscribe('/twice/trajectory', JointTrajectory, 10)
    markers = ros.subscribe('/twice/markers', MarkerArray, 10)
    ros.start(PLANNER, {**FROM_PARAMETERS, **WAITING}, namespace='twice')
    manager = Manager(ros, '/twice/planner')
    for cycle in (1, 2):
        assert manager.state() == 'unconfigured'
        assert manager.says('unconfigured')
        count = len(plans)
        manager.become(Transition.TRANSITION_CONFIGURE, 'inactive')
        assert ros.trigger('/twice/plan')[1]['code'] == 'INACTIVE'
        manager.become('activate', 'active')
        done, answer = ros.trigger('/twice/plan')
        assert done, answer
        assert answer['plan_id'] == cycle
        assert ros.spin_until(lambda: bool(markers))
        assert len(plans) == count + 1
        manager.become(Transition.TRANSITION_DEACTIVATE, 'inactive')
        assert manager.says('inactive')
        assert ros.trigger('/twice/plan')[1]['code'] == 'INACTIVE'
        assert silent(ros, plans)
        late = ros.subscribe('/twice/trajectory', JointTrajectory, LATCHED)
        assert ros.meet(partial(bool, late))  # the plan stays active
        manager.become(Transition.TRANSITION_CLEANUP, 'unconfigured')
        assert ros.meet(lambda: not ros.node.count_publishers('/twice/trajectory'))
    assert not ros.node.count_services('/twice/plan')
    manager.become(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, 'finalized')
    assert manager.says('finalized')
    assert ros.spin_until(lambda: bool(events) and events[-1].goal_state.label == 'finalized')


def test_transitions_that_do_not_exist_are_refused(ros):
    process = ros.start(TRACKER, WAITING, namespace='refusing')
    manager = Manager(ros, '/refusing/tracker')
    assert not manager.change(Transition.TRANSITION_ACTIVATE)
    assert not manager.change('take off')
    assert not manager.change(255)
    assert manager.state() == 'unconfigured'
    assert process.output.count('Transition is not registered') == 2
    possible = ros.call(
        '/refusing/tracker/get_available_transitions', GetAvailableTransitions
    ).available_transitions
    assert {item.transition.label for item in possible} == {'configure', 'shutdown'}


def test_wrong_parameters_leave_a_node_unconfigured_until_they_are_corrected(ros):
    wrong = {**FROM_PARAMETERS, **WAITING, 'method': 'magic'}
    process = ros.start(PLANNER, wrong, namespace='wrong')
    manager = Manager(ros, '/wrong/planner')
    assert not manager.change(Transition.TRANSITION_CONFIGURE)
    assert manager.state() == 'unconfigured'
    said = "cannot configure: parameter 'method' = 'magic' is not allowed"
    assert said in process.output
    assert manager.says(said)
    assert ros.set_parameters('/wrong/planner', method='switching') == ['']
    manager.bring_up()
    # One without a manager starts by itself then.
    ros.start(TRACKER, {'plant.mass': 1e9}, namespace='wrong')
    manager = Manager(ros, '/wrong/tracker')
    assert manager.state() == 'unconfigured'
    assert manager.says("cannot configure: parameters 'plant.*' do not make a rig")
    assert ros.set_parameters('/wrong/tracker', plant__mass=0.024) == ['']
    assert manager.state() == 'active'
    assert manager.says('no state has been received')


def test_deactivated_while_it_plans_a_planner_answers_and_publishes_nothing(ros, monkeypatch):
    plans = ros.subscribe('/undecided/trajectory', JointTrajectory, 10)
    ros.start(PLANNER, {**FROM_PARAMETERS, **WAITING}, namespace='undecided')
    manager = Manager(ros, '/undecided/planner')
    manager.bring_up()
    ros.settle()
    solve, go_on = Problem.solve, threading.Event()

    def solve_later(self: Problem, *args: Any, **options: Any) -> Any:
        assert go_on.wait(60.0)
        return solve(self, *args, **options)

    monkeypatch.setattr(Problem, 'solve', solve_later)
    pending = ros.request('/undecided/plan', Trigger)
    assert manager.says('planning')
    assert ros.trigger('/undecided/plan')[1]['code'] == 'BUSY'
    assert ros.set_parameters('/undecided/planner', start__theta=3.0) == ['']
    assert not pending.done()
    manager.become(Transition.TRANSITION_DEACTIVATE, 'inactive')
    assert ros.spin_until(pending.done)
    assert not pending.result().success
    assert 'deactivated before there was a plan' in pending.result().message
    manager.become(Transition.TRANSITION_CLEANUP, 'unconfigured')
    manager.bring_up()
    assert ros.trigger('/undecided/plan')[1]['code'] == 'BUSY'
    go_on.set()
    ros.spin_for(0.1)
    assert not plans
    done, answer = ros.trigger('/undecided/plan')
    assert done, answer
    ros.settle()
    assert len(plans) == 1


class Rig:
    """A pendulum with its tracker, and a planner that plans from what is measured."""

    def __init__(self, ros: Stepped, namespace: str) -> None:
        self.ros, self.namespace = ros, namespace
        # Without the tracker's last command the plant would go on as commanded.
        plant = {'limits.torque': 0.09, 'command_timeout': 1e6}
        tracking = {'limits.torque': 0.09, 'tolerance.path': 1.5, **WAITING}
        ros.start(MODULES['pendulum_plant'], plant, namespace=namespace)
        self.process = ros.start(TRACKER, tracking, namespace=namespace)
        ros.start(PLANNER, {**STRONG, **WAITING, 'start.delay': 0.3}, namespace=namespace)
        self.states = ros.subscribe(f'/{namespace}/joint_states', JointState)
        self.commands = ros.subscribe(f'/{namespace}/joint_command', JointState)
        self.plans = ros.subscribe(f'/{namespace}/trajectory', JointTrajectory, LATCHED)
        self.statuses = ros.subscribe(f'/{namespace}/tracker_status', GoalStatusArray, LATCHED)
        self.planner = Manager(ros, f'/{namespace}/planner')
        self.tracker = Manager(ros, f'/{namespace}/tracker')

    def status(self) -> list[int]:
        """Return what the tracker said last of its plans."""
        return [item.status for told in self.statuses[-1:] for item in told.status_list]

    def plan(self) -> None:
        assert self.ros.spin_until(lambda: bool(self.states))
        done, answer = self.ros.trigger(f'/{self.namespace}/plan')
        assert done, answer

    def tracked(self) -> None:
        """Wait until the tracker drives the disk."""
        self.commands.clear()
        assert self.ros.spin_until(
            lambda: len(self.commands) > 2 and abs(self.commands[-1].effort[0]) > 1e-3
        )


def test_in_the_middle_of_a_swing_the_actuators_are_switched_off_at_once(ros):
    rig = Rig(ros, 'swing')
    assert silent(ros, rig.commands)
    rig.tracker.bring_up()
    rig.planner.bring_up()
    rig.plan()
    for _ in range(2):
        rig.tracked()
        assert ros.spin_until(lambda: rig.status() == [GoalStatus.STATUS_EXECUTING])
        start = rig.statuses[-1].status_list[0].goal_info.stamp
        assert start == rig.plans[-1].header.stamp
        assert rig.tracker.change(Transition.TRANSITION_DEACTIVATE)
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
        assert rig.tracker.change(Transition.TRANSITION_ACTIVATE)
        assert ros.spin_until(lambda: rig.status() == [])
        rig.commands.clear()
        assert ros.spin_until(lambda: len(rig.commands) > 20)
        assert all(command.effort[0] == 0.0 for command in rig.commands)
        assert ros.call(f'/{rig.namespace}/reset', Trigger).success
        ros.spin_for(0.02)
        rig.plan()
    rig.tracked()
    rig.process.end()  # which ends the torque as well
    ros.spin_for(0.02)
    assert rig.commands[-1].effort[0] == 0.0
    assert rig.states[-1].effort[1] == 0.0


def test_a_plan_that_came_while_the_tracker_was_inactive_is_followed(ros):
    rig = Rig(ros, 'late')
    rig.tracker.become(Transition.TRANSITION_CONFIGURE, 'inactive')
    rig.planner.bring_up()
    assert ros.set_parameters(f'/{rig.namespace}/planner', start__delay=1.0) == ['']
    rig.plan()
    assert silent(ros, rig.commands)
    rig.tracker.become(Transition.TRANSITION_ACTIVATE, 'active')
    rig.tracked()
    rig.planner.bring_down()  # the tracker has the plan
    rig.tracked()
    for manager, transition in (
        (rig.tracker, Transition.TRANSITION_ACTIVE_SHUTDOWN),
        (rig.planner, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN),
    ):
        manager.become(transition, 'finalized')
    ros.settle()
    assert rig.commands[-1].effort[0] == 0.0
    assert silent(ros, rig.commands)


class FragileTracker(TrackerNode):
    """Whose first activation and first deactivation break down, half-way."""

    activations = deactivations = 0

    def activate(self) -> None:
        super().activate()
        self.activations += 1
        if self.activations == 1:
            raise RuntimeError('something\nbroke')

    def deactivate(self) -> None:
        self.deactivations += 1
        if self.deactivations == 2:  # the first is that of the broken activation
            raise RuntimeError('something else broke')
        super().deactivate()


def test_what_breaks_down_leaves_the_node_unconfigured_and_the_plant_safe(ros):
    process = ros.add(FragileTracker, ros_arguments({'use_sim_time': True, **WAITING}, 'fragile'))
    commands = ros.subscribe('/fragile/joint_command', JointState)
    manager = Manager(ros, '/fragile/tracker')
    manager.become(Transition.TRANSITION_CONFIGURE, 'inactive')
    assert not manager.change(Transition.TRANSITION_ACTIVATE)
    assert manager.state() == 'unconfigured'
    said = 'cannot activate: INTERNAL: RuntimeError: something broke'
    assert said in process.output
    assert manager.says(said)
    manager.bring_up()
    states = ros.publisher('/fragile/joint_states', JointState)
    for _ in range(20):
        state = JointState(name=['pendulum', 'disk'], position=[math.pi, 0.0], velocity=[0.0, 0.0])
        state.header.stamp = to_stamp(ros.now)
        states.publish(state)
        ros.spin_for(0.01)
    assert commands
    assert not manager.change(Transition.TRANSITION_DEACTIVATE)
    assert manager.state() == 'unconfigured'
    assert 'cannot deactivate: INTERNAL: RuntimeError: something else' in process.output
    assert silent(ros, commands)
    assert commands[-1].effort[0] == 0.0
    manager.bring_up()
    process.end()
    assert process.output.count('Traceback') == 2
    ros.log.clear()  # whatever else ends in one is a fault
