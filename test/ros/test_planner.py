# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The planner as a process, over DDS: requests, answers, messages."""

from __future__ import annotations

import json
import math
from typing import Any

from marker_checks import check_markers, Scene
import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters, ListParameters
from ros_harness import Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, pendulum_trajectory, to_stamp
from tdm_planner.parameters import specifications
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.request import RequestParameters
from tdm_planner.verification import replay
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

ANSWER = ['plan_id', 'duration', 'cost', 'penalty', 'solve_time', 'evaluations', 'summary']
STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.0, 'solver.deadline': 5.0}


@pytest.fixture(scope='module')
def planner(ros: Ros) -> str:
    ros.start('tdm_planner.nodes.planner', STRONG, namespace='pendulum')
    return '/pendulum/planner'


@pytest.fixture(autouse=True)
def from_parameters(ros: Ros, planner: str) -> None:
    """Every test begins with the same parameters."""
    defaults = {'start.source': 'parameters', 'start.max_age': 0.5, 'start.delay': 0.5}
    start = {f'start.{name}': 0.0 for name in ('psi', 'theta_dot', 'psi_dot')}
    reset = {**STRONG, **defaults, **start, 'start.theta': math.pi, 'plant.mass': 0.024}
    assert set(ros.set_parameter_mapping(planner, reset)) == {''}


def plan(ros: Ros) -> tuple[bool, dict[str, Any]]:
    return ros.trigger('/pendulum/plan')


def late_trajectory(ros: Ros) -> Any:
    received = ros.subscribe('/pendulum/trajectory', JointTrajectory, LATCHED)
    assert ros.spin_until(lambda: bool(received))
    return received[-1]


def begins(message: JointTrajectory) -> int:
    """Return the start of a plan [ns]."""
    return nanoseconds_of(message.header.stamp)


def now(ros: Ros) -> int:
    return int(ros.node.get_clock().now().nanoseconds)


def joint_state(ros: Ros, state: list[float], age: float = 0.0) -> JointState:
    message = JointState(
        name=['arm', 'disk', 'pendulum'],
        position=[9.0, state[1], state[0]],
        velocity=[9.0, state[3], state[2]],
    )
    message.header.stamp = to_stamp(now(ros) - round(age * 1e9))
    return message


def test_a_plan_from_parameters(ros: Ros) -> None:
    received = ros.subscribe('/pendulum/trajectory', JointTrajectory, LATCHED)
    before = now(ros)
    done, answer = plan(ros)
    after = now(ros)
    assert done, answer
    assert list(answer) == ANSWER
    assert 0.3 < answer['duration'] < 0.5
    assert ros.spin_until(lambda: bool(received))
    message = received[-1]
    assert before + 0.5e9 <= nanoseconds_of(message.header.stamp) <= after + 0.5e9
    assert message.header.frame_id == 'world'
    assert list(message.joint_names) == ['pendulum', 'disk']
    assert list(message.points[0].positions) == [math.pi, 0.0]
    assert nanoseconds_of(message.points[0].time_from_start) == 0
    assert all(point.effort[0] == 0.0 for point in message.points)


def test_whoever_replays_the_message_ends_upright(ros: Ros) -> None:
    assert plan(ros)[0]
    trajectory = pendulum_trajectory(late_trajectory(ros))
    assert trajectory.interpolation == 'zero_order_hold'
    last = replay(RotaryPendulum(), trajectory, trajectory.times[-1:])[0]
    turned = math.remainder(last[0], 2 * math.pi)
    assert np.allclose([turned, last[1]], 0.0, atol=1e-4)
    assert np.allclose(last[2:], 0.0, atol=1e-3)


def test_plan_ids_increase_and_a_late_subscriber_gets_the_last_plan(ros: Ros) -> None:
    first = plan(ros)[1]['plan_id']
    ros.set_parameters('/pendulum/planner', start__theta=3.0)
    assert plan(ros)[1]['plan_id'] == first + 1
    assert late_trajectory(ros).points[0].positions[0] == 3.0


