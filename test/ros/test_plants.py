# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated pendulum and robot; what all plant nodes have in common is tested on the first."""

from collections.abc import Callable
from dataclasses import fields
import math

from diagnostic_msgs.msg import DiagnosticStatus
from double_integrator import DoubleIntegrator
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_harness import Space
from sensor_msgs.msg import JointState
from stated import Cart, changed
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.direct_method import Output
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.tracking.tracked_plants import PLANT_NODE
from tdm_sim import demo
from tdm_sim.stated_plant import _with_states

OK, WARN = 0, 1


def test_what_a_problem_cannot_call_its_parameters_are_those_of_the_simulated_plant() -> None:
    assert {item.name for item in fields(_with_states(Cart))} == PLANT_NODE


class Plant(Space):
    """A plant in a namespace of its own, and everything it publishes."""

    def __init__(self, ros: Stepped, role: str, name: str, given: dict) -> None:
        super().__init__(ros, name)
        self.name = f'/{name}/{role}: simulation'
        self.states, self.odom = self.hear('joint_states'), self.hear('odom')
        self.process = self.start(role, {'command_timeout': 30.0, **given})
        self.commands = self.publisher('joint_command')

    def command(self, names: list[str], effort: list[float], **more) -> None:
        self.commands.publish(JointState(name=names, effort=effort, **more))
        self.listen(0.1)

    def listen(self, seconds: float) -> None:
        """Receive what is published from now on, and nothing else."""
        self.ros.settle()
        self.states.clear()
        self.odom.clear()
        self.ros.spin_for(seconds)

    def told(self, *keys: str) -> tuple[int, str, list[float]]:
        """Return level, message and figures of the newest status, 1 s later."""
        self.listen(1.0)
        status = self.ros.statuses[self.name]
        figures = [float(self.ros.figure(self.name, key)) for key in keys]
        return status.level[0], status.message, figures

    def efforts(self, joint: int) -> list[float]:
        return [state.effort[joint] for state in self.states]


def times(messages: list) -> np.ndarray:
    return np.array([nanoseconds_of(message.header.stamp) for message in messages])


def test_unknown_parameters_and_commands_that_are_malformed_or_do_not_come_are_told_of(ros):
    given = {'plant.colour': 'red', 'initial.psi': 2.0, 'command_timeout': 0.2}
    given |= {'limit.torque': 1.0, 'limit.disk_angle': 2.0}
    rig = Plant(ros, 'pendulum_plant', 'wrong', given)
    for name, *effort in (('arm', 0.01), ('disk', math.nan), ('disk',)):
        rig.command([name], effort)
        assert not any(rig.efforts(1))
    words = 'joint_command ignored: joint(s) disk must be named once, but the names are: arm'
    assert words in rig.process.output
    assert "'plant.colour' is unknown" in rig.process.output
    assert "limits.disk_angle?; the value is ignored, and 1 more of 'limit" in rig.process.output
    assert rig.told('commands ignored', 'commands accepted', 'command time-outs')[2] == [3, 0, 0]
    rig.commands.publish(JointState(name=['disk'], effort=[0.003]))
    rig.listen(0.5)
    efforts = rig.efforts(1)
    assert efforts.count(0.003) == pytest.approx(40, abs=1)
    assert efforts == [0.003] * efforts.count(0.003) + [0.0] * efforts.count(0.0)
    assert 'no command for 0.2 s (command_timeout): actuators off' in rig.process.output
    assert rig.told('command time-outs')[2] == [1]


def test_a_second_node_that_commands_the_plant_is_told_of(ros):
    rig, told = Plant(ros, 'pendulum_plant', 'twice', {}), '2 nodes publish /twice/joint_command: '
    assert rig.told()[:2] == (OK, 'no command')
    other = rig.publisher('joint_command')
    level, message, _ = rig.told()
    assert level == WARN
    assert message.startswith(told)
    assert told in rig.process.output
    ros.node.destroy_publisher(other)
    assert ros.meet(lambda: ros.node.count_publishers('/twice/joint_command') == 1)
    assert rig.told()[:2] == (OK, 'no command')


def test_a_push_too_violent_to_integrate_is_told_of(ros):
    rig = Plant(ros, 'pendulum_plant', 'violent', {'disturbance.impulse': 1e12})
    rig.trigger('push')
    level, message, _ = rig.told()
    assert level == DiagnosticStatus.ERROR[0]
    assert message.startswith('reset 1 times: the motion could not be integrated')
    assert 'could not be integrated: back in the initial state' in rig.process.output


