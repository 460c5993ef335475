# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Planner and tracker as seen through another implementation of DDS, without any of ROS."""

from __future__ import annotations

from collections.abc import Iterator
import json
import math
import time

from dds_types import DiagnosticArray, Header, JointState, JointTrajectory, Time
from outsider import Client, LATCHED, one, Outsider, wait_until
import pytest
from ros_harness import Ros
from std_srvs.srv import Trigger

STRONG = {
    'limits.torque': 0.09,
    'torque_reserve': 0.0,
    'solver.deadline': 20.0,
    'start.source': 'parameters',
}


@pytest.fixture(scope='module')
def outsider(ros: Ros) -> Iterator[Outsider]:
    ros.start('tdm_planner.nodes.planner', STRONG, namespace='pendulum')
    made = Outsider(ros.domain)
    yield made
    made.close()


@pytest.fixture(scope='module')
def client(outsider: Outsider) -> Client:
    return outsider.client('/pendulum/plan')


def seconds(header: Header) -> float:
    return header.stamp.nanoseconds / 1e9


def test_a_plan_is_made_on_request_and_read_late(outsider: Outsider, client: Client) -> None:
    before = time.time()
    reply = client.call()
    answer = json.loads(reply.message)
    assert reply.success, answer
    plan: JointTrajectory = one(
        outsider.subscribe('/pendulum/trajectory', JointTrajectory, LATCHED)
    )
    assert plan.joint_names == ['pendulum', 'disk']
    assert before < seconds(plan.header) < time.time() + 1.0
    times = [point.time_from_start.nanoseconds for point in plan.points]
    assert times == sorted(set(times))
    assert times[-1] / 1e9 == pytest.approx(answer['duration'], abs=1e-6)
    first, last = plan.points[0], plan.points[-1]
    assert first.positions == [math.pi, 0.0]
    assert math.remainder(last.positions[0], 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
    assert last.velocities == [0.0, 0.0]
    assert all(abs(point.effort[1]) <= 0.09 + 1e-9 for point in plan.points)


def test_diagnostics_tell_of_the_plan(outsider: Outsider, client: Client) -> None:
    reader = outsider.subscribe('/diagnostics', DiagnosticArray)
    answer = json.loads(client.call().message)

    def told() -> bool:
        statuses = [status for array in reader.take(N=10) for status in array.status]
        figures = [
            {pair.key: pair.value for pair in status.values}
            for status in statuses
            if status.name == '/pendulum/planner: planning' and status.level == 0
        ]
        return any(found['plan id'] == str(answer['plan_id']) for found in figures)

    wait_until(told, 'diagnostics of the plan')


def test_a_failure_is_answered_with_code_and_reason(ros: Ros, client: Client) -> None:
    assert ros.set_parameters('/pendulum/planner', start__source='measured') == ['']
    try:
        reply = client.call()
    finally:
        assert ros.set_parameters('/pendulum/planner', start__source='parameters') == ['']
    assert not reply.success
    assert json.loads(reply.message)['code'] == 'NO_STATE'


def test_a_rig_of_another_make_is_planned_for(
    ros: Ros, outsider: Outsider, client: Client
) -> None:
    """Its driver publishes joint_states by another DDS; the plan starts from there."""
    writer = outsider.publish('/pendulum/joint_states', JointState)
    assert ros.set_parameters('/pendulum/planner', start__source='measured') == ['']

    answers: list[str] = []

    def planned() -> bool:
        nanoseconds = time.time_ns()
        stamp = Time(nanoseconds // 10**9, nanoseconds % 10**9)
        header = Header(stamp=stamp, frame_id='')
        writer.write(JointState(header, ['disk', 'pendulum'], [1.0, math.pi], [0.0, 0.0], []))
        reply = client.call()
        answers.append(reply.message)
        return bool(reply.success)

    try:
        # The first states may be lost, until the planner knows the writer.
        for _ in range(20):
            if planned():
                break
    finally:
        assert ros.set_parameters('/pendulum/planner', start__source='parameters') == ['']
    assert 'plan_id' in answers[-1], answers
    plan = one(outsider.subscribe('/pendulum/trajectory', JointTrajectory, LATCHED))
    assert plan.points[0].positions == pytest.approx([math.pi, 1.0], abs=1e-6)


def test_clients_of_ros_are_not_confused_by_others(ros: Ros, client: Client) -> None:
    """Both ask at once; each gets one answer, and a client of ROS its own."""
    future = ros.request('/pendulum/plan', Trigger)
    client.ask()
    assert ros.spin_until(future.done, 30.0)
    replies = [client.reply(), client.reply()]
    messages = [reply.message for reply in replies]
    assert future.result().message in messages
    assert any(reply.success for reply in replies)
    done, answer = ros.trigger('/pendulum/plan')
    assert done, answer
    assert json.loads(client.reply().message) == answer


def test_the_tracker_commands_a_motor_of_another_make(ros: Ros, outsider: Outsider) -> None:
    ros.start('tdm_planner.nodes.tracker', {'kind': 'pendulum'}, namespace='pendulum')
    command: JointState = one(outsider.subscribe('/pendulum/joint_command', JointState))
    assert command.name == ['disk']
    assert command.effort == [0.0]  # no state is measured
    assert abs(seconds(command.header) - time.time()) < 10.0
