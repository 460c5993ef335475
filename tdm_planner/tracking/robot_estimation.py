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

"""State of a floating robot, and what its actuators deliver, from noisy samples."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.tracking.estimator import CommandHistory, EstimatorNoise, StateEstimator
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters

Array = NDArray[np.float64]

_YAW, _OMEGA, _ALPHA, _THRUST_GAIN, _WHEEL_GAIN = 4, 5, 6, 7, 8
_GAIN_RANGE = (0.5, 2.0)  # of the estimated actuator gains
_GAIN_SPREAD = 0.1  # standard deviation of an actuator's gain before anything is known of it
_GAIN_UNKNOWN = 1e3  # nothing measures the gains directly


class EstimatedRobot:
    """The floating robot with two more states: what thruster and wheel deliver per command."""

    def __init__(self, robot: FloatingRobot) -> None:
        self.robot = robot
        self.state_names = (*robot.state_names, 'thrust_gain', 'torque_gain')
        self.state_units = (*robot.state_units, '', '')
        self.control_names = robot.control_names
        self.control_units = robot.control_units

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (9,), (3,) -> (9,)."""
        gains = np.array([state[_THRUST_GAIN], 1.0, state[_WHEEL_GAIN]])
        motion = self.robot.derivative(state[:7], gains * control)
        return np.concatenate([motion, np.zeros(2)])

    def jacobians(self, state: Array, control: Array) -> tuple[Array, Array]:
        """Return df/dx (9, 9) and df/du (9, 3)."""
        thrust, torque = control[0] / self.robot.mass, control[2] / self.robot.inertia
        heading = state[_YAW] + state[_ALPHA]
        along = np.array([math.cos(heading), math.sin(heading)])
        across = np.array([-along[1], along[0]])
        by_state, by_control = np.zeros((9, 9)), np.zeros((9, 3))
        by_state[0, 2] = by_state[1, 3] = by_state[_YAW, _OMEGA] = 1.0
        by_state[2:4, _YAW] = by_state[2:4, _ALPHA] = state[_THRUST_GAIN] * thrust * across
        by_state[2:4, _THRUST_GAIN] = thrust * along
        by_state[_OMEGA, _WHEEL_GAIN] = torque
        by_control[2:4, 0] = state[_THRUST_GAIN] / self.robot.mass * along
        by_control[_OMEGA, 2] = state[_WHEEL_GAIN] / self.robot.inertia
        by_control[_ALPHA, 1] = 1.0
        return by_state, by_control


def actuator_gains(state: Array) -> tuple[float, float]:
    """Return the estimated gains of thruster and wheel, kept within reason."""
    lower, upper = _GAIN_RANGE
    thruster, wheel = state[[_THRUST_GAIN, _WHEEL_GAIN]].tolist()
    return min(max(thruster, lower), upper), min(max(wheel, lower), upper)


def robot_estimator(parameters: RobotTrackerParameters, history: CommandHistory) -> StateEstimator:
    """Return the estimator of a robot's states and of its actuators' gains (9,)."""
    assumed, limits, plant = parameters.estimator, parameters.limits, parameters.plant
    push, spin = limits.thrust / plant.mass, limits.torque / plant.inertia
    measured = [assumed.position_noise] * 2 + [assumed.velocity_noise] * 2
    measured += [assumed.angle_noise] * 2 + [assumed.thruster_noise]
    noise = EstimatorNoise(
        measurement=np.array(measured + [_GAIN_UNKNOWN] * 2),
        model=assumed.model_error,
        rate_floor=np.array([0.0, 0.0, push, push, 0.0, spin, 0.0, 0.0, 0.0]),
        driven=np.array([False, False, True, True, False, True, False, False, False]),
        prior=np.array(measured + [_GAIN_SPREAD] * 2),
    )
    angles = np.zeros(9, dtype=bool)
    angles[[_YAW, _ALPHA]] = True
    return StateEstimator(
        EstimatedRobot(plant), noise, angles, history, longest_gap=parameters.state_timeout
    )
