# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Markers and goal tools of the nodes as RViz shows and uses them, and views that are shipped."""

import cmath
from collections.abc import Callable, Iterator
from importlib import import_module
import json
import math
import re

from geometry_msgs.msg import PoseStamped, Quaternion
from marker_checks import check_markers, Scene
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from ros_harness import ENOUGH, SOURCE, Space
from sensor_msgs.msg import JointState
from stepped_ros import Stepped
from tdm_planner.nodes.markers import LIFETIME, to_quaternion
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plants.rotary_pendulum import pendulum_urdf, RotaryPendulum
from visualization_msgs.msg import Marker
import yaml

RIG = {'body', 'force', 'trail'}
ROBOT = {'body', 'reach', 'force', 'name', 'trail'}
OVER = Quaternion(x=1.0, w=0.0)
HASTY = {'limits__thruster_rate': 0.01, 'solver__deadline': 1e-6}
LIFETIMES = {**dict.fromkeys(ROBOT, LIFETIME), 'rejected': 8.0}


class Viewer:
    """Subscribes like RViz and remembers what it shows."""

    def __init__(self, space: Space, topic: str = 'plant_markers') -> None:
        self.ros, self.arrays = space.ros, space.hear(topic)

    @property
    def scene(self) -> Scene:
        return Scene(*self.arrays)

    def shows(self, condition: Callable[[Scene], bool], publish=None) -> bool:
        showing = lambda: bool(self.arrays) and condition(self.scene)  # noqa: E731
        return self.ros.publish_until(publish or (lambda: None), showing)

    def stamps(self) -> list[int]:
        return [nanoseconds_of(array.markers[0].header.stamp) for array in self.arrays]


def jet(scene: Scene) -> complex:
    """Return a robot's jet in the plane [m]."""
    begin, end = scene['force', 3].points
    return complex(end.x - begin.x, end.y - begin.y)


def test_the_simulated_pendulum_draws_itself(ros):
    space, description = Space(ros, 'sim'), ros.subscribe('/sim/robot_description')
    plant, viewer = space.start('pendulum_plant', {'initial.theta': 0.5}), Viewer(space)
    assert viewer.shows(lambda scene: scene.namespaces == RIG), plant.output
    viewer.arrays.clear()
    assert viewer.shows(lambda scene: len(scene['trail', 1].points) > 30)
    for array in viewer.arrays:
        check_markers(array, 'world', LIFETIME)
    assert (np.diff(viewer.stamps()) > 0).all()
    # A reset begins a new trail.
    space.trigger('reset')
    viewer.arrays.clear()
    assert viewer.shows(lambda scene: 0 < len(scene['trail', 1].points) < 20)
    # The description follows the parameters, as do the markers.
    assert description[-1].data == pendulum_urdf(RotaryPendulum())
    space.set('pendulum_plant', plant__arm_length=0.2)
    ros.settle()
    assert description[-1].data == pendulum_urdf(RotaryPendulum(arm_length=0.2))
    arm = lambda scene: scene['body', 0].points[-1]  # noqa: E731
    assert viewer.shows(lambda scene: math.hypot(arm(scene).x, arm(scene).y) > 0.19)


class Robots(Space):
    """The robots' planner, what it publishes, and goal poses for robot1."""

    def __init__(self, ros: Stepped, name: str = 'hall') -> None:
        super().__init__(ros, name)
        given = {'problem': 'robot_formation', 'start.source': 'parameters'}
        self.here = self.start('planner', given)
        self.picture, self.live = Viewer(self, 'markers'), Viewer(self, 'robot1/plant_markers')
        self.trajectories = self.hear('robot1/trajectory')
        self._goals = self.publisher('robot1/goal_pose', PoseStamped)
        assert ros.meet(lambda: bool(self.picture.arrays))

    @property
    def place(self) -> list[float]:
        return list(self.here.node.get_parameter('formation.robot1').value)

    @property
    def end(self) -> list[float]:
        return list(self.trajectories[-1].points[-1].positions[:2])

    def clear(self) -> None:
        self.ros.settle()
        for received in (self.trajectories, self.picture.arrays, self.live.arrays):
            received.clear()

    def goal(
        self, x: float, y: float, yaw: float = 0.0, frame: str = 'arena', turned=None
    ) -> None:
        message = PoseStamped()
        message.header.frame_id, message.pose.orientation = frame, turned or to_quaternion(yaw)
        message.pose.position.x, message.pose.position.y = x, y
        self._goals.publish(message)


@pytest.fixture(scope='module')
def robots(ros: Stepped) -> Robots:
    made = Robots(ros)
    made.plan()
    return made


