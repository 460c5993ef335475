# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The planner over DDS, of a pendulum and of robots: requests, answers, messages."""

from functools import partial
import json
import math

from action_msgs.msg import GoalStatus, GoalStatusArray
from marker_checks import check_markers
import numpy as np
from pendulum_rig import measured_state
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from replays import by_scipy
from ros_harness import parameters, Space
from sensor_msgs.msg import JointState
from stepped_ros import Stepped
from tdm_planner.nodes.messages import odometry, to_stamp
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.nodes.tracker_plans import goal_status
from tdm_planner.plant_kind import PENDULUM, ROBOT
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory

OK, WARN = 0, 1
ANSWER = ['plan_id', 'duration', 'cost', 'penalty', 'solve_time', 'evaluations', 'summary']
STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.0}
UNREADABLE = Parameter(name='method', value=ParameterValue(type=255))
FORMATION, ROBOTS = {'problem': 'robot_formation'}, ['robot1', 'robot2', 'robot3']
MOVED = [2.3, 1.8, 0.7]


class Planner(Space):
    """A planner in a namespace of its own, and a pendulum that the test measures."""

    def __init__(self, ros: Stepped, **given) -> None:
        super().__init__(ros)
        named = {name.replace('__', '.'): value for name, value in given.items()}
        self.here = self.start('planner', {**STRONG, **named})
        self.trajectories = self.hear('trajectory')
        self.states = self.publisher('joint_states')

    def made(self) -> JointTrajectory:
        self.plan()
        return self.trajectories[-1]

    def plan_with(self, *odd: Parameter, **own) -> tuple[bool, dict]:
        result = self.ros.set_all(f'{self.space}/plan_with', *odd, **own)
        self.ros.settle()
        return result.successful, json.loads(result.reason)

    def summary(self) -> dict:
        return json.loads(self.latched('plan_summary').data)

    def state(self, state: list[float], age: float = 0.0) -> JointState:
        at, joints = self.ros.now - round(age * 1e9), ['arm', 'disk', 'pendulum']
        position, velocity = [9.0, state[1], state[0]], [9.0, state[3], state[2]]
        return measured_state(at, name=joints, position=position, velocity=velocity)

    def measure(self, message: JointState) -> None:
        self.states.publish(message)
        self.ros.settle()


@pytest.fixture(scope='module')
def planner(ros: Stepped) -> Planner:
    return Planner(ros, start__source='parameters')


def begins(message: JointTrajectory) -> int:
    return nanoseconds_of(message.header.stamp)


def test_a_plan_is_answered_published_and_told_of(ros, planner):
    before = ros.now
    answer = planner.plan()
    message = planner.latched('trajectory')
    assert begins(message) == before + 1_000_000_000
    assert (message.header.frame_id, [*message.joint_names]) == ('world', ['pendulum', 'disk'])
    assert list(message.points[0].positions) == [math.pi, 0.0]
    assert nanoseconds_of(message.points[0].time_from_start) == 0
    assert all(point.effort[0] == 0.0 for point in message.points)
    # Whoever replays the message ends upright.
    trajectory = read_plan(PENDULUM, message)
    assert trajectory.interpolation == 'zero_order_hold'
    assert trajectory.duration == pytest.approx(answer['duration'])
    assert 0.3 < trajectory.duration < 0.5
    last = by_scipy(RotaryPendulum(), trajectory).states(trajectory.times[-1:])[0]
    assert np.allclose([math.remainder(last[0], math.tau), last[1]], 0.0, atol=1e-4)
    assert np.allclose(last[2:], 0.0, atol=1e-3)
    # The summary tells everything else.
    text = planner.latched('plan_summary').data
    summary = json.loads(text)
    assert '\n' not in text
    assert {name: summary[name] for name in ANSWER} == answer
    stamp = message.header.stamp
    assert summary['stamp'] == {'sec': stamp.sec, 'nanosec': stamp.nanosec}
    assert summary['problem'] == 'pendulum_swing_up'
    check = summary['verification']
    assert check['ok']
    assert check['units'] == {'torque': 'N m', 'disk_angle': 'rad'}
    assert set(check['worst']) == set(check['worst_times']) == set(check['units'])
    (vehicle,) = summary['vehicles'].values()
    assert (vehicle['interpolation'], vehicle['units']['torque']) == ('zero_order_hold', 'N m')
    problem = PendulumSwingUp.from_parameters(summary['parameters'])
    assert problem.to_parameters() == summary['parameters']