def test_slow_motion_and_what_a_stalled_process_leaves_out(ros):
    """At a tenth of the speed the pendulum covers a tenth of its velocity in the clock's time."""
    given = {'real_time_factor': 0.1, 'disturbance.impulse': 1e-4}
    rig = Plant(ros, 'pendulum_plant', 'slow', given)
    assert rig.trigger('push') == 'pushed the pendulum with 0.0001 N m s'
    rig.listen(0.3)
    states = np.array([[*s.position, *s.velocity] for s in rig.states])
    angles, rates = states[:, 0], states[:, 2]
    assert np.abs(rates).min() > 0.1
    ratios = np.diff(angles) / (np.diff(times(rig.states)) * 1e-9)
    assert ratios / (0.5 * (rates[1:] + rates[:-1])) == pytest.approx(0.1, rel=0.01)
    assert np.ptp([RotaryPendulum().energy(state) for state in states]) < 1e-8
    _, _, (before,) = rig.told('simulated time [s]')
    ros.step_to(ros.now + 500_000_000)
    level, message, (later,) = rig.told('simulated time [s]')
    assert level == WARN
    assert message.startswith('0.4')
    assert ' s skipped: the process was stalled' in message
    assert later - before == pytest.approx(0.1 * (1.0 - 0.4), abs=1e-3)


def position(message: Odometry) -> np.ndarray:
    return np.array([message.pose.pose.position.x, message.pose.pose.position.y])


def velocity_in_arena(message: Odometry) -> np.ndarray:
    """Read the twist as every user of odometry does: it is in the child's frame."""
    q, linear = message.pose.pose.orientation, message.twist.twist.linear
    turned = complex(linear.x, linear.y) * complex(q.w, q.z) ** 2
    return np.array([turned.real, turned.imag])


def rate_of(messages: list, quantity: Callable):
    change = quantity(messages[-1]) - quantity(messages[0])
    return change / (np.ptp(times(messages)) * 1e-9)


def command(robot: Plant, thrust: float, rate: float, torque: float) -> None:
    robot.command(['reaction_wheel', 'thruster'], [torque, thrust], velocity=[0.0, rate])


def test_a_drifting_robot_and_its_actuators(ros):
    given = {'x': 1.0, 'y': 2.5, 'yaw': 0.6, 'u': 0.2, 'v': -0.1, 'alpha': 0.3, 'wheel_speed': 5.0}
    given = {f'initial.{name}': value for name, value in given.items()}
    robot = Plant(ros, 'robot_plant', 'arena/drifter', given)
    robot.listen(0.5)
    first = robot.odom[0]
    assert (first.header.frame_id, first.child_frame_id) == ('arena', 'drifter')
    assert first.pose.pose.orientation.z == pytest.approx(math.sin(0.3))
    np.testing.assert_allclose(velocity_in_arena(first), [0.2, -0.1], atol=1e-9)
    np.testing.assert_allclose(rate_of(robot.odom, position), [0.2, -0.1], rtol=1e-6)
    joints = robot.states[0]
    assert list(joints.name) == ['thruster', 'reaction_wheel']
    assert joints.position[0] == pytest.approx(0.3)
    assert [*joints.velocity, *joints.effort] == [0.0, 5.0, 0.0, 0.0]
    assert rate_of(robot.states, lambda s: s.position[1]) == pytest.approx(5.0)
    command(robot, 0.5, 0.2, 0.001)
    expected = 0.5 / 10.5 * np.array([math.cos(0.91), math.sin(0.91)])  # along the thrust
    np.testing.assert_allclose(rate_of(robot.odom, velocity_in_arena), expected, rtol=0.02)
    last = robot.states[-1]
    assert (list(last.effort), last.velocity[0]) == ([0.5, 0.001], 0.2)
    assert last.position[0] == pytest.approx(0.32, abs=2e-3)
    assert last.velocity[1] < 5.0
    command(robot, 9.0, -9.0, 9.0)
    last = robot.states[-1]
    assert (list(last.effort), last.velocity[0]) == ([1.05, 0.02], -2.0)
    command(robot, -1.0, 0.0, 0.0)
    assert robot.states[-1].effort[0] == 0.0
    pushes = {robot.trigger('push') for _ in range(2)}  # each in a direction of its own
    assert len(pushes) == 2
    assert all(text.startswith('pushed drifter with 0.3 N s towards ') for text in pushes)


def test_push_reset_and_a_command_that_names_no_wheel_to_a_robot_with_a_name_of_its_own(ros):
    given = {'disturbance.impulse': 2.1, 'disturbance.direction': 0.0, 'rate': 100}
    given['robot_name'] = 'ball'
    robot = Plant(ros, 'robot_plant', 'arena/robot9', given)
    assert robot.trigger('push') == 'pushed ball with 2.1 N s towards 0.000 rad'
    robot.listen(0.1)
    assert len(robot.odom) == len(robot.states) == pytest.approx(10, abs=1)
    assert robot.odom[0].child_frame_id == 'ball'
    np.testing.assert_allclose(velocity_in_arena(robot.odom[-1]), [0.2, 0.0], atol=1e-9)
    robot.trigger('reset')
    robot.command(['thruster'], [1.0], velocity=[0.0])
    np.testing.assert_allclose(position(robot.odom[-1]), [2.0, 2.0])
    words = 'joint_command ignored: joint(s) reaction_wheel must be named once'
    assert words in robot.process.output
    assert robot.states[-1].effort[0] == 0.0
    robot.set('robot_plant', arena__robot_radius=0.2)


