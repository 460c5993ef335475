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

"""Node `robot_plant`: one simulated floating robot with a turning thruster and reaction wheel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
import sys
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rclpy.time import Time
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.frames import ARENA_FRAME
from tdm_planner.nodes.robot_markers import RobotLook, RobotPicture, RobotState
from tdm_planner.nodes.runtime import run
from tdm_planner.parameters import (
    group,
    NON_NEGATIVE,
    parameter,
    POSITIVE,
    Range,
    SIGNED,
    Validated,
)
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_sim.commands import read_joint
from tdm_sim.disturbances import robot_push
from tdm_sim.mismatch import mismatched, mismatched_gains
from tdm_sim.plant_node import MarkerParameters, PlantNode, SimulationParameters, WARNING_PERIOD
from tdm_sim.simulation import PlantSetup
from tdm_sim.wheeled_robot import Walls, WheeledRobot
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

JOINTS = ('thruster', 'reaction_wheel')
DEFAULT_NAME = 'robot1'


_PLACE, _RATE = Range(-1e4, 1e4), Range(-100.0, 100.0)


@dataclass(frozen=True)
class RobotInitialState(Validated):
    """State at the start and after `reset`."""

    x: float = parameter(2.0, 'position along x', unit='m', allowed=_PLACE)
    y: float = parameter(2.0, 'position along y', unit='m', allowed=_PLACE)
    u: float = parameter(0.0, 'velocity along x', unit='m/s', allowed=_RATE)
    v: float = parameter(0.0, 'velocity along y', unit='m/s', allowed=_RATE)
    yaw: float = parameter(0.0, 'yaw, from the x axis', unit='rad', allowed=_PLACE)
    omega: float = parameter(0.0, 'yaw rate', unit='rad/s', allowed=_RATE)
    alpha: float = parameter(
        0.0, "thruster's angle from the robot's front", unit='rad', allowed=_PLACE
    )
    wheel_speed: float = parameter(
        0.0, 'speed of the reaction wheel', unit='rad/s', allowed=Range(-1e5, 1e5)
    )


@dataclass(frozen=True)
class RobotNoise(Validated):
    """Standard deviations of the measurements (white, Gaussian)."""

    position: float = parameter(0.0, 'noise of x and of y', unit='m', allowed=NON_NEGATIVE)
    velocity: float = parameter(
        0.0, 'noise of the velocity along x and along y', unit='m/s', allowed=NON_NEGATIVE
    )
    yaw: float = parameter(0.0, 'noise of the yaw', unit='rad', allowed=NON_NEGATIVE)
    omega: float = parameter(0.0, 'noise of the yaw rate', unit='rad/s', allowed=NON_NEGATIVE)
    alpha: float = parameter(
        0.0, "noise of the thruster's angle", unit='rad', allowed=NON_NEGATIVE
    )


@dataclass(frozen=True)
class RobotDisturbance(Validated):
    """What happens to the robot from outside."""

    impulse: float = parameter(
        0.3, 'impulse of one push at the centre of mass', unit='N s', allowed=SIGNED
    )
    direction: float | None = parameter(
        None,
        "direction of a push in the arena's frame; unset: at random",
        unit='rad',
        allowed=SIGNED,
    )
    command_loss: float = parameter(
        0.0, 'probability that a command is lost', allowed=Range(0.0, 1.0)
    )


@dataclass(frozen=True)
class RobotArena(Validated):
    """Walls of the arena [0, length] x [0, width], and what is drawn of its rules."""

    walls: bool = parameter(False, 'whether the robot bounces off the walls')
    length: float = parameter(4.0, 'length along x', unit='m', allowed=POSITIVE)
    width: float = parameter(4.0, 'width along y', unit='m', allowed=POSITIVE)
    robot_radius: float = parameter(
        0.15, "radius of the robot's body", unit='m', allowed=NON_NEGATIVE
    )
    minimum_separation: float = parameter(
        0.4,
        'least distance of two robots, the diameter of the disc drawn around this one',
        unit='m',
        allowed=POSITIVE,
    )


@dataclass(frozen=True)
class RobotMarkers(MarkerParameters):
    """How the robot is drawn, while somebody looks."""

    trail: float = parameter(
        60.0, 'time for which the travelled trail is shown', unit='s', allowed=Range(0.0, 600.0)
    )


@dataclass(frozen=True)
class RobotPlantParameters(SimulationParameters):
    """Parameters of the node."""

    robot_name: str = parameter(
        '',
        "name of the robot, the child frame of odom; empty: the last part of the node's namespace",
        read_only=True,
    )
    plant: FloatingRobot = group(FloatingRobot)
    limits: RobotLimits = group(RobotLimits)
    initial: RobotInitialState = group(RobotInitialState)
    noise: RobotNoise = group(RobotNoise)
    disturbance: RobotDisturbance = group(RobotDisturbance)
    arena: RobotArena = group(RobotArena)
    markers: RobotMarkers = group(RobotMarkers)


class RobotPlant(PlantNode):
    """
    A simulated floating robot.

    `odom`: pose in the frame `arena`, twist in the robot's own frame. `joint_states`: [thruster,
    reaction_wheel], positions alpha and the wheel's angle, velocities the thruster's rate and the
    wheel's speed, efforts thrust [N] and torque [N m] applied. `joint_command`: velocity and
    effort of `thruster` (rate, thrust), effort of `reaction_wheel` (torque). The mismatch also
    makes thrust and torque differ from what is commanded. `plant_markers`: see `RobotPicture`.
    """

    def __init__(self, **options: Any) -> None:
        self._collisions = 0
        super().__init__('robot_plant', RobotPlantParameters, **options)

    @property
    def robot_name(self) -> str:
        """Name of the robot."""
        given: str = self.parameters.robot_name
        return given or self.get_namespace().rsplit('/', 1)[-1] or DEFAULT_NAME

    def make_setup(self, parameters: RobotPlantParameters) -> PlantSetup:
        """Return the robot, its limits and its disturbances as `parameters` say."""
        start, noise, limits = parameters.initial, parameters.noise, parameters.limits
        gains = mismatched_gains(3, parameters.mismatch, parameters.mismatch_seed)
        gains[1] = 1.0  # the thruster turns by a servo, which has no such error
        robot = mismatched(parameters.plant, parameters.mismatch, parameters.mismatch_seed)
        return PlantSetup(
            plant=WheeledRobot(robot),
            initial=_state(start),
            lower=np.array([0.0, -limits.thruster_rate, -limits.torque]),
            upper=np.array([limits.thrust, limits.thruster_rate, limits.torque]),
            noise=np.array(
                [noise.position] * 2
                + [noise.velocity] * 2
                + [noise.yaw, noise.omega, noise.alpha, 0.0, 0.0]
            ),
            gains=gains,
            command_timeout=parameters.command_timeout,
            command_loss=parameters.disturbance.command_loss,
            contact=self._walls(parameters.arena),
        )

    def _walls(self, arena: RobotArena) -> Walls | None:
        if not arena.walls:
            return None
        if 2.0 * arena.robot_radius >= min(arena.length, arena.width):
            raise InvalidProblem(
                f"parameter 'arena.robot_radius' = {arena.robot_radius:g} is not allowed: must be "
                f'in [0, {min(arena.length, arena.width) / 2.0:g}) m, half of the shorter wall'
            )
        return Walls(arena.length, arena.width, arena.robot_radius, self._on_collision)

    def _on_collision(self, axis: str, speed: float) -> None:
        self._collisions += 1
        self.get_logger().warning(
            f'{self.robot_name} hit a wall with {speed:.3g} m/s along {axis}',
            throttle_duration_sec=WARNING_PERIOD,
        )

    def make_publishers(self) -> None:
        """Create the publishers of `joint_states` and `odom`."""
        self._joint_states = self.create_publisher(JointState, 'joint_states', 10)
        self._odom = self.create_publisher(Odometry, 'odom', 10)
        self._picture = RobotPicture(self._look(), self.parameters.markers.trail)

    def _look(self) -> RobotLook:
        given = self.parameters
        radius, separation = given.arena.robot_radius, given.arena.minimum_separation
        # A point has no picture: without a radius the body is drawn as large as the disc allows.
        return RobotLook(
            self.robot_name, radius or 0.375 * separation, separation, given.limits.thrust
        )

    def values_changed(self, names: frozenset[str]) -> None:
        """Let changed parameters act from now on, in the picture as well."""
        super().values_changed(names)
        self._picture.set_up(self._look(), self.parameters.markers.trail)

    def follow(self, measured: Array, now: Time) -> None:
        """Lengthen the trail."""
        self._picture.add(now.nanoseconds, float(measured[0]), float(measured[1]))

    def moved_elsewhere(self) -> None:
        """Forget the trail."""
        self._picture.clear()

    def draw(self, measured: Array, now: Time, lifetime: float) -> MarkerArray:
        """Return the robot."""
        x, y, _, _, yaw, _, alpha = measured[:7].tolist()
        thrust = float(self.simulation.control[0])
        state = RobotState(x, y, yaw, alpha, thrust)
        return self._picture.draw(now.to_msg(), state, lifetime)

    def publish_state(self, measured: Array, stamp: Any) -> None:
        """Publish `joint_states` and `odom`."""
        x, y, u, v, yaw, omega, alpha, wheel_angle, wheel_speed = measured.tolist()
        thrust, rate, torque = self.simulation.control.tolist()
        joints = JointState(
            name=JOINTS,
            position=[alpha, wheel_angle],
            velocity=[rate, wheel_speed],
            effort=[thrust, torque],
        )
        joints.header.stamp = stamp
        joints.header.frame_id = self.robot_name
        self._joint_states.publish(joints)
        odom = Odometry(child_frame_id=self.robot_name)
        odom.header.stamp = stamp
        odom.header.frame_id = ARENA_FRAME
        odom.pose.pose.position.x, odom.pose.pose.position.y = x, y
        odom.pose.pose.orientation.z = math.sin(yaw / 2.0)
        odom.pose.pose.orientation.w = math.cos(yaw / 2.0)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        odom.twist.twist.linear.x = cosine * u + sine * v
        odom.twist.twist.linear.y = cosine * v - sine * u
        odom.twist.twist.angular.z = omega
        noise = self.parameters.noise
        odom.pose.covariance = _covariance(noise.position, noise.yaw)
        odom.twist.covariance = _covariance(noise.velocity, noise.omega)
        self._odom.publish(odom)

    def read_command(self, message: JointState) -> Array:
        """Return thrust, thruster rate and torque (3,) of a command."""
        return np.array(
            [
                read_joint(message, 'thruster', 'effort'),
                read_joint(message, 'thruster', 'velocity'),
                read_joint(message, 'reaction_wheel', 'effort'),
            ]
        )

    def push_effect(self) -> tuple[Callable[[Array], Array], str]:
        """Return the effect of an impulse at the centre of mass."""
        plant = self.simulation.setup.plant
        assert isinstance(plant, WheeledRobot)
        impulse, direction = self.parameters.disturbance.impulse, self._push_direction()
        return (
            lambda state: robot_push(plant.robot, state, impulse, direction),
            f'pushed {self.robot_name} with {impulse:g} N s towards {direction:.3f} rad',
        )

    def _push_direction(self) -> float:
        given: float | None = self.parameters.disturbance.direction
        return self.simulation.disturbances.direction() if given is None else given

    def conditions(self) -> tuple[list[str], dict[str, Any]]:
        """Report collisions with the walls."""
        warnings = [f'{self._collisions} collisions with a wall'] if self._collisions else []
        return warnings, {'collisions': self._collisions}


def _state(start: RobotInitialState) -> Array:
    wheel_angle = 0.0
    motion = (start.x, start.y, start.u, start.v, start.yaw, start.omega, start.alpha)
    return np.array([*motion, wheel_angle, start.wheel_speed])


def _covariance(linear: float, angular: float) -> Array:
    """Row-major covariance (36,) of x, y and the rotation about z, from standard deviations."""
    matrix = np.zeros((6, 6))
    matrix[0, 0] = matrix[1, 1] = linear**2
    matrix[5, 5] = angular**2
    return matrix.ravel()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is asked to end."""
    return run(RobotPlant, args)


if __name__ == '__main__':
    sys.exit(main())