def test_a_later_plan_replaces_the_one_before(planner):
    planner.made()
    first = planner.summary()['plan_id']
    planner.set('planner', {'start.theta': 2.5, 'goal.turns': 2})
    points = planner.made().points
    assert points[0].positions[0] == 2.5
    assert points[-1].positions[0] == pytest.approx(4 * math.pi, abs=1e-4)
    assert planner.summary()['plan_id'] == first + 1
    check_markers(planner.latched('markers'), 'world', 0.0)
    planner.set('planner', {'start.theta': math.pi, 'goal.turns': None})
    assert abs(planner.made().points[-1].positions[0]) < 7.0


def test_a_plan_begins_where_the_pendulum_has_coasted_to_or_been_taken(ros):
    measuring = Planner(ros, start__delay=0.2)
    state, measured = [3.0, 0.2, 0.5, -0.4], ros.now
    measuring.measure(measuring.state(state))
    ros.spin_for(0.1)
    trajectory = measuring.made()
    wait = 1e-9 * (begins(trajectory) - measured)
    assert 0.3 <= wait < 0.4
    pendulum, x, step = RotaryPendulum(), np.array(state), wait / 4000
    for _ in range(4000):  # of the midpoint rule
        half = x + 0.5 * step * pendulum.derivative(x, np.zeros(1))
        x = x + step * pendulum.derivative(half, np.zeros(1))
    point = trajectory.points[0]
    assert [*point.positions, *point.velocities] == pytest.approx(x.tolist(), abs=1e-6)
    # A plan that no tracker has accepted is not planned on.
    measuring.measure(measuring.state([math.pi, 0.0, 0.0, 0.0]))
    for told, at_rest in ((None, True), (GoalStatus.STATUS_EXECUTING, False)):
        made = measuring.made()
        if told is not None:
            message = GoalStatusArray(status_list=[goal_status(begins(made), told)])
            measuring.publisher('tracker_status').publish(message)
        ros.spin_for(0.3)  # it is under way
        measuring.measure(measuring.state([math.pi, 0.0, 0.0, 0.0]))
        point = measuring.made().points[0]
        found = [*point.positions, *point.velocities]
        assert (found == pytest.approx([math.pi, 0.0, 0.0, 0.0], abs=1e-6)) == at_rest


def test_states_that_cannot_be_planned_from(ros):
    measuring, asked = Planner(ros), ros.now
    reason = f'no state was received on {measuring.space}/joint_states within 0.5 s'
    assert measuring.refusal() == ('NO_STATE', f'{reason} (start.max_age)')
    assert ros.now - asked >= 0.5e9
    state, hanging = measuring.state, [3.0, 0.0, 0.0, 0.0]
    short = {'name': ['pendulum', 'disk'], 'position': [0.0, 0.0], 'velocity': []}
    old = f'{measuring.space}/joint_states is 5 s old', 'not be older than 0.5 s (start.max_age)'
    for message, *words in (
        (state(hanging, age=5.0), *old),
        (state(hanging, age=-5.0), 'stamped 5 s in the future'),
        (state(hanging, age=5.0), *old),
        (JointState(name=['wheel'], position=[0.0], velocity=[0.0]), 'pendulum, disk must be'),
        (JointState(**short), "'velocity' has 0 values for 2 named joints"),
        (state([math.nan, 0.0, 0.0, 0.0]), 'position of joint pendulum is nan'),
        (state([3.0, 0.0, 1e12, 0.0]), "'start.theta_dot' = "),
        (state([3.0, 2.5, 0.0, 0.0]), "'start.psi' = 2.5"),
    ):
        measuring.measure(message)
        code, reason = measuring.refusal()
        assert code == ('INVALID_PROBLEM' if "'start." in words[0] else 'NO_STATE')
        assert all(word in reason for word in words), reason
    without_stamp = state(hanging)
    without_stamp.header.stamp = to_stamp(0)
    measuring.measure(without_stamp)
    measuring.made()


def test_what_a_request_asks_for_is_planned_and_nothing_of_it_stays(planner):
    before = planner.here.node.parameter_values
    for torque, turns in ((0.08, 1), ('6e-2', -1)):  # text for what it says, as on the node
        done, answer = planner.plan_with(limits__torque=torque, goal__turns=turns, start__delay=2)
        assert done, answer
        assert list(answer) == ANSWER
        summary = planner.summary()
        assert {name: summary[name] for name in ANSWER} == answer
        assert summary['parameters']['limits.torque'] == float(torque)
        message = planner.trajectories[-1]
        assert begins(message) >= planner.ros.now + 1.9e9
        assert message.points[-1].positions[0] == pytest.approx(turns * math.tau, abs=1e-4)
    assert planner.here.node.parameter_values == before
    planner.made()
    assert planner.summary()['parameters']['limits.torque'] == STRONG['limits.torque']
    assert planner.plan_with()[0]