def test_the_set_up_the_plan_and_a_plan_to_a_goal_pose_are_shown(ros):
    robots = Robots(ros, 'shown')
    array = robots.picture.arrays[-1]
    check_markers(array, 'arena', 0.0)
    assert Scene(array).namespaces == {'body', 'limit', 'goal', 'reach'}
    for length in (6.0, 4.0):
        robots.set('planner', arena__length=length)
        wide = lambda scene, x=length: max(p.x for p in scene['body', 0].points) == x  # noqa: E731
        assert robots.picture.shows(wide)
    robots.plan()
    assert robots.picture.shows(lambda scene: 'planned_path' in scene.namespaces)
    array = robots.picture.arrays[-1]
    check_markers(array, 'arena', 0.0)
    assert array.markers[0].action == Marker.DELETEALL
    each = ('goal', 0), ('goal', 1), ('reach', 2), ('planned_path', 0)
    own = {(name, 100 * k + place) for k in (1, 2, 3) for name, place in each}
    assert Scene(array).names == {('body', 0), ('limit', 1)} | own
    robots.clear()
    robots.goal(3.2, 3.1, yaw=2.0)
    assert ros.spin_until(lambda: bool(robots.trajectories)), robots.here.output
    assert robots.end == pytest.approx((3.2, 3.1), abs=5e-3)
    # Anchor [2, 2, 0.5]
    expected = complex(1.2, 1.1) * cmath.rect(1.0, -0.5)
    assert robots.place == pytest.approx([expected.real, expected.imag, 1.5])
    assert robots.picture.shows(lambda scene: abs(scene['goal', 100].pose.position.x - 3.2) < 5e-3)
    path = robots.picture.scene['planned_path', 100].points
    assert (path[-1].x, path[-1].y) == pytest.approx((3.2, 3.1), abs=5e-3)
    # The service goes on from there.
    robots.clear()
    robots.plan()
    assert robots.end == pytest.approx((3.2, 3.1), abs=5e-3)


@pytest.mark.parametrize(
    ('goal', 'settings', 'words'),
    [
        ({'x': 9.0, 'y': 1.0}, {}, ['INVALID_PROBLEM', 'robot1', 'outside the arena']),
        ({'x': 1.0, 'y': 1.0, 'frame': 'map'}, {}, ["'map'", "'arena'"]),
        ({'x': 1.0, 'y': 1.0, 'frame': ''}, {}, ["'frame_id' = ''", "'arena'"]),
        ({'x': 1.0, 'y': 1.0, 'yaw': math.nan}, {}, ['unit quaternion']),
        ({'x': 1.0, 'y': 1.0, 'turned': OVER}, {}, ['(1, 0, 0, 0)', 'must be a rotation about z']),
        ({'x': 1.6, 'y': 2.24}, {}, ['INVALID_PROBLEM', 'robot2', 'apart']),
        ({'x': 1.0, 'y': 3.0}, HASTY, ['DEADLINE', 'no feasible plan within']),
    ],
    ids=str,
)
def test_a_refused_goal_changes_nothing_and_says_why(ros, robots, goal, settings, words):
    before, logged = robots.place, len(robots.here.output)
    robots.clear()
    robots.set('planner', **settings)
    robots.goal(**goal)
    ros.settle()
    robots.set('planner', solver__deadline=ENOUGH, limits__thruster_rate=2.0)
    for array in robots.live.arrays:
        check_markers(array, 'arena', LIFETIMES)
    text = ' '.join(robots.live.scene['rejected'].text.split())
    assert all(word in text for word in words), text
    (line,) = (line for line in robots.here.output[logged:].splitlines() if 'rejected' in line)
    assert text.removeprefix('robot1: ') in line
    assert robots.place == before
    assert not robots.trajectories
    assert not robots.picture.arrays


def test_a_simulated_robot_draws_itself_and_its_thrust(ros, robots):
    initial = {'initial.x': 1.0, 'initial.yaw': 0.5, 'initial.alpha': 1.0}
    plant = ros.start('robot_plant', {**initial, 'command_timeout': 30.0}, 'hall/robot1')
    robots.clear()
    assert robots.live.shows(lambda scene: scene.namespaces >= ROBOT), plant.output
    assert abs(jet(robots.live.scene)) < 1e-6
    names = ['thruster', 'reaction_wheel']
    command = JointState(name=names, velocity=[0.0, 0.0], effort=[0.5, 0.0])
    robots.clear()
    ros.publisher('/hall/robot1/joint_command').publish(command)
    assert robots.live.shows(lambda scene: abs(jet(scene)) > 0.01)
    for array in robots.live.arrays:
        check_markers(array, 'arena', LIFETIMES)
    assert cmath.phase(jet(robots.live.scene)) == pytest.approx(1.5 - math.pi)
    # Both the plant and the planner could publish here: the planner leaves it to the plant.
    robots.clear()
    assert ros.spin_until(lambda: len(robots.live.arrays) > 10)
    assert np.median(np.diff(robots.live.stamps())) > 0.035e9


