# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plans as messages and back, measured states; what viewers are told to draw."""

from dataclasses import replace
import math

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from marker_checks import check_markers, Scene
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from replays import pendulum_points
from sensor_msgs.msg import JointState
from stated import refused
from tdm_planner.drawing import PendulumDrawing, RobotDrawing
from tdm_planner.exceptions import InvalidProblem, VerificationFailed
from tdm_planner.nodes import messages, reading
from tdm_planner.nodes.markers import LIFETIME, Picture
from tdm_planner.plant_kind import named_kind, PENDULUM, PlantKind, ROBOT
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import RobotFormation
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from trajectory_msgs.msg import JointTrajectory

START = 1_700_000_000_123_456_789
STAMP = messages.to_stamp(START)
PLANT = RotaryPendulum()
CRANE = named_kind(
    ('x', 'v', 'sway', 'rope', 'reel'),
    ('force', 'winch'),
    [('trolley', 'x', 'v'), ('winch', 'rope', 'reel')],  # the winch is a joint and a control
)
DRAWN_PENDULUM, DRAWN_ROBOT = PendulumDrawing(PLANT, 0.02, 2.0), RobotDrawing(0.4, 1.05, 0.15)
number = st.floats(-20.0, 20.0)
INSTANTS = st.integers(-(2**31) * 10**9, (2**31 - 1) * 10**9)  # ns that a stamp can tell
BODY = {('body', 0), ('body', 1)}
ALWAYS = [  # drawn: what, its name, and what is always to be seen of it
    (DRAWN_PENDULUM, '', BODY | {('force', 2)}),
    (DRAWN_ROBOT, 'robot2', BODY | {('reach', 2), ('force', 3), ('name', 0)}),
]


def switched(kind: PlantKind) -> Trajectory:
    """Consistent enough to be a message: controls jump in the middle, states are arbitrary."""
    rng, count = np.random.default_rng(1), 20
    times = to_nanoseconds(np.concatenate([[0.0], np.cumsum(rng.uniform(1e-3, 5e-3, count - 1))]))
    states = rng.normal(size=(count, len(kind.state_names)))
    later = np.arange(count)[:, None] >= count // 2
    controls = np.where(later, 0.01 * np.arange(1, len(kind.control_names) + 1), 0.02)
    return Trajectory(times, states, controls, kind.state_names, kind.control_names)


@pytest.mark.parametrize('kind', [PENDULUM, ROBOT, CRANE])
def test_a_plan_comes_back_from_the_wire_to_the_last_bit(kind: PlantKind) -> None:
    """But for the last controls, which are held for no time; joints may come in any order."""
    plan = switched(kind)
    made = messages.plan_message(kind, plan, STAMP)
    assert (made.header.stamp, made.header.frame_id) == (STAMP, kind.frame)
    made.joint_names = list(made.joint_names)[::-1]
    for point in made.points:
        for quantity in ('positions', 'velocities', 'accelerations', 'effort'):
            setattr(point, quantity, list(getattr(point, quantity))[::-1])
    sent = deserialize_message(serialize_message(made), JointTrajectory)
    read = reading.read_plan(kind, sent, 'zero_order_hold')
    assert np.array_equal(read.times, plan.times)
    assert np.array_equal(read.states, plan.states)
    assert np.array_equal(read.controls[:-1], plan.controls[:-1])
    assert not read.controls[-1].any()
    names, units = kind.state_names + kind.control_names, kind.state_units + kind.control_units
    assert read.units == dict(zip(names, units, strict=False))


@pytest.mark.parametrize('kind', [PENDULUM, ROBOT, CRANE])
def test_between_its_points_a_plan_of_ours_is_read_as_it_was_planned(kind: PlantKind) -> None:
    speeds = {joint.velocity: joint.position for joint in kind.joints if joint.velocity}
    times, names = np.linspace(0.0, 2.0, 30), kind.state_names + kind.control_names

    def history(name: str, order: int) -> np.ndarray:
        """Return a sine, of which velocities are the derivatives by time."""
        if of := speeds.get(name):
            return history(of, order + 1)
        return np.sin(times + names.index(name) + order * np.pi / 2)

    states, controls = (
        np.stack([history(name, 0) for name in each], axis=-1)
        for each in (kind.state_names, kind.control_names)
    )
    rates = np.stack([history(name, 1) for name in kind.state_names], axis=-1)
    plan = Trajectory.of(kind, times, states, controls, 'linear')
    plan = replace(plan, rates=np.stack([rates[:-1], rates[1:]], axis=1))
    made = messages.plan_message(kind, plan, STAMP)
    read = reading.read_plan(kind, made, 'linear', rated=True)
    np.testing.assert_allclose(read.rates, plan.rates, rtol=1e-12, atol=1e-12)
    assert reading.read_plan(kind, made).rates is None
    # Rates that are not known are written as zeros.
    slow = replace(plan, rates=None, states=1e-3 * plan.states)
    unknown = messages.plan_message(kind, slow, STAMP)
    assert reading.read_plan(kind, unknown, 'linear', rated=True).rates is None


