# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""State of a floating robot, and what its actuators deliver, from noisy samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.floating_robot import FloatingRobot, RobotInertia
from tdm_planner.tracking.estimator import (
    EstimatorNoise,
    GAIN_UNKNOWN,
    PlantWithGains,
    StateEstimator,
)
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters

Array = NDArray[np.float64]

_YAW, _OMEGA, _ALPHA, _THRUST_GAIN, _WHEEL_GAIN = 4, 5, 6, 7, 8
_GAIN_RANGE = (0.5, 2.0)  # of the estimated actuator gains
_GAIN_SPREAD = 0.1  # standard deviation of an actuator's gain before anything is known of it


class EstimatedRobot(PlantWithGains):
    """The floating robot with two more states: what thruster and wheel deliver per command."""

    state_names = (*FloatingRobot.state_names, 'thrust_gain', 'torque_gain')
    state_units = (*FloatingRobot.state_units, '', '')
    control_names = FloatingRobot.control_names
    control_units = FloatingRobot.control_units

    @staticmethod
    def equations(
        k: RobotInertia, state: Sequence[Any], control: Sequence[Any]
    ) -> tuple[Any, ...]:
        """Return the rates of the states; the arguments may hold numbers, arrays or symbols."""
        *motion, thrust_gain, torque_gain = state
        thrust, rate, torque = control
        given = thrust_gain * thrust, rate, torque_gain * torque
        return (*FloatingRobot.equations(k, motion, given), 0.0, 0.0)


def actuator_gains(state: Array) -> tuple[float, float]:
    """Return the estimated gains of thruster and wheel, kept within reason."""
    lower, upper = _GAIN_RANGE
    thruster, wheel = state[[_THRUST_GAIN, _WHEEL_GAIN]].tolist()
    return min(max(thruster, lower), upper), min(max(wheel, lower), upper)


def robot_estimator(parameters: RobotTrackerParameters) -> StateEstimator:
    """Return the estimator of a robot's states and of its actuators' gains (9,)."""
    assumed, limits, plant = parameters.estimator, parameters.limits, parameters.plant
    push, spin = limits.thrust / plant.mass, limits.torque / plant.inertia
    measured = [assumed.position_noise] * 2 + [assumed.velocity_noise] * 2
    measured += [assumed.angle_noise] * 2 + [assumed.thruster_noise]
    noise = EstimatorNoise(
        measurement=np.array(measured + [GAIN_UNKNOWN] * 2),
        model=assumed.model_error,
        rate_floor=np.array([0.0, 0.0, push, push, 0.0, spin, 0.0, 0.0, 0.0]),
        driven=np.array([False, False, True, True, False, True, False, False, False]),
        prior=np.array(measured + [_GAIN_SPREAD] * 2),
    )
    angles = np.zeros(9, dtype=bool)
    angles[[_YAW, _ALPHA]] = True
    return StateEstimator(EstimatedRobot(plant), noise, angles, parameters.state_timeout)
