# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Markers and goal tools of the running nodes, over real DDS."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

from geometry_msgs.msg import PoseStamped
from marker_checks import check_markers, Scene
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters
from ros_harness import ENOUGH, NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.markers import LIFETIME
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.nodes.robot_markers import TRAIL_LIFETIME
from tdm_planner.nodes.robot_messages import to_quaternion
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.views.pendulum_urdf import pendulum_urdf
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

RIG = {'base', 'disk', 'disk_limit', 'arm', 'rod', 'trail'}
ROBOT = {'body', 'heading', 'separation', 'name', 'trail'}
LIFETIMES = {
    **dict.fromkeys(ROBOT | {'plume'}, LIFETIME),
    'trail': TRAIL_LIFETIME * LIFETIME,
    'refusal': 8.0,
}


class Viewer:
    """Subscribes like RViz and remembers what it shows."""

    def __init__(self, ros: Ros, topic: str, qos: Any = 10) -> None:
        self.ros = ros
        self.arrays: list[MarkerArray] = ros.subscribe(topic, MarkerArray, qos)

    @property
    def scene(self) -> Scene:
        return Scene(*self.arrays)

    def showing(self, condition: Callable[[Scene], bool]) -> bool:
        return bool(self.arrays) and condition(self.scene)

    def shows(self, condition: Callable[[Scene], bool]) -> bool:
        return self.ros.spin_until(lambda: self.showing(condition))


# The pendulum: a simulated plant in `sim`; in `pendulum` a planner whose plant is the test.


@pytest.fixture(scope='module')
def plant(ros: Ros) -> NodeProcess:
    return ros.start('tdm_sim.pendulum_plant', {'initial.theta': 0.5}, namespace='sim')


@pytest.fixture(scope='module')
def planner(ros: Ros) -> NodeProcess:
    return ros.start(
        'tdm_planner.nodes.planner', {'start.source': 'parameters'}, namespace='pendulum'
    )


def test_the_simulated_pendulum_draws_itself(
    ros: Ros, planner: NodeProcess, plant: NodeProcess
) -> None:
    viewer = Viewer(ros, '/sim/plant_markers')
    assert viewer.shows(lambda scene: scene.namespaces == RIG), plant.output
    viewer.arrays.clear()
    assert ros.spin_until(lambda: len(viewer.arrays) >= 10)
    for array in viewer.arrays:
        check_markers(array, 'world', LIFETIME)
        assert [(m.ns, m.id) for m in array.markers] == [
            (m.ns, m.id) for m in viewer.arrays[0].markers
        ]
    stamps = [nanoseconds_of(a.markers[0].header.stamp) for a in viewer.arrays]
    assert (np.diff(stamps) > 0).all()
    # A reset begins a new trail.
    assert viewer.shows(lambda scene: len(scene['trail'].points) > 30)
    assert ros.call('/sim/reset', Trigger).success
    viewer.arrays.clear()
    assert ros.spin_until(
        lambda: any(0 < len(m.points) < 20 for a in viewer.arrays for m in a.markers[-1:])
    )


def test_the_description_follows_the_parameters(ros: Ros, plant: NodeProcess) -> None:
    received = ros.subscribe('/sim/robot_description', String, LATCHED)
    viewer = Viewer(ros, '/sim/plant_markers')
    assert ros.spin_until(lambda: bool(received))
    assert received[-1].data == pendulum_urdf(RotaryPendulum())
    assert ros.set_parameters('/sim/pendulum_plant', plant__arm_length=0.2) == ['']
    wanted = pendulum_urdf(RotaryPendulum(arm_length=0.2))
    assert ros.spin_until(lambda: received[-1].data == wanted)
    assert viewer.shows(lambda scene: scene['disk'].scale.x > 0.35)


def test_markers_can_be_switched_off(ros: Ros, plant: NodeProcess) -> None:
    viewer = Viewer(ros, '/sim/plant_markers')
    assert ros.spin_until(lambda: bool(viewer.arrays))
    assert ros.set_parameters('/sim/pendulum_plant', markers__rate=0.0) == ['']
    ros.spin_for(0.2)
    viewer.arrays.clear()
    ros.spin_for(0.3)
    assert not viewer.arrays
    plant.end_cleanly()


