# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes with `use_sim_time` before, and after, the first message of the simulated clock."""

from __future__ import annotations

import numpy as np
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.nodes.messages import LATCHED, plan_message
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.problems import PendulumSwingUp
from trajectory_msgs.msg import JointTrajectory

BEGIN = 1_800_000_000_000_000_000  # ns
OWN = ['-r', '/clock:=own_clock']  # not the clock that the harness steps
HANGING = {'name': ['pendulum', 'disk'], 'position': [np.pi, 0.0], 'velocity': [0.0, 0.0]}


class Simulation:
    """Publishes a clock of its own, and a pendulum that hangs at rest."""

    def __init__(self, ros: Stepped, namespace: str) -> None:
        self.ros = ros
        self.clock = ros.publisher(f'/{namespace}/own_clock', Clock)
        self.states = ros.publisher(f'/{namespace}/joint_states', JointState)

    def at(self, seconds: float) -> None:
        now = Time(nanoseconds=BEGIN + round(seconds * 1e9)).to_msg()
        self.clock.publish(Clock(clock=now))
        self.ros.spin_for(0.01)
        state = JointState(**HANGING)
        state.header.stamp = now
        self.states.publish(state)
        self.ros.spin_for(0.01)


def test_a_planner_without_time_makes_no_plan(ros):
    given = {'start.source': 'parameters'}
    ros.start('tdm_planner.nodes.planner', given, namespace='timeless', arguments=OWN)
    _, answer = ros.trigger('/timeless/plan')
    assert answer['code'] == 'NO_STATE'
    assert '/clock' in answer['reason']


def test_a_plan_that_comes_before_the_time_is_followed_when_it_is_known(ros):
    given = {'rate': 100.0}
    tracker = ros.start('tdm_planner.nodes.tracker', given, namespace='early', arguments=OWN)
    followed = ros.subscribe('/early/active_trajectory', JointTrajectory, LATCHED)
    commands = ros.subscribe('/early/joint_command', JointState, 50)
    plan = PendulumSwingUp.from_parameters({'limits.torque': 0.02}).solve().trajectory
    message = plan_message(PENDULUM, plan, Time(nanoseconds=BEGIN + 200_000_000).to_msg())
    ros.publisher('/early/trajectory', JointTrajectory, LATCHED).publish(message)
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


def test_a_plan_is_given_up_when_simulated_time_begins_anew(ros):
    """A state measured then is planned from as it is: nobody follows the plan before."""
    given = {'limits.torque': 0.09, 'start.max_age': 10.0}
    planner = ros.start('tdm_planner.nodes.planner', given, namespace='anew', arguments=OWN)
    simulation = Simulation(ros, 'anew')
    plans = ros.subscribe('/anew/trajectory', JointTrajectory, LATCHED)
    pending = ros.request('/anew/plan', Trigger)
    assert ros.publish_until(lambda: simulation.at(100.0), pending.done)
    assert pending.result().success, pending.result().message
    # Half way up, by the plan, where the pendulum never was.
    simulation.at(100.98)
    simulation.at(99.9)
    assert 'simulated time was set back' in planner.output
    simulation.at(101.2)
    done, answer = ros.trigger('/anew/plan')
    assert done, answer
    assert ros.spin_until(lambda: len(plans) == 2)
    np.testing.assert_allclose(plans[-1].points[0].positions, [np.pi, 0.0], atol=1e-9)