def test_the_summary_tells_everything_about_the_plan_in_force(ros: Ros) -> None:
    done, answer = plan(ros)
    assert done, answer
    received = ros.subscribe('/pendulum/plan_summary', String, LATCHED)
    assert ros.spin_until(lambda: bool(received))
    summary = json.loads(received[-1].data)
    assert '\n' not in received[-1].data
    assert {name: summary[name] for name in ANSWER} == answer
    stamp = late_trajectory(ros).header.stamp
    assert summary['stamp'] == {'sec': stamp.sec, 'nanosec': stamp.nanosec}
    assert summary['problem'] == 'pendulum_swing_up'
    check = summary['verification']
    assert check['ok']
    assert set(check['worst']) == set(check['worst_times']) == {'torque', 'disk_angle'}
    assert check['units'] == {'torque': 'N m', 'disk_angle': 'rad'}
    assert 0.0 <= check['worst_times']['disk_angle'] <= summary['duration']
    (vehicle,) = summary['vehicles'].values()
    assert vehicle['interpolation'] == 'zero_order_hold'
    assert vehicle['units']['torque'] == 'N m'
    problem = PendulumSwingUp.from_parameters(summary['parameters'])
    assert problem.limits.torque == 0.09
    assert problem.to_parameters() == summary['parameters']


def test_markers_show_the_path_and_the_goal(ros: Ros) -> None:
    assert plan(ros)[0]
    received = ros.subscribe('/pendulum/markers', MarkerArray, LATCHED)
    assert ros.spin_until(lambda: bool(received))
    check_markers(received[-1], 'world', 0.0)
    scene = Scene(received[-1])
    assert scene.names == {('planned_path', 0), ('goal', 0)}
    start, goal = scene['planned_path'].points[0], scene['goal'].pose.position
    assert start.z == pytest.approx(-0.129)
    assert (goal.x, goal.y, goal.z) == pytest.approx((0.085, 0.0, 0.129), abs=1e-3)


def test_no_state_was_received(ros: Ros) -> None:
    ros.set_parameters('/pendulum/planner', start__source='measured')
    done, answer = plan(ros)
    assert not done
    assert answer['code'] == 'NO_STATE'
    assert answer['reason'] == (
        'no state was received on /pendulum/joint_states within 0.5 s (start.max_age)'
    )


def test_a_request_before_the_first_state_waits_for_it(ros: Ros) -> None:
    ros.set_parameters('/pendulum/planner', start__source='measured', start__max_age=20.0)
    pending = ros.request('/pendulum/plan', Trigger)
    publisher = ros.publisher('/pendulum/joint_states', JointState)
    assert not pending.done()
    assert ros.publish_until(
        lambda: publisher.publish(joint_state(ros, [3.0, 0.2, 0.5, -0.4])), pending.done
    )
    assert pending.result().success, pending.result().message
    ros.node.destroy_publisher(publisher)


def test_a_plan_from_the_measured_state(ros: Ros) -> None:
    ros.set_parameters('/pendulum/planner', start__source='measured', start__delay=0.2)
    publisher = ros.publisher('/pendulum/joint_states', JointState)
    ros.spin_for(2.5)  # until earlier plans, which nobody follows, would be upright
    state = [3.0, 0.2, 0.5, -0.4]
    message = joint_state(ros, state)
    publisher.publish(message)
    ros.spin_for(0.1)
    done, answer = plan(ros)
    assert done, answer
    trajectory = late_trajectory(ros)
    wait = 1e-9 * (nanoseconds_of(trajectory.header.stamp) - nanoseconds_of(message.header.stamp))
    assert 0.2 < wait < 0.7
    expected = coasted(state, wait)
    point = trajectory.points[0]
    assert [*point.positions, *point.velocities] == pytest.approx(expected, abs=1e-6)
    ros.node.destroy_publisher(publisher)


def coasted(state: list[float], duration: float) -> list[float]:
    """Return the same by explicit small steps of the midpoint rule, extrapolated."""
    pendulum = RotaryPendulum()

    def midpoint(steps: int) -> Any:
        x, h = np.array(state), duration / steps
        for _ in range(steps):
            half = x + 0.5 * h * pendulum.derivative(x, np.zeros(1))
            x = x + h * pendulum.derivative(half, np.zeros(1))
        return x

    return list((4 * midpoint(4000) - midpoint(2000)) / 3)