def test_a_real_pendulum_is_drawn_by_the_planner(ros: Ros, planner: NodeProcess) -> None:
    viewer = Viewer(ros, '/pendulum/plant_markers')
    states = ros.publisher('/pendulum/joint_states', JointState)
    ros.spin_for(0.2)
    assert not viewer.arrays  # nothing is measured yet
    message = JointState(name=['disk', 'pendulum'], position=[0.7, 3.0], velocity=[0.0, 0.0])

    assert ros.publish_until(
        lambda: states.publish(message),
        lambda: viewer.showing(lambda scene: scene.namespaces == RIG),
    ), planner.output
    check_markers(viewer.arrays[-1], 'world', LIFETIME)
    turned = viewer.scene['disk'].pose.orientation
    assert 2 * math.atan2(turned.z, turned.w) == pytest.approx(0.7)
    # What is too old is drawn no more.
    ros.spin_for(0.8)
    viewer.arrays.clear()
    ros.spin_for(0.3)
    assert not viewer.arrays


def test_the_pendulums_plans_replace_each_other(ros: Ros, planner: NodeProcess) -> None:
    viewer = Viewer(ros, '/pendulum/markers', LATCHED)
    for theta in (3.0, 2.5):
        ros.set_parameters('/pendulum/planner', start__theta=theta)
        viewer.arrays.clear()
        success, answer = ros.trigger('/pendulum/plan')
        assert success, answer
        assert ros.spin_until(lambda: bool(viewer.arrays))
        (array,) = viewer.arrays
        check_markers(array, 'world', 0.0)
        assert array.markers[0].action == Marker.DELETEALL
        assert viewer.scene.names == {('planned_path', 0), ('goal', 0)}
        height = viewer.scene['planned_path'].points[0].z
        assert height == pytest.approx(0.129 * math.cos(theta))


# The robots: robot1 is simulated, robot2 and robot3 are real ones.


class Robots:
    """The robots' planner, what it publishes, and goal poses for robot1."""

    def __init__(self, ros: Ros) -> None:
        self.ros = ros
        self.process = ros.start(
            'tdm_planner.nodes.planner',
            {'problem': 'robot_formation', 'start.source': 'parameters'},
            namespace='robots',
        )
        self.plan = Viewer(ros, '/robots/markers', LATCHED)
        self.trajectories = ros.subscribe(
            '/robots/robot1/trajectory', MultiDOFJointTrajectory, LATCHED
        )
        self.live = Viewer(ros, '/robots/robot1/plant_markers')
        assert ros.spin_until(lambda: bool(self.plan.arrays), 20.0), self.process.output
        self._goals = ros.publisher('/robots/robot1/goal_pose', PoseStamped)

    def set(self, **values: Any) -> None:  # noqa: A003
        assert set(self.ros.set_parameters('/robots/planner', **values)) <= {''}

    @property
    def place(self) -> list[float]:
        request = GetParameters.Request(names=['formation.robot1'])
        answer = self.ros.call('/robots/planner/get_parameters', GetParameters, request)
        return list(answer.values[0].double_array_value)

    def goal(self, x: float, y: float, yaw: float = 0.0, frame: str = 'arena', w: float = 0.0):
        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x, message.pose.position.y = x, y
        message.pose.orientation = to_quaternion(yaw)
        message.pose.orientation.w += w
        self._goals.publish(message)

    def refusals(self) -> list[Marker]:
        return [
            m for a in self.live.arrays for m in a.markers if m.ns == 'refusal' and m.action == 0
        ]


@pytest.fixture(scope='module')
def robots(ros: Ros) -> Robots:
    return Robots(ros)