@pytest.mark.parametrize(
    ('own', 'says'),
    [
        ({'limits__torque': 'strong'}, "parameter 'limits.torque' = 'strong' is not allowed"),
        ({'limits__torqe': 1.0}, "parameter 'limits.torqe' is unknown: did you mean limits.torq"),
        ({'replan__rate': 1.0}, "parameter 'replan.rate' cannot be part of a request: set it on"),
        ({'problem': 'robot_formation'}, 'it is fixed while the node runs'),
        ({'plant__mass': 1e9}, "'plant.*'"),
        (
            {'start__source': 'measured', 'start__psi': 0.1},
            "'start.psi' has no effect while start",
        ),
        ({'odd': [UNREADABLE]}, 'cannot be read'),
        ({'goal__turns': 1, 'odd': parameters({'goal.turns': -1})}, "'goal.turns' is given twice"),
        ({'limits__torque': 1e-4, 'solver__deadline': 0.3}, ''),
    ],
    ids=str,
)
def test_a_request_that_cannot_be_met_says_why_and_leaves_everything(planner, own, says):
    active, values = planner.made(), planner.here.node.parameter_values
    done, answer = planner.plan_with(*own.pop('odd', ()), **own)
    assert not done
    found = 'DEADLINE', 'INFEASIBLE', 'VERIFICATION_FAILED'
    assert answer['code'] in (['INVALID_PROBLEM'] if says else found)
    assert says in answer['reason']
    assert planner.here.node.parameter_values == values
    assert planner.latched('trajectory') == active


def test_when_the_clock_is_set_the_plan_goes_on_as_the_plant_does(ros):
    planner = Planner(ros, start__source='parameters', use_sim_time=False)
    start, node = begins(planner.made()), planner.here.node
    plan = node._adapter.plans.newest
    assert node._time.stamp(plan.start) == start
    ros.time_of_day = -3600.0
    ros.spin_for(0.2)
    ros.time_of_day = 0.0
    assert 'the clock was set by -3.6e+03 s' in planner.here.output
    assert node._adapter.plans.newest is plan
    assert node._time.stamp(plan.start) == start - 3600 * 1_000_000_000
    assert node._adapter.plans.starting(plan.start) is plan


def test_a_clock_that_is_set_back_leaves_nothing_for_a_tracker_that_starts_later(ros):
    """When the time of the plan comes again: the plant was reset meanwhile."""
    planner = Planner(ros, start__source='parameters', use_sim_time=False)
    planner.made()
    for step, left in ((30.0, True), (29.9, True), (0.0, False)):
        ros.time_of_day = step
        ros.spin_for(0.2)
        assert bool(planner.latched('trajectory').points) is left
    planner.made()
    assert planner.latched('trajectory').points


class Fleet(Space):
    """A planner in a namespace, and robots that are where the test says."""

    def __init__(self, ros: Stepped, name: str, **parameters) -> None:
        super().__init__(ros, name)
        self.start('planner', {**FORMATION, 'start.source': 'parameters', **parameters})
        self.motions = {name: self.hear(f'{name}/trajectory') for name in ROBOTS}
        self.paths = {name: self.hear(f'{name}/path') for name in ROBOTS}
        self.odometry = {name: self.publisher(f'{name}/odom') for name in ROBOTS}
        self.joints = {name: self.publisher(f'{name}/joint_states') for name in ROBOTS}

    def motion(self, name: str) -> tuple[Trajectory, int]:
        motion = self.motions[name][-1]
        return read_plan(ROBOT, motion), begins(motion)

    def measure(self, name: str, state: list[float]) -> None:
        """Publish a robot's state [x, y, u, v, yaw, omega, alpha]."""
        stamp, values = to_stamp(self.ros.now), dict(zip(ROBOT.state_names, state, strict=True))
        exact, names = dict.fromkeys(values, 0.0), ['thruster', 'reaction_wheel']
        joints = measured_state(stamp, name=names, position=[values['alpha'], 0.0])
        self.joints[name].publish(joints)
        self.odometry[name].publish(odometry(ROBOT, values, exact, stamp, name))
        self.ros.settle()

    def follow(self, plans: dict[str, tuple[Trajectory, int]]) -> None:
        for name, (plan, start) in plans.items():
            self.measure(name, plan.sample((self.ros.now - start) * 1e-9).state.tolist())


@pytest.fixture(scope='module')
def fleet(ros: Stepped) -> Fleet:
    return Fleet(ros, 'robots')