def test_states_that_cannot_be_planned_from(ros: Ros) -> None:
    ros.set_parameters('/pendulum/planner', start__source='measured')
    publisher = ros.publisher('/pendulum/joint_states', JointState)

    def answer_to(message: JointState) -> dict[str, Any]:
        publisher.publish(message)
        ros.spin_for(0.1)
        done, answer = plan(ros)
        assert not done
        assert answer['code'] == 'NO_STATE'
        return answer

    old = answer_to(joint_state(ros, [3.0, 0.0, 0.0, 0.0], age=5.0))
    assert '/pendulum/joint_states is 5' in old['reason']
    assert 'must not be older than 0.5 s (start.max_age)' in old['reason']
    early = answer_to(joint_state(ros, [3.0, 0.0, 0.0, 0.0], age=-5.0))
    assert 'in the future' in early['reason']
    answer_to(joint_state(ros, [3.0, 0.0, 0.0, 0.0], age=5.0))
    other = JointState(name=['wheel'], position=[0.0], velocity=[0.0])
    assert 'joint(s) pendulum, disk must be named once' in answer_to(other)['reason']
    short = JointState(name=['pendulum', 'disk'], position=[0.0, 0.0])
    assert "'velocity' has 0 values for 2 named joints" in answer_to(short)['reason']
    broken = joint_state(ros, [math.nan, 0.0, 0.0, 0.0])
    assert 'position of joint pendulum is nan' in answer_to(broken)['reason']
    wild = answer_to(joint_state(ros, [3.0, 0.0, 1e12, 0.0]))
    assert 'velocity of joint pendulum is 1e+12 rad/s: must be in [' in wild['reason']
    without_stamp = joint_state(ros, [3.0, 0.0, 0.0, 0.0])
    without_stamp.header.stamp = to_stamp(0)
    publisher.publish(without_stamp)
    ros.spin_for(0.1)
    assert plan(ros)[0]
    ros.node.destroy_publisher(publisher)


def test_a_disk_in_motion_is_planned_for_sooner(ros: Ros) -> None:
    """Within the whole delay of a second it would coast beyond its limit."""
    received = ros.subscribe('/pendulum/trajectory', JointTrajectory, LATCHED)
    asked = now(ros)
    assert plan(ros)[0]  # one that has begun: for the start of another the request would wait
    assert ros.spin_until(lambda: bool(received) and begins(received[-1]) > asked)
    assert ros.spin_until(lambda: now(ros) > begins(received[-1]))
    ros.set_parameters('/pendulum/planner', start__source='measured', start__delay=1.0)
    publisher = ros.publisher('/pendulum/joint_states', JointState)
    seen = len(received)
    publisher.publish(joint_state(ros, [2.0, 0.0, 0.0, 2.5]))
    ros.spin_for(0.1)
    before = now(ros)
    done, answer = plan(ros)
    assert done, answer
    assert ros.spin_until(lambda: len(received) > seen)
    assert begins(received[-1]) - before < 0.6e9
    assert abs(received[-1].points[0].positions[1]) < 2.0
    ros.node.destroy_publisher(publisher)


def test_a_measured_disk_beyond_its_limit_is_an_invalid_problem(ros: Ros) -> None:
    ros.set_parameters('/pendulum/planner', start__source='measured')
    publisher = ros.publisher('/pendulum/joint_states', JointState)
    publisher.publish(joint_state(ros, [3.0, 2.5, 0.0, 0.0]))
    ros.spin_for(0.1)
    done, answer = plan(ros)
    assert not done
    assert answer['code'] == 'INVALID_PROBLEM'
    assert "'start.psi' = 2.5" in answer['reason']
    ros.node.destroy_publisher(publisher)


