# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What the tracker node must know of each plant: its topics, its messages, its feedback law."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
import time
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import (
    from_wire,
    joint_motion,
    LATCHED,
    nanoseconds_of,
    PENDULUM_JOINTS,
    pendulum_trajectory,
    stamp_of,
)
from tdm_planner.nodes.qos import NEWEST
from tdm_planner.nodes.robot_messages import (
    odometry_state,
    ROBOT_JOINTS,
    robot_trajectory,
    thruster_angle,
)
from tdm_planner.nodes.stated_plants import (
    problem_from,
    stated_problem,
    StatedMessages,
    with_parameters_of,
)
from tdm_planner.parameters import shown, to_mapping
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_planner.problems.registry import problem_names
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker
from tdm_planner.tracking.stated_tracking import StatedTracker
from tdm_planner.tracking.tracker import Action, TrajectoryTracker
from tdm_planner.tracking.tracker_parameters import TrackerParameters
from tdm_planner.trajectory import NANOSECOND, Trajectory
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

Array = NDArray[np.float64]

QUEUE = 10
MOST_HALVES = 4  # plans of which the other half may still come


class Intake(Protocol):
    """Where a plant's messages go; what is raised is logged as the reason for leaving one out."""

    def on_state(self, stamp: Any, read: Callable[[], Array | None]) -> None:
        """Take a state (nx,) read from a message, of the instant `stamp`; None: not complete."""

    def on_trajectory(
        self, stamp: Any, read: Callable[[], Trajectory], messages: Mapping[str, bytes]
    ) -> None:
        """
        Take a trajectory that starts at `stamp`, and the `messages` it came in, by topic.

        The topics are those of `TrackedPlant.in_force`. The messages are as they came: to take
        one apart costs milliseconds, which a plan that is replaced at once is not worth.
        """

    def refuse(self, error: Exception) -> None:
        """Leave out a trajectory of which not even the stamp can be read."""


def _stamped(intake: Intake, take: Callable[[Any, bytes], None]) -> Callable[[bytes], None]:
    """Return a callback that hands serialised messages on with their stamps, if they have one."""

    def on_data(data: bytes) -> None:
        try:
            stamp = stamp_of(data)
        except InvalidProblem as error:
            intake.refuse(error)
        else:
            take(stamp, data)

    return on_data


class TrackedPlant(ABC):
    """A plant as the tracker node sees it."""

    parameters: type[TrackerParameters]
    in_force: ClassVar[Mapping[str, Any]]  # topics that tell what is followed, and their types

    @abstractmethod
    def make_tracker(self, parameters: Any) -> TrajectoryTracker:
        """Return the feedback law; raises InvalidProblem for parameters that do not fit."""

    @abstractmethod
    def subscribe(self, node: Node, intake: Intake) -> None:
        """Subscribe to the trajectory and the state."""

    @abstractmethod
    def command_message(self, control: Array) -> JointState:
        """Return the actuator command for controls (nu,)."""

    @abstractmethod
    def error_message(self, action: Action) -> JointState:
        """Return the tracking error and the feedback within the command."""


class TrackedPendulum(TrackedPlant):
    """The rotary pendulum: `trajectory`, `joint_states` -> effort of joint `disk`."""

    parameters = PendulumTrackerParameters
    in_force = MappingProxyType({'trajectory_in_force': JointTrajectory})

    def make_tracker(self, parameters: PendulumTrackerParameters) -> TrajectoryTracker:
        """Return the pendulum's feedback law; its gains about upright are computed here."""
        tracker = PendulumTracker(parameters)
        tracker.prepare_hold()
        return tracker

    def subscribe(self, node: Node, intake: Intake) -> None:
        """Subscribe to `trajectory` and `joint_states`."""

        def on_trajectory(stamp: Any, data: bytes) -> None:
            intake.on_trajectory(
                stamp,
                lambda: pendulum_trajectory(from_wire(data, JointTrajectory)),
                {'trajectory_in_force': data},
            )

        def on_state(message: JointState) -> None:
            intake.on_state(message.header.stamp, lambda: joint_motion(message, PENDULUM_JOINTS))

        take = _stamped(intake, on_trajectory)
        node.create_subscription(JointTrajectory, 'trajectory', take, LATCHED, raw=True)
        node.create_subscription(JointState, 'joint_states', on_state, NEWEST)

    def command_message(self, control: Array) -> JointState:
        """Return the torque of the disk."""
        return JointState(name=['disk'], effort=[float(control[0])])

    def error_message(self, action: Action) -> JointState:
        """Return the errors of angles and rates, and the feedback torque."""
        return JointState(
            name=PENDULUM_JOINTS,
            position=action.error[:2].tolist(),
            velocity=action.error[2:].tolist(),
            effort=[0.0, float(action.feedback[0])],
        )


