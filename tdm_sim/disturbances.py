# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Disturbances of a simulated plant: measurement noise, lost commands, pushes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import mechanics, RotaryPendulum

Array = NDArray[np.float64]


class Disturbances:
    """The random part of a simulated plant, reproducible: one seed, one sequence of draws."""

    def __init__(self, seed: int = 0) -> None:
        # Independent streams: draws from one must not change the other.
        self._noise, self._loss, self._direction = (
            np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)
        )

    def measured(self, state: Array, deviation: Array) -> Array:
        """`state` (nx,) with white Gaussian noise of standard `deviation` (nx,)."""
        return state + deviation * self._noise.standard_normal(state.shape)

    def loses_command(self, probability: float) -> bool:
        """Whether the command that has just arrived is lost."""
        return bool(self._loss.random() < probability)

    def direction(self) -> float:
        """Return an angle [rad], all directions being equally likely."""
        return float(self._direction.uniform(-math.pi, math.pi))


def pendulum_push(plant: RotaryPendulum, state: Array, impulse: float) -> Array:
    """
    State (4,) after an impulse [N m s] about the pendulum's pivot; the disk is free to react.

    The generalized momentum of theta, A theta' + B psi', jumps by `impulse`, that of psi,
    B theta' + J psi', does not.
    """
    k, (theta, _, theta_dot, psi_dot) = plant.coefficients, state
    b, j, _, _ = mechanics(k, theta, theta_dot, psi_dot)
    determinant = k.pendulum * j - b**2
    pushed: Array = state + impulse / determinant * np.array([0.0, 0.0, j, -b])
    return pushed


def robot_push(plant: FloatingRobot, state: Array, impulse: float, direction: float) -> Array:
    """
    State (nx,) after an impulse [N s] at the robot's centre of mass.

    `direction` [rad] is an angle in the arena's frame; the state begins with x, y, u, v.
    """
    pushed = state.copy()
    pushed[2] += impulse / plant.mass * math.cos(direction)
    pushed[3] += impulse / plant.mass * math.sin(direction)
    return pushed