def test_the_set_up_is_shown_before_there_is_a_plan(robots: Robots) -> None:
    array = robots.plan.arrays[-1]
    check_markers(array, 'arena', 0.0)
    assert Scene(array).namespaces == {'arena', 'goal', 'safety_circle'}
    robots.set(arena__length=6.0)
    assert robots.plan.shows(lambda scene: max(p.x for p in scene['arena'].points) == 6.0)
    robots.set(arena__length=4.0)


def test_the_plan_is_shown_for_every_robot(ros: Ros, robots: Robots) -> None:
    assert ros.trigger('/robots/plan', timeout=30.0)[0]
    assert robots.plan.shows(lambda scene: 'planned_path' in scene.namespaces)
    array = robots.plan.arrays[-1]
    check_markers(array, 'arena', 0.0)
    assert array.markers[0].action == Marker.DELETEALL
    each = {(name, k) for name in ('goal', 'safety_circle', 'planned_path') for k in range(3)}
    assert Scene(array).names == {('arena', 0)} | each


def test_a_goal_pose_moves_the_robots_place(ros: Ros, robots: Robots) -> None:
    robots.trajectories.clear()
    assert ros.publish_until(
        lambda: robots.goal(3.2, 3.1, yaw=2.0), lambda: bool(robots.trajectories), 15.0, every=5.0
    ), robots.process.output
    end = robots.trajectories[-1].points[-1].transforms[0].translation
    assert (end.x, end.y) == pytest.approx((3.2, 3.1), abs=5e-3)
    # Anchor [2, 2, 0.5]
    c, s = math.cos(0.5), math.sin(0.5)
    expected = [c * 1.2 + s * 1.1, c * 1.1 - s * 1.2, 1.5]
    np.testing.assert_allclose(robots.place, expected, atol=1e-9)
    assert robots.plan.shows(lambda scene: abs(scene['goal', 0].pose.position.x - 3.2) < 5e-3)
    path = robots.plan.scene['planned_path', 0].points
    assert (path[-1].x, path[-1].y) == pytest.approx((3.2, 3.1), abs=5e-3)
    # The service goes on from there.
    robots.trajectories.clear()
    assert ros.trigger('/robots/plan', timeout=30.0)[0]
    assert ros.spin_until(lambda: bool(robots.trajectories))
    end = robots.trajectories[-1].points[-1].transforms[0].translation
    assert (end.x, end.y) == pytest.approx((3.2, 3.1), abs=5e-3)


@pytest.mark.parametrize(
    ('goal', 'settings', 'words'),
    [
        ({'x': 9.0, 'y': 1.0}, {}, ['INVALID_PROBLEM', 'robot1', 'outside the arena']),
        ({'x': 1.0, 'y': 1.0, 'frame': 'map'}, {}, ["'map'", "'arena'"]),
        ({'x': math.nan, 'y': 1.0}, {}, ['nan', 'finite']),
        ({'x': 1.0, 'y': 1.0, 'w': 1.0}, {}, ['unit quaternion']),
        ({'x': 1.0, 'y': 1.0, 'w': math.nan}, {}, ['unit quaternion']),
        ({'x': 1.6, 'y': 2.24}, {}, ['INVALID_PROBLEM', 'robot2', 'apart']),
        ({'x': 1.0, 'y': 3.0}, {'solver__deadline': 1e-6}, ['DEADLINE', 'no plan within']),
    ],
    ids=['outside', 'frame', 'nan', 'length', 'nan_rotation', 'too_near', 'no_plan'],
)
def test_a_refused_goal_changes_nothing_and_says_why(
    ros: Ros, robots: Robots, goal: dict[str, Any], settings: dict[str, Any], words: list[str]
) -> None:
    before, logged = robots.place, len(robots.process.output)
    robots.trajectories.clear()
    robots.plan.arrays.clear()
    robots.live.arrays.clear()
    robots.set(**settings)
    try:
        robots.goal(**goal)
        assert ros.spin_until(lambda: bool(robots.refusals())), robots.process.output
    finally:
        robots.set(solver__deadline=ENOUGH)
    (notice,) = robots.refusals()
    for array in robots.live.arrays:
        check_markers(array, 'arena', LIFETIMES)
    assert notice.type == Marker.TEXT_VIEW_FACING
    text = ' '.join(notice.text.split())
    assert all(word in text for word in words), text
    refusals = [line for line in robots.process.output[logged:].splitlines() if 'refused' in line]
    assert len(refusals) == 1
    assert text.removeprefix('robot1: ') in refusals[0]
    assert robots.place == before
    assert not robots.trajectories
    assert not robots.plan.arrays