class _TwoHalves(TrackedPlant):
    """
    A plant whose plans come in two messages.

    The two halves of a plan carry the same stamp; the half that comes first waits for the other.
    """

    def __init__(self) -> None:
        self._halves: dict[int, dict[str, bytes]] = {}

    def take_half(
        self, intake: Intake, read: Callable[[list[Any]], Trajectory]
    ) -> Callable[[str], Callable[[bytes], None]]:
        """Return what makes the callback of a half, by the topic that tells it is followed."""

        def on_half(topic: str, stamp: Any, data: bytes) -> None:
            halves = self._complete(topic, nanoseconds_of(stamp), data)
            if halves is None:
                return

            def both() -> Trajectory:
                return read([from_wire(halves[n], kind) for n, kind in self.in_force.items()])

            intake.on_trajectory(stamp, both, halves)

        return lambda topic: _stamped(intake, partial(on_half, topic))

    def _complete(self, topic: str, stamp: int, data: bytes) -> dict[str, bytes] | None:
        """Return both halves of a plan when the second comes; plans of several may interleave."""
        halves = self._halves.setdefault(stamp, {})
        halves[topic] = data
        if len(halves) == len(self.in_force):
            return self._halves.pop(stamp)
        while len(self._halves) > MOST_HALVES:
            del self._halves[next(iter(self._halves))]
        return None


class TrackedRobot(_TwoHalves):
    """A floating robot: `trajectory`, `controls`, `odom`, `joint_states` -> its actuators."""

    parameters = RobotTrackerParameters
    in_force = MappingProxyType(
        {'trajectory_in_force': MultiDOFJointTrajectory, 'controls_in_force': JointTrajectory}
    )

    def __init__(self) -> None:
        super().__init__()
        self._joints: JointState | None = None
        self._joints_came = 0.0  # instant on a steady clock [s]

    def make_tracker(self, parameters: RobotTrackerParameters) -> TrajectoryTracker:
        """Return the robot's feedback law."""
        return RobotTracker(parameters)

    def subscribe(self, node: Node, intake: Intake) -> None:
        """Subscribe to `trajectory`, `controls`, `odom` and `joint_states`."""
        given = str(node.get_parameter('robot_name').value)
        robot = given or node.get_namespace().rsplit('/', 1)[-1] or None

        half = self.take_half(intake, lambda both: robot_trajectory(both[0], both[1], robot))
        on_motion, on_controls = half('trajectory_in_force'), half('controls_in_force')

        def on_odometry(message: Odometry) -> None:
            longest = float(node.get_parameter('state_timeout').value)
            intake.on_state(message.header.stamp, lambda: self.state(message, longest))

        node.create_subscription(
            MultiDOFJointTrajectory, 'trajectory', on_motion, LATCHED, raw=True
        )
        node.create_subscription(JointTrajectory, 'controls', on_controls, LATCHED, raw=True)
        node.create_subscription(JointState, 'joint_states', self.take_joints, NEWEST)
        node.create_subscription(Odometry, 'odom', on_odometry, NEWEST)

    def take_joints(self, message: JointState) -> None:
        """Take the half of a state that is not in `odom`."""
        self._joints, self._joints_came = message, time.monotonic()

    def state(self, odometry: Odometry, longest: float) -> Array | None:
        """
        Return the measured x, y, u, v, yaw, omega, alpha (7,); None where a half is missing.

        Raises
        ------
        InvalidProblem
            If the halves are of instants more than `longest` [s] apart.

        """
        joints = self._joints
        if joints is None:
            return None
        stamps = [nanoseconds_of(half.header.stamp) for half in (odometry, joints)]
        apart = (
            abs(stamps[0] - stamps[1]) * NANOSECOND
            if all(stamps)
            else time.monotonic() - self._joints_came  # without stamps, by when it came
        )
        if apart > longest:
            raise InvalidProblem(
                f'odom and the newest joint_states are {apart:.3g} s apart, more than '
                f'state_timeout = {longest:g} s'
            )
        return np.append(odometry_state(odometry), thruster_angle(joints))

    def command_message(self, control: Array) -> JointState:
        """Return rate and thrust of the thruster, torque of the wheel."""
        thrust, rate, torque = control.tolist()
        return JointState(name=ROBOT_JOINTS, velocity=[rate, 0.0], effort=[thrust, torque])

    def error_message(self, action: Action) -> JointState:
        """
        Return the errors of x, y, yaw and their rates, and the feedback of the actuators.

        Efforts: thrust and torque beyond what is planned, as those of thruster and wheel.
        """
        x, y, u, v, yaw, omega, alpha = action.error.tolist()
        thrust, _, torque = action.feedback.tolist()
        return JointState(
            name=['x', 'y', 'yaw', *ROBOT_JOINTS],
            position=[x, y, yaw, alpha, 0.0],
            velocity=[u, v, omega, 0.0, 0.0],
            effort=[0.0, 0.0, 0.0, thrust, torque],
        )