def test_a_plan_for_every_robot_is_published_and_told_of(ros, fleet):
    answer = fleet.plan()
    task, starts = RobotFormation().task, set()
    for k, name in enumerate(ROBOTS):
        plan, start = fleet.motion(name)
        starts.add(start)
        np.testing.assert_allclose(plan.states[-1, :2], task.goal[k], atol=5e-3)
        np.testing.assert_allclose(plan.states[0, :2], task.start[k], atol=1e-12)
        turned = math.remainder(plan.states[-1, 4] - task.goal_yaw[k], math.tau)
        assert turned == pytest.approx(0, abs=0.01)
        path = fleet.paths[name][-1]
        assert path.header.frame_id == fleet.motions[name][-1].header.frame_id == 'arena'
        assert len(path.poses) == plan.times.size
    assert len(starts) == 1
    markers = fleet.latched('markers').markers
    assert {marker.ns for marker in markers} >= {'limit', 'planned_path', 'goal', 'reach'}
    summary = json.loads(fleet.latched('plan_summary').data)
    assert summary['plan_id'] == answer['plan_id']
    assert sum(summary['cost_terms'].values()) == pytest.approx(summary['cost'])
    assert list(summary['vehicles']) == ROBOTS
    check = summary['verification']
    assert set(check['worst']) == set(check['worst_times']) == set(check['units'])
    assert {'robot1.walls', 'separation robot1-robot3'} <= set(check['worst'])
    planned = RobotFormation.from_parameters(summary['parameters']).task
    np.testing.assert_array_equal([*planned.goal, *planned.start], [*task.goal, *task.start])


def test_the_measured_state_of_every_robot_is_needed(fleet):
    fleet.set('planner', start__source='measured')
    for known in (0, 2, 3):
        for k, name in enumerate(ROBOTS[:known]):
            fleet.measure(name, [1.0 + k, 0.5, 0.0, 0.0, 0.3, 0.0, 0.0])
        if known < 3:
            code, reason = fleet.refusal()
            assert code == 'NO_STATE'
            assert [name for name in ROBOTS if f"robot '{name}'" in reason] == ROBOTS[known:]
    fleet.plan()
    refused = fleet.ros.set_all(f'{fleet.space}/plan_with', robot2__start__x=2.5)
    assert "'robot2.start.x' has no effect" in refused.reason
    assert fleet.motions['robot2'][-1].points[0].positions[0] == pytest.approx(2.0)
    fleet.set('planner', start__source='parameters')


def test_a_second_source_of_a_robots_state_is_told_of(ros, fleet):
    fleet.plan()
    name, told = '/robots/planner: planning', '2 nodes publish /robots/robot2/odom: '
    assert ros.says(name, level=OK)
    other = fleet.publisher('robot2/odom')
    assert ros.says(name, told, level=WARN)
    ros.node.destroy_publisher(other)
    assert ros.says(name, level=OK)


def test_robots_with_names_of_their_own_are_told_when_their_state_is_missing(ros):
    space, bob = Space(ros), {'robots': '[alice, bob]', 'formation.bob': '[-0.4, 0.0, 0.0]'}
    space.start('planner', {**FORMATION, 'formation.alice': [0.4, 0.0, 0.0], **bob})
    code, reason = space.refusal()
    assert code == 'NO_STATE'
    assert all(f"robot '{name}'" in reason for name in ('alice', 'bob'))


def test_robots_are_planned_for_anew_when_the_formation_moves(ros):
    fleet = Fleet(ros, 'fleet', **{'replan.rate': 5.0, 'replan.delay': 1.5})
    fleet.plan()
    plans = {name: fleet.motion(name) for name in ROBOTS}
    under_way = plans['robot1'][1] + 1_500_000_000
    follow = partial(fleet.follow, plans)
    assert ros.publish_until(follow, lambda: ros.now >= under_way, every=0.05)
    assert all(len(heard) == 1 for heard in fleet.motions.values())  # followed, it is kept
    fleet.set('planner', formation__anchor=MOVED)
    renewed = lambda: all(len(heard) > 1 for heard in fleet.motions.values())  # noqa: E731
    assert ros.publish_until(follow, renewed, every=0.05)
    goals = RobotFormation.from_parameters({'formation.anchor': MOVED}).task.goal
    for name, goal in zip(ROBOTS, goals, strict=True):
        new, start = fleet.motion(name)
        np.testing.assert_allclose(new.states[-1, :2], goal, atol=5e-3)
        old, before = plans[name]
        expected = old.sample((start - before) * 1e-9).state
        np.testing.assert_allclose(new.states[0], expected, atol=0.02)
