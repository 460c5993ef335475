# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The planner's client for Python, with a node of its own or the user's, over DDS."""

from functools import partial
import math
import re

import numpy as np
import pytest
import rclpy
from ros_harness import SOURCE
from std_msgs.msg import String
from stepped_ros import Stepped
from tdm_planner.client import PlanClient, PlanResult
from tdm_planner.exceptions import ERRORS, Infeasible, InvalidProblem, NoAnswer, NoState
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import PendulumSwingUp, RobotFormation

STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.0, 'start.source': 'parameters'}


@pytest.fixture(scope='module')
def space(ros: Stepped) -> str:
    ros.start('planner', STRONG, 'clients')
    return 'clients'


@pytest.fixture
def user(ros: Stepped):
    node = rclpy.create_node('user', context=ros._context)
    yield node
    node.destroy_node()


@pytest.mark.parametrize('served', [None, True, False])
def test_a_plan_comes_as_a_trajectory_with_its_figures(ros, space, user, served):
    """To a node of its own, one that the test's executor serves, and one that nobody serves."""
    node = {None: None, True: ros.node, False: user}[served]
    with PlanClient(space, node=node) as client:
        ros.do(client.wait, still=True)
        plan: PlanResult = ros.do(client.plan, still=True)
        assert plan.start == ros.now + 1_000_000_000
        trajectory = plan.trajectory
        assert list(plan.trajectories) == ['pendulum']
        assert trajectory.state_names == RotaryPendulum.state_names
        assert (trajectory.units['torque'], trajectory.interpolation) == ('N m', 'zero_order_hold')
        assert trajectory.duration == pytest.approx(plan.duration)
        assert PendulumSwingUp.from_parameters(plan.parameters).limits.torque == 0.09
        other = ros.do(client.plan_with, {'goal': {'turns': np.int64(2)}, 'start.theta': 3})
        assert (other.plan_id, other.trajectory.states[0, 0]) == (plan.plan_id + 1, 3.0)
        assert other.trajectory.states[-1, 0] == pytest.approx(4 * math.pi, abs=1e-4)
        smooth = ros.do(partial(client.plan_with, method='smooth'))
        assert smooth.trajectory.interpolation != 'zero_order_hold'
        assert ros.do(client.plan).trajectory.states[-1, 0] == trajectory.states[-1, 0]


@pytest.mark.parametrize(
    ('own', 'error', 'says'),
    [
        ({'limits.torque': -1}, InvalidProblem, "'limits.torque' = -1 is not allowed"),
        ({'start.source': 'measured', 'start.max_age': 0.1}, NoState, 'no state was received'),
        ({'limits.torque': 1e-4, 'solver.deadline': 0.3}, Infeasible, '.'),
    ],
    ids=str,
)
def test_failures_are_exceptions_with_code_and_reason(ros, space, user, own, error, says):
    with PlanClient(f'/{space}', node=user) as client, pytest.raises(error, match=says) as raised:
        ros.do(client.plan_with, own)
    assert raised.value.reason == str(raised.value)
    assert raised.value.code in ('INVALID_PROBLEM', 'NO_STATE', 'INFEASIBLE', 'DEADLINE')


@pytest.mark.parametrize('value', [{'a'}, [1, 'a']], ids=str)
def test_a_value_that_no_parameter_can_have_is_named(ros, space, user, value):
    named = pytest.raises(InvalidProblem, match=r"^parameter 'start\.psi' = .* is not allowed")
    with PlanClient(f'/{space}', node=user) as client, named:
        ros.do(client.plan_with, {'start': {'psi': value}})


def test_every_code_of_the_planner_has_its_exception():
    promised = 'INVALID_PROBLEM NO_STATE INFEASIBLE DEADLINE VERIFICATION_FAILED'
    assert {error.code for error in ERRORS} == {*promised.split(), 'BUSY', 'INACTIVE', 'INTERNAL'}


def test_a_namespace_that_cannot_be_one_is_refused():
    with pytest.raises(InvalidProblem, match=r"^namespace = '/a b' is not allowed: .*characters"):
        PlanClient('/a b')


def test_without_a_planner_there_is_no_answer(ros, user):
    with PlanClient('nowhere', node=user) as client:
        stranger = ros.publisher('/nowhere/plan_summary')
        for data in ('no JSON', '[]', '{"vehicles": {"1 2": 3}}', '{"vehicles": {}}'):
            stranger.publish(String(data=data))
        with pytest.raises(NoAnswer, match='no planner serves /nowhere/plan_with'):
            client.wait(0.05)
        with pytest.raises(NoAnswer):
            client.plan(timeout=0.05)
    ros.node.destroy_publisher(stranger)


def test_robots_have_a_trajectory_each(ros):
    given = {'problem': 'robot_formation', 'start.source': 'parameters'}
    ros.start('planner', given, 'fleet_of_clients')
    with PlanClient('fleet_of_clients', node=ros.node) as client:
        plan = ros.do(client.plan_with, {'formation.anchor': [2, 1.5, 0.5]})
    goals = RobotFormation.from_parameters({'formation.anchor': [2.0, 1.5, 0.5]}).task.goal
    for goal, trajectory in zip(goals, plan.trajectories.values(), strict=True):
        np.testing.assert_allclose(trajectory.states[-1, :2], goal, atol=5e-3)
        assert trajectory.control_names == ('thrust', 'thruster_rate', 'torque')
    assert list(plan.trajectories) == ['robot1', 'robot2', 'robot3']
    assert plan.trajectory.state_names[7:9] == ('robot2.x', 'robot2.y')
    end = np.reshape(plan.trajectory.states[-1], (3, -1))[:, :2]
    np.testing.assert_allclose(end, list(goals), atol=5e-3)


def test_the_program_of_the_page_runs(ros, capsys):
    ros.start('planner', STRONG, 'pendulum')
    page = SOURCE / 'docs' / 'clients.md'
    (program,) = re.findall(r'```python\n(.*?)```', page.read_text(), re.DOTALL)
    ros.do(exec, program, {}, still=True)
    said = capsys.readouterr().out
    assert 'plan 1 takes' in said, said
    assert 'largest torque: 0.018 N m' in said, said