@pytest.mark.parametrize(
    ('name', 'value', 'allowed'),
    [
        ('plant.mass', -0.024, 'a number in (0, 1e+12] kg'),
        ('plant.mass', 0.0, 'a number in (0, 1e+12] kg'),
        ('plant.inertia.disk', 0.0, 'a number in (0, 1e+12] kg m^2'),
        ('plant.arm_length', math.nan, 'a number in (0, 1e+12] m'),
        ('plant.com_distance', math.inf, 'a number in (0, 1e+12] m'),
        ('limits.torque', 0.0, 'a number in (0, 1e+12] N m'),
        ('torque_reserve', 1.0, 'a number in [0, 1)'),
        ('torque_reserve', -0.1, 'a number in [0, 1)'),
        ('method', 'magic', 'one of '),
        ('solver.deadline', 'soon', 'a number in (0, 1e+12] s'),
        ('start.theta', True, 'a number'),
        ('start.source', 'guessed', 'one of measured, parameters'),
        ('goal.turns', 1.5, 'an integer'),
        ('problem', 'robot_formation', 'is fixed while the node runs'),
        ('limits.torqe', 0.1, 'did you mean limits.torque'),
    ],
)
def test_a_value_that_is_not_allowed_is_refused_and_the_node_serves_on(
    ros: Ros, planner: str, name: str, value: Any, allowed: str
) -> None:
    (reason,) = ros.set_parameter_mapping(planner, {name: value})
    assert f"parameter '{name}'" in reason
    assert allowed in reason


def test_after_all_refusals_it_plans(ros: Ros) -> None:
    assert plan(ros)[0]


@pytest.mark.parametrize(
    ('changes', 'back', 'code', 'says'),
    [
        ({'start.psi': 2.5}, {}, 'INVALID_PROBLEM', "'start.psi' = 2.5"),
        (
            {'plant.gravity': 1e-200},
            {'plant.gravity': 9.81},
            'INVALID_PROBLEM',
            "'plant.*'",
        ),
        (
            {'limits.torque': 1e-4, 'solver.deadline': 0.3},
            {},
            ('DEADLINE', 'INFEASIBLE', 'VERIFICATION_FAILED'),
            '',
        ),
    ],
)
def test_a_failed_request_leaves_the_plan_in_force(
    ros: Ros,
    planner: str,
    changes: dict[str, Any],
    back: dict[str, Any],
    code: str | tuple[str, ...],
    says: str,
) -> None:
    assert plan(ros)[0]
    in_force = late_trajectory(ros)
    received = ros.subscribe('/pendulum/trajectory', JointTrajectory, LATCHED)
    assert ros.spin_until(lambda: bool(received))
    assert set(ros.set_parameter_mapping(planner, changes)) == {''}
    done, answer = plan(ros)
    assert not done
    assert list(answer) == ['code', 'reason']
    assert answer['code'] in code
    assert says in answer['reason']
    ros.spin_for(0.2)
    assert received == [in_force]
    assert late_trajectory(ros) == in_force
    if back:
        ros.set_parameter_mapping(planner, back)


def test_every_parameter_is_declared_with_a_description(ros: Ros, planner: str) -> None:
    listed = ros.call(f'{planner}/list_parameters', ListParameters).result.names
    expected = {**specifications(RequestParameters), **specifications(PendulumSwingUp)}
    assert set(expected) <= set(listed)
    request = DescribeParameters.Request(names=list(expected))
    answer = ros.call(f'{planner}/describe_parameters', DescribeParameters, request)
    for described in answer.descriptors:
        spec = expected[described.name]
        assert described.description.startswith(spec.description)
        assert described.read_only == spec.read_only
        if spec.kind is float and spec.range.bounded:
            (allowed,) = described.floating_point_range
            assert (allowed.from_value, allowed.to_value) == (spec.range.lower, spec.range.upper)


def test_goal_turns_is_optional(ros: Ros, planner: str) -> None:
    assert ros.set_parameter_mapping(planner, {'goal.turns': 2}) == ['']
    assert plan(ros)[0]
    assert late_trajectory(ros).points[-1].positions[0] == pytest.approx(4 * math.pi, abs=1e-4)
    assert ros.set_parameter_mapping(planner, {'goal.turns': None}) == ['']
    assert plan(ros)[0]
    assert abs(late_trajectory(ros).points[-1].positions[0]) < 7.0
