# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The pendulum for the planner node."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from scipy.integrate import solve_ivp
from tdm_planner.exceptions import InvalidProblem, NoState
from tdm_planner.nodes.adapters.base import Adapter
from tdm_planner.nodes.adapters.vehicle import Vehicle
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.pendulum_markers import PendulumPicture, plan_markers
from tdm_planner.parameters import build
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems.base import Solution
from tdm_planner.problems.pendulum_swing_up import PendulumSwingUp
from tdm_planner.problems.swing_up_task import VEHICLE
from tdm_planner.replanning import SwingUpExecution
from tdm_planner.tracking.pendulum_tracking import PendulumTrackerParameters
from tdm_planner.trajectory import Trajectory
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

_TRAIL = 1.0  # s
_FASTEST = 30.0  # rates that a pendulum may have, in units of its natural frequency
_FORESEEN = 2000.0  # rad of swinging at the natural frequency
_TRACKED = np.array([0.5, 0.7, 6.0, 8.0])  # deviations of a pendulum that follows its plan


class PendulumAdapter(Adapter):
    """A swing-up; between plans the pendulum swings without torque."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        self._picture = PendulumPicture(RotaryPendulum(), math.pi, _TRAIL)
        parameters = PendulumTrackerParameters
        super().__init__(node, [Vehicle(node, VEHICLE, '', PENDULUM, parameters, self._picture)])
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)
        self.values_changed(values)

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Draw the rig as the parameters have it, unless they contradict each other."""
        with suppress(InvalidProblem):
            plant = build(RotaryPendulum, values, 'plant.')
            self._picture.set_up(plant, values['limits.disk_angle'], _TRAIL)

    def tracked(self, vehicle: Vehicle, plan: Trajectory) -> Array:
        """Return the largest deviations (4,) of a pendulum that follows its plan."""
        return _TRACKED

    def free(self, values: Mapping[str, Any], state: Array, duration: float) -> Array:
        """Return the state (4,) `duration` s later without torque."""
        plant = build(RotaryPendulum, values, 'plant.')
        fastest = float(_FASTEST * plant.natural_frequency)
        for joint, rate in zip(PENDULUM.joints, state[2:], strict=True):
            if not abs(rate) <= fastest:
                raise NoState(
                    f'the measured velocity of joint {joint.name} is {rate:g} rad/s: must be in '
                    f'[{-fastest:.3g}, {fastest:.3g}] rad/s to be planned from'
                )
        return _coast(plant, state, duration)

    def with_rates(self, problem: PendulumSwingUp, trajectory: Trajectory) -> Trajectory:
        """Return a planned motion with the rates of its states."""
        if trajectory.rates is not None:
            return trajectory
        return trajectory.with_rates(problem.plant.derivative)

    def draw(self, problem: PendulumSwingUp, solution: Solution) -> None:
        """Show the path of the tip."""
        self._markers.publish(plan_markers(problem.plant, solution.trajectory))

    def execution(self, problem: PendulumSwingUp) -> SwingUpExecution:
        """Return the tracker's feedback as a model."""
        return SwingUpExecution(problem, self.tracker_parameters.get(VEHICLE))


def _coast(plant: RotaryPendulum, state: Array, duration: float) -> Array:
    """State (4,) after `duration` s without torque; a negative duration looks back."""
    longest = _FORESEEN / plant.natural_frequency
    if not abs(duration) <= longest:
        raise InvalidProblem(
            f"parameters 'start.delay' and 'start.max_age' lead from a state to a motion "
            f'{duration:.3g} s later: a swinging pendulum can be foreseen for {longest:.3g} s'
        )
    no_torque = np.zeros(1)
    result = solve_ivp(
        lambda _, x: plant.derivative(x, no_torque),
        (0.0, duration),
        state,
        method='DOP853',
        rtol=1e-9,
        atol=1e-11,
    )
    last: Array = result.y[:, -1]
    return last
