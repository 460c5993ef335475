# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One manoeuvre into formation as arrays: boundary conditions, limits, arena, weights of (28)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.floating_robot import FloatingRobot

Array = NDArray[np.float64]

# Planned distances exceed the required ones by this share, for what happens between instants.
_NUMERICAL_RESERVE = 0.01
# Robots nearer than this to their goal, and slower, have arrived already.
_ARRIVED = 1e-4


@dataclass(frozen=True, eq=False)
class FormationTask:
    """
    The manoeuvre of n robots; positions in the arena's frame, [0, length] x [0, width].

    `start`, `velocity`, `acceleration`, `goal` (n, 2); `yaw`, `yaw_rate`, `yaw_acceleration`,
    `goal_yaw` (n,), the goal's on the turn that is to be made; `alpha` (n,) the angle of the
    thruster at the start, NaN where it is free; `coast` (n,) s the time every robot waits with
    its thrust off before its manoeuvre, while the thruster turns. Robots arrive at rest.

    `thrust` [m/s^2] and `torque` [rad/s^2] are the limits of (17), per mass and inertia, and
    `thruster_rate` [rad/s] the third. `obstacles` (m, 3) holds x, y, radius. `interval` is Delta_t
    of (28), `weights` w, `longest` the latest arrival considered [s]. `arrived` (n,) s is the time
    since which a robot that stays has been at its goal: the others keep their intervals to that.
    """

    names: tuple[str, ...]
    plant: FloatingRobot
    start: Array
    velocity: Array
    acceleration: Array
    yaw: Array
    yaw_rate: Array
    yaw_acceleration: Array
    alpha: Array
    goal: Array
    goal_yaw: Array
    thrust: float
    torque: float
    thruster_rate: float
    length: float
    width: float
    separation: float
    margin: float
    obstacles: Array
    interval: float
    weights: Array
    longest: float
    coast: Array
    arrived: Array

    @property
    def n(self) -> int:
        """Return the number of robots."""
        return len(self.names)

    @property
    def sides(self) -> Array:
        """Length and width of the arena (2,)."""
        return np.array([self.length, self.width])

    @property
    def staying(self) -> NDArray[np.bool_]:
        """Robots that are at their goal, at rest, and so only turn (n,)."""
        still = np.linalg.norm(self.velocity, axis=1) < _ARRIVED
        return np.asarray(still & (np.linalg.norm(self.goal - self.start, axis=1) < _ARRIVED))

    @property
    def departure(self) -> Array:
        """Positions when the manoeuvres begin, after coasting (n, 2)."""
        return self.start + self.velocity * self.coast[:, None]

    @property
    def departure_yaw(self) -> Array:
        """Attitudes when the manoeuvres begin, after coasting (n,)."""
        return self.yaw + self.yaw_rate * self.coast

    def with_coast(self, coast: Array) -> FormationTask:
        """Return the same manoeuvre after coasting for `coast` (n,) s."""
        return replace(self, coast=coast)

    def wanted_clearance(self, required: Array | float, ends: Array) -> Array:
        """
        Distances to plan for where `required` ones must be kept.

        The reserves are added, but no more than the distances at both `ends` allow.
        """
        wanted = (1.0 + _NUMERICAL_RESERVE) * np.asarray(required) + self.margin
        return np.asarray(np.maximum(np.minimum(wanted, 0.999 * ends), required))

    def pair_clearances(self, i: NDArray[np.intp], j: NDArray[np.intp]) -> Array:
        """Distances to plan for between robots i and j."""
        at_start = np.linalg.norm(self.start[i] - self.start[j], axis=1)
        at_goal = np.linalg.norm(self.goal[i] - self.goal[j], axis=1)
        return self.wanted_clearance(self.separation, np.minimum(at_start, at_goal))

    def wall_clearances(self) -> Array:
        """Distances of the centres from the walls to plan for (n, 2, 2): [robot, axis, side]."""
        low = np.minimum(self.start, self.goal)
        high = self.sides - np.maximum(self.start, self.goal)
        ends = np.stack([low, high], axis=-1)
        half = np.full_like(ends, self.separation / 2)
        wanted = (1.0 + _NUMERICAL_RESERVE) * half + self.margin / 2
        return np.asarray(np.maximum(np.minimum(wanted, ends), half))

    def circles(self) -> tuple[Array, Array]:
        """
        Centres (m, 2) of what stands still, and distances to plan for (n, m), 0 for oneself.

        These are the keep-out zones, from whose edge half a separation is kept as from the walls,
        and the robots that stay.
        """
        staying = np.flatnonzero(self.staying)
        centres = np.concatenate([self.obstacles[:, :2], self.start[staying]])
        required = np.concatenate(
            [
                self.obstacles[:, 2] + self.separation / 2,
                np.full(staying.size, self.separation),
            ]
        )
        ends = np.minimum(
            np.linalg.norm(self.start[:, None] - centres, axis=2),
            np.linalg.norm(self.goal[:, None] - centres, axis=2),
        )
        wanted = self.wanted_clearance(np.broadcast_to(required, ends.shape), ends)
        wanted[staying] = 0.0
        return centres, wanted

    def cost_terms(self, arrivals: Array, gas: Array) -> dict[str, float]:
        """Return the weighted terms of (28): arrival times (n,) s, gas (n,) m/s."""
        time, sequence, gas_weight = self.weights
        arrivals = arrivals - self.arrived
        late = np.abs(np.diff(arrivals) - self.interval).sum()
        return {
            'time': float(time * arrivals[0]),
            'sequence': float(sequence * late),
            'gas': float(gas_weight * gas.sum()),
        }
