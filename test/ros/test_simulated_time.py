# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nodes with `use_sim_time` before, and after, the first message on `/clock`."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rclpy.time import Time
from ros_harness import Ros
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, pendulum_message
from tdm_planner.problems import PendulumSwingUp
from trajectory_msgs.msg import JointTrajectory

BEGIN = 1_800_000_000_000_000_000  # ns
STEP = 10_000_000  # ns


def texts(diagnostics: list[DiagnosticArray], name: str) -> list[str]:
    return [
        status.message
        for array in diagnostics
        for status in array.status
        if status.name.startswith(name)
    ]


def test_a_planner_without_time_makes_no_plan(ros: Ros) -> None:
    parameters = {'use_sim_time': True, 'start.source': 'parameters'}
    planner = ros.start('tdm_planner.nodes.planner', parameters, namespace='timeless')
    done, answer = ros.trigger('/timeless/plan', timeout=60.0)
    assert not done
    assert answer['code'] == 'NO_STATE'
    assert '/clock' in answer['reason']
    planner.end_cleanly()


def test_a_plan_that_comes_before_the_time_is_followed_when_it_is_known(ros: Ros) -> None:
    parameters = {'use_sim_time': True, 'rate': 100.0}
    tracker = ros.start('tdm_planner.nodes.tracker', parameters, namespace='early')
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 50)
    in_force = ros.subscribe('/early/trajectory_in_force', JointTrajectory, LATCHED)
    commands = ros.subscribe('/early/joint_command', JointState, 50)
    plan = PendulumSwingUp.from_parameters({'limits.torque': 0.02}).solve().trajectory
    message = pendulum_message(plan, Time(nanoseconds=BEGIN + 50 * STEP).to_msg())
    ros.publisher('/early/trajectory', JointTrajectory, LATCHED).publish(message)
    assert ros.spin_until(
        lambda: any('/clock' in text for text in texts(diagnostics, '/early/tracker')), 20.0
    )
    assert not in_force

    clock = ros.publisher('/clock', Clock)
    states = ros.publisher('/early/joint_states', JointState)
    hanging = JointState(name=['pendulum', 'disk'], position=[np.pi, 0.0], velocity=[0.0, 0.0])
    for k in range(120):
        now = Time(nanoseconds=BEGIN + k * STEP).to_msg()
        clock.publish(Clock(clock=now))
        hanging.header.stamp = now
        states.publish(hanging)
        ros.spin_for(0.01)
    assert ros.spin_until(lambda: any(one.points for one in in_force), 10.0), tracker.output
    assert any(any(command.effort) for command in commands)
    assert 'refused' not in tracker.output
    assert not texts(diagnostics[-1:], '/early/tracker')[0].startswith('simulated')
    tracker.end_cleanly()


def test_a_plan_is_given_up_when_simulated_time_begins_anew(ros: Ros) -> None:
    """A state measured then is planned from as it is: nobody follows the plan before."""
    parameters = {'use_sim_time': True, 'limits.torque': 0.09, 'solver.deadline': 10.0}
    parameters['start.max_age'] = 10.0
    planner = ros.start('tdm_planner.nodes.planner', parameters, namespace='anew')
    clock = ros.publisher('/clock', Clock)
    states = ros.publisher('/anew/joint_states', JointState)
    plans = ros.subscribe('/anew/trajectory', JointTrajectory, LATCHED)

    def at(seconds: float) -> None:
        now = Time(nanoseconds=BEGIN + round(seconds * 1e9)).to_msg()
        hanging = JointState(name=['pendulum', 'disk'], position=[np.pi, 0.0], velocity=[0.0, 0.0])
        hanging.header.stamp = now
        clock.publish(Clock(clock=now))
        ros.spin_for(0.05)
        states.publish(hanging)
        ros.spin_for(0.05)

    pending = ros.request('/anew/plan', Trigger)
    assert ros.publish_until(lambda: at(100.0), pending.done, 60.0)
    assert pending.result().success, pending.result().message
    # Half way up, by the plan, where the pendulum never was.
    at(100.98)
    at(99.9)
    assert ros.spin_until(lambda: 'simulated time was set back' in planner.output)
    at(101.2)
    done, answer = ros.trigger('/anew/plan', timeout=60.0)
    assert done, answer
    assert ros.spin_until(lambda: len(plans) == 2)
    np.testing.assert_allclose(plans[-1].points[0].positions, [np.pi, 0.0], atol=1e-9)
    planner.end_cleanly()