class TrackedProblem(_TwoHalves):
    """A stated problem: `trajectory` and `controls`, `joint_states` -> its controls as efforts."""

    in_force = MappingProxyType(
        {'trajectory_in_force': JointTrajectory, 'controls_in_force': JointTrajectory}
    )

    def __init__(self, problem: type[DirectProblem]) -> None:
        super().__init__()
        self._problem = problem
        self.parameters = with_parameters_of(TrackerParameters, problem)
        self._messages = StatedMessages(problem())

    def make_tracker(self, parameters: Any) -> TrajectoryTracker:
        """Return the feedback law for the problem with these numbers."""
        return StatedTracker(problem_from(self._problem, to_mapping(parameters)), parameters)

    def subscribe(self, node: Node, intake: Intake) -> None:
        """Subscribe to `trajectory`, `controls` and `joint_states`."""
        half = self.take_half(intake, lambda both: self._messages.read_plan(*both))

        def on_state(message: JointState) -> None:
            intake.on_state(message.header.stamp, lambda: self._messages.read_state(message))

        for topic in ('trajectory', 'controls'):
            take = half(f'{topic}_in_force')
            node.create_subscription(JointTrajectory, topic, take, LATCHED, raw=True)
        node.create_subscription(JointState, 'joint_states', on_state, NEWEST)

    def command_message(self, control: Array) -> JointState:
        """Return the controls."""
        return self._messages.command_message(control)

    def error_message(self, action: Action) -> JointState:
        """Return the deviation and the feedback within the command."""
        return self._messages.error_message(action.error, action.feedback)


_BUILT_IN: Mapping[str, type[TrackedPlant]] = MappingProxyType(
    {'pendulum': TrackedPendulum, 'robot': TrackedRobot}
)


def tracked_plant(kind: str) -> TrackedPlant:
    """
    Return the plant of a kind: pendulum, robot, or a stated problem.

    Raises
    ------
    InvalidProblem
        If there is none of that name.

    """
    if kind in _BUILT_IN:
        return _BUILT_IN[kind]()
    if ':' not in kind and kind not in problem_names():
        raise InvalidProblem(
            f"parameter 'kind' = '{shown(kind)}' is not allowed: must be one of "
            f'{", ".join(_BUILT_IN)}, or a stated problem such as my_module:MyProblem'
        )
    return TrackedProblem(stated_problem(kind))