def test_a_goal_while_another_request_is_solved_is_busy(ros: Ros, robots: Robots) -> None:
    robots.trajectories.clear()
    robots.live.arrays.clear()
    robots.goal(3.0, 3.3)
    robots.goal(1.0, 3.0)
    assert ros.spin_until(lambda: bool(robots.trajectories) and bool(robots.refusals()))
    assert 'BUSY' in robots.refusals()[0].text
    end = robots.trajectories[-1].points[-1].transforms[0].translation
    assert (end.x, end.y) == pytest.approx((3.0, 3.3), abs=5e-3)
    # The accepted one takes the notice away.
    robots.goal(2.8, 3.3)
    assert robots.live.shows(lambda scene: 'refusal' not in scene.namespaces)


def test_a_simulated_robot_draws_itself_and_its_thrust(ros: Ros, robots: Robots) -> None:
    process = ros.start(
        'tdm_sim.robot_plant',
        {'initial.x': 1.0, 'initial.yaw': 0.5, 'initial.alpha': 1.0, 'command_timeout': 30.0},
        namespace='robots/robot1',
    )
    robots.live.arrays.clear()
    assert robots.live.shows(lambda scene: scene.namespaces >= ROBOT), process.output
    assert 'plume' not in robots.live.scene.namespaces
    command = ros.publisher('/robots/robot1/joint_command', JointState)
    message = JointState(
        name=['thruster', 'reaction_wheel'], velocity=[0.0, 0.0], effort=[0.5, 0.0]
    )
    robots.live.arrays.clear()
    assert ros.publish_until(
        lambda: command.publish(message),
        lambda: robots.live.showing(lambda scene: 'plume' in scene.namespaces),
    )
    for array in robots.live.arrays:
        check_markers(array, 'arena', LIFETIMES)
    turned = robots.live.scene['plume'].pose.orientation
    assert 2 * math.atan2(turned.z, turned.w) == pytest.approx(1.5)
    # Both the plant and the planner could publish here: the planner leaves it to the plant.
    robots.live.arrays.clear()
    assert ros.spin_until(lambda: len(robots.live.arrays) > 20)
    stamps = [nanoseconds_of(array.markers[0].header.stamp) for array in robots.live.arrays]
    assert np.median(np.diff(stamps)) > 0.035e9
    process.end_cleanly()


def test_a_real_robot_is_drawn_by_the_planner(ros: Ros, robots: Robots) -> None:
    viewer = Viewer(ros, '/robots/robot2/plant_markers')
    odometry = ros.publisher('/robots/robot2/odom', Odometry)
    joints = ros.publisher('/robots/robot2/joint_states', JointState)
    message = Odometry()
    message.header.frame_id = 'arena'
    message.pose.pose.position.x, message.pose.pose.position.y = 1.5, 2.5
    message.pose.pose.orientation = to_quaternion(0.3)
    state = JointState(name=['thruster'], position=[0.4], velocity=[0.0], effort=[1.05])

    def publish() -> None:
        odometry.publish(message)
        joints.publish(state)

    assert ros.publish_until(
        publish, lambda: viewer.showing(lambda scene: scene.namespaces >= ROBOT | {'plume'})
    ), robots.process.output
    for array in viewer.arrays:
        check_markers(array, 'arena', LIFETIMES)
    scene = viewer.scene
    where, turned = scene['body'].pose.position, scene['plume'].pose.orientation
    assert (where.x, where.y) == (1.5, 2.5)
    assert 2 * math.atan2(turned.z, turned.w) == pytest.approx(0.7)
    assert scene['name'].text == 'robot2'