def test_a_real_robot_is_drawn_by_the_planner(ros, robots):
    viewer = Viewer(robots, 'robot2/plant_markers')
    assert ros.silent(viewer.arrays)  # nothing is measured yet
    odometry, joints = map(robots.publisher, ('robot2/odom', 'robot2/joint_states'))
    message = Odometry()
    message.header.frame_id, pose = 'arena', message.pose.pose
    pose.position.x, pose.position.y, pose.orientation = 1.5, 2.5, to_quaternion(0.3)
    state = JointState(name=['thruster'], position=[0.4], velocity=[0.0], effort=[1.05])
    drawn = lambda scene: scene.namespaces >= ROBOT and abs(jet(scene)) > 0.01  # noqa: E731
    publish = lambda: (odometry.publish(message), joints.publish(state))  # noqa: E731
    assert viewer.shows(drawn, publish), robots.here.output
    for array in viewer.arrays:
        check_markers(array, 'arena', LIFETIMES)
    where = viewer.scene['body', 0].pose.position
    assert (where.x, where.y, viewer.scene['name'].text) == (1.5, 2.5, 'robot2')
    assert cmath.phase(jet(viewer.scene)) == pytest.approx(0.7 - math.pi)
    ros.spin_for(0.5)
    assert ros.silent(viewer.arrays)  # what is too old is drawn no more


CONFIG = SOURCE / 'config'
EACH = pytest.mark.parametrize('plant', ['pendulum', 'robots'])
TYPES = {  # of what a display or a tool of RViz handles
    'MarkerArray': 'visualization_msgs/msg/MarkerArray', 'RobotModel': 'std_msgs/msg/String',
    'Path': 'nav_msgs/msg/Path', 'SetGoal': 'geometry_msgs/msg/PoseStamped',
}  # fmt: skip


def within(item) -> Iterator:
    """Yield everything in a document: mappings, lists, keys and values."""
    yield item
    if isinstance(item, dict | list):
        for part in item if isinstance(item, list) else [*item, *item.values()]:
            yield from within(part)


def mappings(file: str) -> list[dict]:
    """Return all in a file of RViz or Foxglove; JSON is YAML."""
    document = yaml.safe_load((CONFIG / file).read_text(encoding='utf-8'))
    return [item for item in within(document) if isinstance(item, dict)]


def of_robot1(topic: str) -> str:
    return re.sub(r'/robot\d/', '/robot1/', topic)


@pytest.fixture(scope='module')
def running(ros: Stepped) -> Stepped:
    for namespace, *names in (
        ('/pendulum', 'planner', 'tracker', 'pendulum_plant'),
        ('/robots', 'planner'),
        ('/robots/robot1', 'robot_plant'),
    ):
        file = str(CONFIG / f'{namespace.split("/")[1]}.yaml')
        for name in names:
            ros.start(name, None, namespace, ['--params-file', file])
    return ros


@EACH
def test_rviz_shows_topics_with_their_type_and_quality_of_service(running, plant):
    found, node = set(), running.node
    for item in (item for item in mappings(f'{plant}.rviz') if 'Class' in item):
        kind = item['Class'].rpartition('/')[2]
        topic = item.get('Topic') or item.get('Description Topic')
        assert (topic is None) == (kind not in TYPES)
        if topic is None:
            continue
        name, goal = of_robot1(topic['Value']), kind == 'SetGoal'
        ask = getattr(node, f'get_{"subscriptions" if goal else "publishers"}_info_by_topic')
        assert running.meet(lambda ask=ask, name=name: bool(ask(name))), name
        assert topic['Reliability Policy'] == 'Reliable'
        latched = {'Transient Local': True, 'Volatile': False}[topic['Durability Policy']]
        for end in ask(name):
            assert end.topic_type == TYPES[kind], name
            assert end.qos_profile.reliability == ReliabilityPolicy.RELIABLE, name
            durable = end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert latched == durable, name
        found.add(kind)
    assert len(found) > 1


@EACH
def test_foxglove_shows_and_calls_what_is_there(running, plant):
    document = mappings(f'foxglove/{plant}.json')
    names = {of_robot1(text) for text in within(document) if str(text).startswith('/')}
    topics = dict(running.node.get_topic_names_and_types())
    services = dict(running.node.get_service_names_and_types())
    for name in names:
        topic, _, field = name.partition('.')
        if topic in services:
            assert services[topic] == ['std_srvs/srv/Trigger']
            continue
        package, _, kind = topics[topic][0].split('/')
        value = getattr(import_module(f'{package}.msg'), kind)()
        for part in field.split('.') if field else ():
            value = getattr(value, part.split('[')[0])
    assert {f'/{plant}/plan', f'/{plant}/markers', '/diagnostics'} <= names
    calls = [item for item in document if 'serviceName' in item]
    assert all(json.loads(item['requestPayload']) == {} for item in calls)
