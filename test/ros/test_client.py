# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Who asks nodes over DDS: the planner's client for Python, the live page without a browser."""

from collections.abc import Callable
from functools import partial
import math
from pathlib import Path
import re

import numpy as np
import pytest
import rclpy
from ros_harness import SOURCE, Space
from std_msgs.msg import String
from stepped_ros import Stepped
from tdm_planner.client import PlanClient, PlanResult
from tdm_planner.exceptions import ERRORS, Infeasible, InvalidProblem, NoAnswer, NoState
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_sim.live.listener import Listener, PLANNING, ROLES, SILENT, SIMULATION
from tdm_sim.live.operations import Operations, Recordings
from tdm_sim.live.rig import Rig
from tdm_sim.live.scene import drag_handles_of
from viser.transforms import SO3

STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.0, 'start.source': 'parameters'}
SPACE = 'seen'


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
        other = ros.do(client.plan_with, {'goal.turns': np.int64(2), 'start.theta': 3})
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


def test_every_code_of_the_planner_has_its_exception():
    promised = 'INVALID_PROBLEM NO_STATE INFEASIBLE DEADLINE VERIFICATION_FAILED'
    assert {error.code for error in ERRORS} == {*promised.split(), 'BUSY', 'INACTIVE', 'INTERNAL'}


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
    assert any('no plant publishes' in warning for warning in plan.warnings)


def test_the_program_of_the_page_runs(ros, capsys):
    ros.start('planner', STRONG, 'pendulum')
    page = SOURCE / 'docs' / 'clients.md'
    (program,) = re.findall(r'```python\n(.*?)```', page.read_text(), re.DOTALL)
    ros.do(exec, program, {}, still=True)
    said = capsys.readouterr().out
    assert 'plan 1 takes' in said, said
    assert 'largest torque: 0.06 N m' in said


class Seen(Space):
    """The nodes of a pendulum, a listener, and operations whose deeds are told to `texts`."""

    def __init__(self, ros: Stepped, folder: Path) -> None:
        super().__init__(ros, SPACE)
        strong = {'limits.torque': 0.09}
        self.plant = self.start('pendulum_plant', strong)
        self.start('tracker', strong)
        self.start('planner', {**strong, 'torque_reserve': 0.0})
        self.listener = Listener(SPACE, ros._context)
        ros._executor.add_node(self.listener.node)
        self.rig = Rig(self.listener)
        self.texts: list[str] = []
        recordings = Recordings(folder, SPACE)
        self.operations = Operations(self.rig, self.listener, recordings, self.texts.append)
        self.plans = self.hear('trajectory')
        assert ros.spin_until(lambda: all(map(self.listener.parameters_of, ROLES)))
        self.rig.follow(self.values(PLANNING))
        assert ros.spin_until(lambda: self.rig.move() or bool(self.rig.motions))

    def values(self, role: str) -> dict:
        return self.listener.parameters_of(role).values

    def state(self):
        self.rig.move()
        return self.rig.motions['pendulum'].state

    def told(self, deed: Callable[[], None]) -> str:
        """Do something by hand; returns what was told of it."""
        count = len(self.texts)

        def done() -> bool:
            self.rig.motions = {n: m for n, v in self.rig.vehicles.items() if (m := v.newest())}
            return len(self.texts) > count

        deed()
        assert self.ros.spin_until(done, 20.0)
        return self.texts[-1]

    def close(self) -> None:
        self.operations.close()
        self.ros._executor.remove_node(self.listener.node)
        self.listener.close()


@pytest.fixture
def seen(ros: Stepped, tmp_path: Path):
    made = Seen(ros, tmp_path)
    yield made
    made.close()


def test_nodes_and_their_parameters_are_known_pushes_and_resets_are_followed(seen):
    listener = seen.listener
    plants = [f'/{SPACE}/pendulum_plant']
    assert [node.name for node in listener.having(SIMULATION)] == plants
    assert not any(node.silent for node in listener.nodes.values())
    assert seen.values(PLANNING)['limits.torque'] == 0.09
    assert listener.with_parameter('weights.theta') == [f'/{SPACE}/tracker']
    assert seen.state() == pytest.approx([math.pi, 0.0, 0.0, 0.0])
    assert seen.ros.spin_until(lambda: len(listener.events) > 0)
    before = listener.changes
    seen.ros.do(listener.set_parameters, plants, {'disturbance.impulse': 3e-4})
    values = seen.values(SIMULATION)
    assert seen.ros.spin_until(lambda: values['disturbance.impulse'] == 3e-4)
    assert listener.changes > before
    every = listener.with_parameter('limits.torque')
    assert len(every) == 3
    with pytest.raises(InvalidProblem, match=r"'limits.torque' = -1.0 is not allowed"):
        seen.ros.do(listener.set_parameters, every, {'limits.torque': -1.0})
    assert 'pushed' in seen.told(seen.operations.push)
    assert seen.ros.spin_until(lambda: abs(seen.state()[2]) > 0.1)
    assert 'initial' in seen.told(seen.operations.reset)
    assert seen.ros.spin_until(lambda: abs(seen.state()[2]) < 1e-9)
    told = seen.told(lambda: seen.operations.pull('pendulum', (0.0, 0.0, 0.0), (0.0, -1.0, 0.0)))
    assert '-' in told
    assert seen.values(SIMULATION)['disturbance.impulse'] == pytest.approx(3e-4)