def test_a_robots_plan_is_one_message() -> None:
    robot = FloatingRobot()
    plan = switched(ROBOT).with_rates(robot.derivative)
    omega = plan.state('omega')
    wheel = robot.wheel_speed(omega - omega[0])
    made = messages.plan_message(ROBOT, plan, STAMP, {'wheel_speed': wheel})
    assert list(made.joint_names) == ['x', 'y', 'yaw', 'thruster', 'reaction_wheel']
    x, y, u, v, yaw, _, alpha = plan.states[3].tolist()
    thrust, rate, torque = plan.controls[3].tolist()
    point = made.points[3]
    assert list(point.positions) == [x, y, yaw, alpha, 0.0]
    assert list(point.velocities) == [u, v, omega[3], rate, wheel[3]]
    assert list(point.effort) == [0.0, 0.0, 0.0, thrust, torque]
    speeds = np.array([p.velocities[4] for p in made.points])
    turned = np.diff(speeds)[3] / np.diff(plan.times)[3]
    expected = [*plan.rates[3, 0, [2, 3, 5]], 0.0, turned]  # the thruster turns evenly
    np.testing.assert_allclose(point.accelerations, expected)
    linear = replace(plan, interpolation='linear')
    point = messages.plan_message(ROBOT, linear, STAMP).points[9]  # of whose wheel nothing is told
    slope = np.diff(plan.control('thruster_rate'))[9] / np.diff(plan.times)[9]
    np.testing.assert_allclose(point.accelerations[3:], [slope, 0.0])
    momentum = robot.inertia * omega + robot.wheel_inertia * (omega + speeds)
    np.testing.assert_allclose(momentum, momentum[0], atol=1e-12)
    path = messages.path_message(ROBOT, plan, START)
    assert path.header.frame_id == 'arena'
    stamps = [reading.nanoseconds_of(p.header.stamp) - START for p in path.poses]
    assert stamps == np.round(plan.times * 1e9).astype(int).tolist()


def test_accelerations_are_those_after_a_jump_and_the_end_is_at_rest() -> None:
    plan = switched(PENDULUM)
    states = plan.states.copy()
    states[-1, 2:] = 9e-4
    plan = replace(plan, states=states)
    made = messages.plan_message(PENDULUM, plan.with_rates(PLANT.derivative), STAMP)
    expected = PLANT.derivative(plan.states, plan.controls)[:, 2:]
    assert np.array_equal([point.accelerations for point in made.points], expected)
    assert list(made.points[-1].velocities) == [0.0, 0.0]
    assert [p.effort[1] for p in made.points[9:11]] == [0.02, 0.01]
    # a joint without a velocity has that of its position
    plan = switched(CRANE).with_rates(lambda x, u: 2.0 * x)
    made = messages.plan_message(CRANE, plan, STAMP)
    assert list(made.joint_names) == ['trolley', 'winch', 'sway', 'force']
    _, v, sway, _, reel = plan.states[4].tolist()
    assert list(made.points[4].velocities) == [v, reel, 2 * sway, 0.0]
    bend = 2 * np.diff(plan.state('sway'))[4] / np.diff(plan.times)[4]
    expected = [2 * v, 2 * reel, bend, 0.0]
    assert list(made.points[4].accelerations) == pytest.approx(expected)
    assert list(made.points[4].effort) == [0.0, 0.02, 0.0, 0.02]


@pytest.mark.parametrize(('way', 'rate'), [(0.3, 2.0), (1.2, 0.5)])
def test_a_plan_of_polynomials_comes_back_as_one(way: float, rate: float) -> None:
    """One that ends with little speed, which is told as none; one that coasts most of the time."""
    values = {'robots': ['a'], 'formation.anchor': [1.0, 2.0, 0.0], 'formation.a': [way, 0.0, 0.0]}
    values |= {'a.start.x': 1.0, 'a.start.y': 2.0, 'a.start.alpha': math.pi - 0.1}
    values |= {'method': 'polynomials', 'limits.thruster_rate': rate}
    problem = RobotFormation.from_parameters(values)
    plan = problem.solve(counted=True).trajectory
    told = reading.read_plan(ROBOT, messages.plan_message(ROBOT, plan, STAMP))
    assert told.interpolation == 'linear'
    assert problem.recovered({'a': told}).verification.ok
    states = told.states.copy()
    states[-1, 0] += 0.05
    with pytest.raises(VerificationFailed):
        problem.recovered({'a': replace(told, states=states)})


def test_controls_that_vary_everywhere_are_read_as_linear() -> None:
    made = messages.plan_message(PENDULUM, switched(PENDULUM), STAMP)
    held = 'zero_order_hold'
    assert reading.read_plan(PENDULUM, made).interpolation == held
    for number, point in enumerate(made.points):
        point.effort = [0.0, math.sin(number)]
    for asked, found in ((), 'linear'), ((held,), held):
        assert reading.read_plan(PENDULUM, made, *asked).interpolation == found


