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
import math
import time
from typing import Any

import pytest
from ros_harness import ENOUGH, Ros
from std_srvs.srv import Trigger

outsiders = pytest.importorskip('outsider')  # Cyclone DDS: its wheels end at Python 3.13
STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.0, 'solver.deadline': ENOUGH}
TRAJECTORY, STATE = 'trajectory_msgs/msg/JointTrajectory', 'sensor_msgs/msg/JointState'


@pytest.fixture(scope='module')
def outsider(ros: Ros) -> Iterator[Any]:
    ros.start('tdm_planner.nodes.planner', STRONG, namespace='pendulum')
    made = outsiders.Outsider(ros.domain)
    yield made
    made.close()


@pytest.fixture(scope='module')
def client(outsider: Any) -> Any:
    return outsider.client('/pendulum/plan')


def test_an_outsider_asks_for_plans_and_reads_them(ros: Ros, outsider: Any, client: Any) -> None:
    success, answer = client.call()
    assert not success
    assert answer['code'] == 'NO_STATE'
    assert ros.set_parameters('/pendulum/planner', start__source='parameters') == ['']
    check_plan(outsider, client)
    check_diagnostics(outsider, client)
    # Both ask at once: each gets one answer, and a client of ROS its own.
    future = ros.request('/pendulum/plan', Trigger)
    client.ask()
    assert ros.spin_until(future.done, 30.0)
    assert any(fine for fine, _ in (client.reply(), client.reply()))
    done, answer = ros.trigger('/pendulum/plan')
    assert done, answer
    assert client.reply() == (True, answer)


def check_plan(outsider: Any, client: Any) -> None:
    """Check that it is made on request, and read by one who comes late."""
    before = time.time_ns()
    success, answer = client.call()
    assert success, answer
    plan = outsiders.one(outsider.subscribe('/pendulum/trajectory', TRAJECTORY, outsiders.LATCHED))
    assert plan.joint_names == ['pendulum', 'disk']
    assert before < outsiders.nanoseconds(plan.header.stamp)
    times = [outsiders.nanoseconds(point.time_from_start) for point in plan.points]
    assert times == sorted(set(times))
    assert times[-1] / 1e9 == pytest.approx(answer['duration'], abs=1e-6)
    first, last = plan.points[0], plan.points[-1]
    assert first.positions == [math.pi, 0.0]
    assert math.remainder(last.positions[0], 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
    assert last.velocities == [0.0, 0.0]
    assert all(abs(point.effort[1]) <= 0.09 + 1e-9 for point in plan.points)


def check_diagnostics(outsider: Any, client: Any) -> None:
    reader = outsider.subscribe('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
    _, answer = client.call()

    def told() -> bool:
        statuses = [status for array in reader.take(N=10) for status in array.status]
        figures = [
            {pair.key: pair.value for pair in status.values}
            for status in statuses
            if status.name == '/pendulum/planner: planning' and bytes([status.level]) == b'\0'
        ]
        return any(found['plan id'] == str(answer['plan_id']) for found in figures)

    outsiders.wait_until(told, 'diagnostics of the plan')


def test_a_rig_of_another_make_is_planned_for_and_commanded(
    ros: Ros, outsider: Any, client: Any
) -> None:
    """Its driver publishes joint_states by another DDS; the plan starts from there."""
    assert ros.set_parameters('/pendulum/planner', start__source='measured') == ['']
    writer = outsider.publish('/pendulum/joint_states', STATE)
    stamp_type, header_type = (
        outsiders.dds_type('builtin_interfaces/msg/Time'),
        outsiders.dds_type('std_msgs/msg/Header'),
    )

    def planned() -> bool:  # the first states may be lost, until the planner knows the writer
        header = header_type(stamp_type(*divmod(time.time_ns(), 10**9)), '')
        names, angles = ['disk', 'pendulum'], [1.0, math.pi]
        writer.write(outsiders.dds_type(STATE)(header, names, angles, [0.0, 0.0], []))
        return client.call()[0]

    outsiders.wait_until(planned, 'a plan from the states of another make')
    plan = outsiders.one(outsider.subscribe('/pendulum/trajectory', TRAJECTORY, outsiders.LATCHED))
    assert plan.points[0].positions == pytest.approx([math.pi, 1.0], abs=1e-6)
    ros.start('tdm_planner.nodes.tracker', namespace='pendulum')
    command = outsiders.one(outsider.subscribe('/pendulum/joint_command', STATE))
    assert command.name == ['disk']
    assert command.effort == [0.0]  # no state is measured any more