def test_robots_that_drift_begin_anew_when_a_demo_asks_for_a_plan(ros, tmp_path):
    values = '{robots: [robot1, robot2], robot1: {start: {u: 0.15, v: -0.1}}}'
    (tmp_path / 'two.yaml').write_text(f'/**/planner:\n  ros__parameters: {values}\n')
    scene = demo.make_scene('robots', tmp_path / 'two.yaml')
    scene.listen(ros.node)
    robots = [ros.start(p.executable, p.parameters, p.namespace).node for p in scene.plants]
    answers = ['{"code": "NO_STATE", "reason": "none"}', '{"summary": "a plan"}']
    away = []

    def plan(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        away.extend(r.simulation.state[:2] - r.simulation.setup.initial[:2] for r in robots)
        response.message, response.success = answers.pop(0), not answers
        return response

    ros.node.create_service(Trigger, '/robots/plan', plan)
    ros.spin_for(10.0)
    assert robots[0].simulation.state[0] - robots[0].simulation.setup.initial[0] > 1.4
    assert demo._ask(scene, ros.spin_until) == {'summary': 'a plan'}
    for moving, resting in (away[:2], away[2:]):
        assert 0.09 < moving[0] / 0.15 < 0.2  # s since it began
        assert moving[0] / 0.15 == pytest.approx(moving[1] / -0.1)
        assert not resting.any()


def test_states_stream_with_noise_commands_saturate_and_parameters_act_at_once(ros):
    rig = Plant(ros, 'pendulum_plant', 'shared', {'noise.theta': 0.01, 'mismatch': 0.05})
    assert rig.told()[0] == OK
    thetas = np.array([state.position[0] for state in rig.states])
    assert (thetas.mean(), thetas.std()) == pytest.approx((math.pi, 0.01), abs=0.003)
    rig.set('pendulum_plant', noise__theta=0.0, mismatch=0.0)
    rig.trigger('reset')
    rig.listen(1.0)
    assert (np.diff(times(rig.states)) == 5_000_000).all()
    assert len(rig.states) == pytest.approx(200, abs=1)
    state = rig.states[-1]
    assert list(state.name) == ['pendulum', 'disk']
    assert [*state.position, *state.velocity] == pytest.approx([math.pi, 0.0, 0.0, 0.0])
    rig.command(['disk'], [0.004])
    assert set(rig.efforts(1)) == {0.004}
    assert rig.states[-1].velocity[1] > 0.1
    rig.command(['other', 'disk'], [9.0, -1.0])
    assert {tuple(state.effort) for state in rig.states} == {(0.0, -0.02)}
    rig.set('pendulum_plant', initial__theta=0.5, limits__torque=0.001)
    rig.trigger('reset')
    rig.command(['disk'], [0.01])
    assert set(rig.efforts(1)) == {0.001}
    assert rig.states[0].position[0] == pytest.approx(0.5, abs=0.01)
    (reason,) = ros.set_parameters('/shared/pendulum_plant', noise__theta=math.nan)
    assert 'noise.theta' in reason
    # Each value is allowed, but a point mass on a massless arm leaves the equations singular.
    rig.set('pendulum_plant', {f'plant.inertia.{name}': 1e-12 for name in ('disk', 'y', 'z')})
    (reason,) = ros.set_parameters('/shared/pendulum_plant', plant__mass=1.0)
    assert 'do not make a rig' in reason


Loose = changed(
    DoubleIntegrator,
    name='loose',
    outputs=lambda s: {'x': Output(start=(s.start.x,), end=(0.0, 0.0), free=6)},
    start_conditions=lambda s, t, x: [x[1] - s.start.v],
)


def test_what_is_free_at_the_start_begins_as_the_group_start_has_it(ros):
    """As the pitch of a quadrotor, which `start_conditions` asks for."""
    space = Space(ros, 'loose')
    space.start('plant', {'problem': f'{__name__}:Loose', 'start.v': 0.5, 'held': True})
    states = space.hear('joint_states')
    assert ros.spin_until(lambda: states)
    assert dict(zip(states[-1].name, states[-1].position, strict=True)) == {
        'x': -1.0,
        'v': 0.5,
        'u': 0.0,
    }