def test_a_start_that_is_dragged_is_planned_from_and_a_slider_acts_on_all_nodes(seen):
    assert seen.ros.change(f'/{SPACE}/tracker', 'deactivate')  # nothing moves
    handle = drag_handles_of(seen.rig.problem)[0]
    pose = np.zeros(3), SO3.from_z_radians(0.5).wxyz
    assert seen.told(lambda: seen.operations.drag(handle, pose, seen.texts.append)) == ''
    assert seen.values(SIMULATION)['initial.psi'] == pytest.approx(0.5)
    assert seen.ros.spin_until(seen.rig.move)
    states = seen.rig.planned('pendulum').trajectory.states
    assert states[0, 1] == pytest.approx(0.5, abs=0.05)
    name, before = 'limits.disk_angle', seen.rig.plan

    def change(value: float) -> str:
        return seen.told(lambda: seen.operations.change(name, value, seen.texts.append))

    assert change(2.5) == ''
    assert seen.ros.spin_until(lambda: all(seen.values(role)[name] == 2.5 for role in ROLES))
    assert seen.rig.move()
    good = seen.rig.plan
    assert good is not before
    seen.told(seen.operations.reset)
    assert 'INVALID_PROBLEM' in change(0.3)  # the start is beyond it
    assert not seen.rig.move()
    assert seen.rig.plan is good
    # A switch turns replanning on.
    assert '5 Hz' in seen.told(lambda: seen.operations.replan(True))
    assert seen.ros.spin_until(lambda: seen.values(PLANNING)['replan.rate'] == 5.0)


def test_the_page_shows_motion_plan_grips_and_curves(seen, tmp_path):
    viser = pytest.importorskip('viser')
    from tdm_sim.live.page import Page

    assert 'upright' in seen.told(seen.operations.plan)
    server = viser.ViserServer(host='127.0.0.1', port=0, verbose=False)
    page = Page(server, seen.listener, Recordings(tmp_path, SPACE), 'seen')
    try:
        page.news()  # nothing is known yet
        for number in (1, 2):
            for _ in range(20):
                seen.ros.spin_for(0.05)
                page.frame()
            plan, newest = page._rig.plan, seen.plans[-1].header.stamp
            assert (plan.plan_id, plan.start) == (number, nanoseconds_of(newest))
            reference = page._rig.planned('pendulum').reference(plan.start * 1e-9)
            assert math.cos(reference[0]) == pytest.approx(2 * number - 3, abs=0.01)
            page.figures()
            seen.plan()
        page.figures()
        page.news('a node ended')
        shown = set(server.scene._handle_from_node_name)
        assert {'/still/lines', '/plants/cylinder_100', '/plan/lines'} <= shown
        assert {'/handles/disk', '/handles/pendulum'} <= shown
        status = page._panel._status.content
        charts = {title for title, *_ in page._panel._charts}
        assert all(text in status for text in ('a node ended', 'planner', 'plan ', 'solved in'))
        assert {'theta, psi [rad]', 'torque [N m]', 'margins of the limits'} <= charts
        assert 'limits.torque' in page._panel._sliders
        shown_handle = page._scene.handles['disk']
        before = np.array(shown_handle.control.wxyz)
        shown_handle.tell('INFEASIBLE: why')
        assert '/handles/disk/reason' in server.scene._handle_from_node_name
        shown_handle.tell('')
        assert '/handles/disk/reason' not in server.scene._handle_from_node_name
        shown_handle.move((np.zeros(3), SO3.from_z_radians(1.0).wxyz))
        assert not np.allclose(before, shown_handle.control.wxyz)
    finally:
        page.close()
        server.stop()


def test_a_node_that_is_gone_is_missed_and_known_again_when_it_is_back(seen):
    ros, listener = seen.ros, seen.listener
    seen.plant.end()
    gone = listener.having(SIMULATION)[0].name
    assert ros.spin_until(lambda: listener.nodes[gone].silent, SILENT + 3.0)
    seen.start('pendulum_plant', {'initial.theta': 3.0})
    assert ros.spin_until(lambda: not listener.nodes[gone].silent)
    assert ros.spin_until(lambda: gone in listener.declared)
    assert seen.values(SIMULATION)['initial.theta'] == 3.0
    assert ros.spin_until(lambda: abs(seen.state()[0] - 3.0) < 0.2)
