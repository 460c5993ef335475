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

"""Node `pendulum_plant`: a simulated rotary pendulum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tdm_planner.nodes.pendulum_markers import PendulumPicture
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.nodes.runtime import run
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, Range, SIGNED, Validated
from tdm_planner.plants.rotary_pendulum import PendulumLimits, RotaryPendulum
from tdm_planner.views.pendulum_urdf import pendulum_urdf
from tdm_sim.commands import read_joint
from tdm_sim.disturbances import pendulum_push
from tdm_sim.mismatch import mismatched
from tdm_sim.plant_node import MarkerParameters, PlantNode, SimulationParameters
from tdm_sim.simulation import PlantSetup
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

JOINTS = ('pendulum', 'disk')


_ANGLE, _RATE = Range(-1e6, 1e6), Range(-1e3, 1e3)


@dataclass(frozen=True)
class InitialState(Validated):
    """State at the start and after `reset`."""

    theta: float = parameter(math.pi, "pendulum's angle from upright", unit='rad', allowed=_ANGLE)
    psi: float = parameter(0.0, "disk's angle", unit='rad', allowed=_ANGLE)
    theta_dot: float = parameter(0.0, "pendulum's angular velocity", unit='rad/s', allowed=_RATE)
    psi_dot: float = parameter(0.0, "disk's angular velocity", unit='rad/s', allowed=_RATE)


@dataclass(frozen=True)
class PendulumNoise(Validated):
    """Standard deviations of the measurements (white, Gaussian)."""

    theta: float = parameter(
        0.0, "noise of the pendulum's angle", unit='rad', allowed=NON_NEGATIVE
    )
    psi: float = parameter(0.0, "noise of the disk's angle", unit='rad', allowed=NON_NEGATIVE)
    theta_dot: float = parameter(
        0.0, "noise of the pendulum's angular velocity", unit='rad/s', allowed=NON_NEGATIVE
    )
    psi_dot: float = parameter(
        0.0, "noise of the disk's angular velocity", unit='rad/s', allowed=NON_NEGATIVE
    )


@dataclass(frozen=True)
class PendulumDisturbance(Validated):
    """What happens to the pendulum from outside."""

    impulse: float = parameter(
        2e-4,
        "angular impulse of one push about the pendulum's pivot",
        unit='N m s',
        allowed=SIGNED,
    )
    command_loss: float = parameter(
        0.0, 'probability that a command is lost', allowed=Range(0.0, 1.0)
    )


@dataclass(frozen=True)
class PendulumPlantParameters(SimulationParameters):
    """Parameters of the node."""

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumLimits = group(PendulumLimits)
    initial: InitialState = group(InitialState)
    noise: PendulumNoise = group(PendulumNoise)
    disturbance: PendulumDisturbance = group(PendulumDisturbance)
    markers: MarkerParameters = group(MarkerParameters)


class PendulumPlant(PlantNode):
    """
    A simulated rotary pendulum.

    `joint_states`: [pendulum, disk], positions theta (0 upright, not wrapped) and psi, effort 0
    and the torque applied. `joint_command`: effort of joint `disk`. `robot_description`: the URDF
    of the pendulum that the parameters describe, latched. `plant_markers`: see `PendulumPicture`.
    The disk has no mechanical stop: angles beyond `limits.disk_angle` are reported, not prevented.
    """

    def __init__(self, **options: Any) -> None:
        self._largest_disk_angle = 0.0
        self._described = ''
        super().__init__('pendulum_plant', PendulumPlantParameters, **options)

    def make_setup(self, parameters: PendulumPlantParameters) -> PlantSetup:
        """Return the pendulum, its limits and its disturbances as `parameters` say."""
        start, noise = parameters.initial, parameters.noise
        torque = np.array([parameters.limits.torque])
        return PlantSetup(
            plant=mismatched(parameters.plant, parameters.mismatch, parameters.mismatch_seed),
            initial=np.array([start.theta, start.psi, start.theta_dot, start.psi_dot]),
            lower=-torque,
            upper=torque,
            noise=np.array([noise.theta, noise.psi, noise.theta_dot, noise.psi_dot]),
            command_timeout=parameters.command_timeout,
            command_loss=parameters.disturbance.command_loss,
        )

    def make_publishers(self) -> None:
        """Create the publishers of `joint_states` and `robot_description`."""
        self._joint_states = self.create_publisher(JointState, 'joint_states', 10)
        self._description = self.create_publisher(String, 'robot_description', LATCHED)
        given = self.parameters
        self._picture = PendulumPicture(given.plant, given.limits.disk_angle, given.markers.trail)
        self._describe()

    def values_changed(self, names: frozenset[str]) -> None:
        """Let changed parameters act from now on, in the picture as well."""
        super().values_changed(names)
        if any(name.startswith(('plant.', 'limits.', 'markers.')) for name in names):
            self._describe()

    def _describe(self) -> None:
        """Publish the URDF and set the picture up, both for the parameters without mismatch."""
        given = self.parameters
        description = pendulum_urdf(given.plant)
        if description != self._described:
            self._described = description
            self._description.publish(String(data=description))
        self._picture.set_up(given.plant, given.limits.disk_angle, given.markers.trail)

    def follow(self, measured: Array, now: Time) -> None:
        """Lengthen the trail of the tip."""
        self._picture.add(now.nanoseconds, float(measured[0]), float(measured[1]))

    def moved_elsewhere(self) -> None:
        """Forget the trail."""
        self._picture.clear()

    def draw(self, measured: Array, now: Time, lifetime: float) -> MarkerArray:
        """Return the rig."""
        theta, psi = measured[:2].tolist()
        return self._picture.draw(now.to_msg(), theta, psi, lifetime)

    def publish_state(self, measured: Array, stamp: Any) -> None:
        """Publish `joint_states`."""
        self._largest_disk_angle = max(self._largest_disk_angle, abs(self.simulation.state[1]))
        theta, psi, theta_dot, psi_dot = measured.tolist()
        message = JointState(
            name=JOINTS,
            position=[theta, psi],
            velocity=[theta_dot, psi_dot],
            effort=[0.0, float(self.simulation.control[0])],
        )
        message.header.stamp = stamp
        self._joint_states.publish(message)

    def read_command(self, message: JointState) -> Array:
        """Return the torque (1,) of a command."""
        return np.array([read_joint(message, 'disk', 'effort')])

    def push_effect(self) -> tuple[Callable[[Array], Array], str]:
        """Return the effect of an impulse about the pendulum's pivot."""
        impulse = self.parameters.disturbance.impulse
        plant = self.simulation.setup.plant
        assert isinstance(plant, RotaryPendulum)
        return (
            lambda state: pendulum_push(plant, state, impulse),
            f'pushed the pendulum with {impulse:g} N m s',
        )

    def conditions(self) -> tuple[list[str], dict[str, Any]]:
        """Report the disk's angle beyond its limit since the last report."""
        largest, limit = self._largest_disk_angle, self.parameters.limits.disk_angle
        self._largest_disk_angle = 0.0
        warnings = []
        if largest > limit:
            warnings.append(f'disk at {largest:.3f} rad, beyond limits.disk_angle = {limit:g} rad')
        return warnings, {'largest disk angle [rad]': largest}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is asked to end."""
    return run(PendulumPlant, args)


if __name__ == '__main__':
    sys.exit(main())