@pytest.mark.parametrize(
    ('point', 'changes', 'says'),
    [
        (None, {'joint_names': ['pendulum', 'a']}, 'joint(s) disk must be named'),
        (None, {'joint_names': []}, 'names are: none'),
        (None, {'joint_names': ['disk', 'disk']}, 'joint(s) pendulum, disk must be named once'),
        (None, {'points': []}, 'has 0 points'),
        (3, {'velocities': [0.0]}, "'velocities' of point 3 has 1 values for 2 joints"),
        (0, {'effort': []}, "'effort' of point 0 has 0 values"),
        (
            5,
            {'time_from_start': Duration()},
            "'times', in whole nanoseconds, must increase strictly",
        ),
        (0, {'time_from_start': Duration(sec=-1)}, "'time_from_start' of point 0 is -1 s"),
        (2, {'positions': [math.nan, 0.0]}, "'states' holds a value that is not finite"),
    ],
)
def test_malformed_plans_are_refused(point, changes, says):
    made = messages.plan_message(PENDULUM, switched(PENDULUM), STAMP)
    for name, value in changes.items():
        setattr(made if point is None else made.points[point], name, value)
    assert says in refused(lambda: reading.read_plan(PENDULUM, made))


@settings(max_examples=50)
@given(INSTANTS, st.floats(-1e5, 1e5), st.floats(-math.pi, math.pi))
def test_instants_durations_and_yaw_keep_their_values(nanoseconds, seconds, yaw):
    assert reading.nanoseconds_of(messages.to_stamp(nanoseconds)) == nanoseconds
    again = reading.seconds_of(messages.to_duration(seconds))
    assert abs(again - seconds) <= 0.5e-9 + 1e-15 * abs(seconds)
    turned = reading.yaw_of(messages.to_quaternion(yaw))
    assert math.remainder(turned - yaw, 2 * math.pi) == pytest.approx(0, abs=1e-12)


def read_state(joints: JointState, moved: Odometry) -> np.ndarray:
    found = reading.read_joints(ROBOT.measured, joints, ROBOT.state_names)
    found |= reading.read_odometry(ROBOT, moved)
    return np.array([found[name] for name in ROBOT.state_names])


def test_the_twist_is_turned_into_the_arena_and_bad_odometry_is_refused():
    thruster = JointState(name=['thruster'], position=[0.5])
    message = Odometry()
    message.header.frame_id = 'arena'
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = 1.0, 2.0
    pose.orientation = messages.to_quaternion(math.pi / 2)
    twist.linear.x, twist.angular.z = 0.3, 0.1  # forward, which is along y here
    state = read_state(thruster, message)
    np.testing.assert_allclose(state, [1, 2, 0, 0.3, math.pi / 2, 0.1, 0.5], atol=1e-15)
    message.child_frame_id = 'arena'  # of the twist: along x of the arena
    state = read_state(thruster, message)
    np.testing.assert_allclose(state, [1, 2, 0.3, 0, math.pi / 2, 0.1, 0.5], atol=1e-15)
    for part, name, bad, words in (
        (pose.position, 'x', math.inf, 'finite'),
        (pose, 'orientation', Quaternion(w=0.0), 'unit quaternion'),
        (message.header, 'frame_id', 'odom', "'odom' must be 'arena'"),
    ):
        good = getattr(part, name)
        setattr(part, name, bad)
        with pytest.raises(InvalidProblem, match=words):
            read_state(thruster, message)
        setattr(part, name, good)


def place(point) -> list[float]:
    return [point.x, point.y, point.z]


@pytest.mark.parametrize(('drawn', 'name', 'always'), ALWAYS)
@given(states=st.lists(st.lists(number, min_size=7, max_size=7), min_size=1, max_size=12))
@settings(max_examples=15)
def test_every_picture_is_valid_with_the_same_names(drawn, name, always, states) -> None:
    picture, arrays = Picture(drawn, name, pytest.fail), []
    for k, values in enumerate(states):
        state = np.array(values)
        picture.add(float(k), state)
        array = picture.draw(Time(sec=k), state, state[:3])
        check_markers(array, drawn.kind.frame, LIFETIME)
        arrays.append(array)
        names = Scene(*arrays).names
        trail = {key for key in names if key[0] == 'trail'}
        assert (names - trail, len(trail)) == (always, int(k > 0))
        assert all(m.header.stamp.sec == k for m in array.markers)


def test_a_trail_follows_keeps_its_distance_and_forgets() -> None:
    picture, theta = Picture(DRAWN_PENDULUM, '', pytest.fail), np.linspace(0.0, 1.0, 401)
    for k, value in enumerate(theta):
        picture.add(0.005 * k, np.array([value, 0.3, 0.0, 0.0]))

    def trail() -> list[list[float]]:
        scene = Scene(picture.draw(Time(), np.array([1.0, 0.3, 0.0, 0.0]), np.zeros(1)))
        return [place(p) for p in scene['trail', 1].points] if 'trail' in scene.namespaces else []

    _, tips = pendulum_points(PLANT, theta, np.array(0.3))
    np.testing.assert_allclose(trail(), tips[200::4], atol=1e-9)
    picture.add(-7.0, np.zeros(4))  # the clock went back
    assert trail() == []
    picture.add(-6.98, np.zeros(4))
    assert len(trail()) == 2
    picture.clear()
    assert trail() == []
