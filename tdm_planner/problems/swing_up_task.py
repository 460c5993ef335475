# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""One swing-up: boundary conditions and limits as numbers, and the check a plan must pass."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from tdm_planner.verification import Constraint, Verification, verify

Array = NDArray[np.float64]

TERMINAL_TOLERANCE = np.array([1e-4, 1e-4, 1e-3, 1e-3])
_HOLD_TIME = 5e-3


@dataclass(frozen=True, eq=False)
class SwingUpTask:
    """From `start` (4,) to upright at rest, |T| <= `torque`, |psi| <= `disk_angle`.

    `torque` is what the plan may use, `torque_limit` the actuator's; `turns` the number n of
    theta = 2 pi n at the end, None for whichever is reached first.
    """

    plant: RotaryPendulum
    start: Array
    torque: float
    torque_limit: float
    disk_angle: float
    turns: int | None

    @property
    def planned_disk_angle(self) -> float:
        """Limit of |psi| while planning, a hair inside the true one."""
        return max((1.0 - 1e-5) * self.disk_angle, abs(float(self.start[1])))

    @property
    def quickest(self) -> float:
        """Time scale of the transfer [s]: how soon the torque could cover the distances alone."""
        k = self.plant.coefficients
        determinant = k.pendulum * (k.disk + k.disk_cosine) - k.arm**2
        by_torque = self.torque / determinant * np.array([k.arm, k.pendulum])
        nearest = math.remainder(float(self.start[0]), 2 * math.pi)
        if self.turns is not None:
            nearest = float(self.start[0]) - 2 * math.pi * self.turns
        distances = np.abs([nearest, self.start[1]])
        return float(
            max(np.sqrt(distances / by_torque).max(), (np.abs(self.start[2:]) / by_torque).max())
        )

    def goal(self, trajectory: Trajectory) -> Array:
        """Upright at rest, at the given number of turns or the one where the trajectory ends."""
        turns = self.turns
        if turns is None:
            turns = round(float(trajectory.states[-1, 0]) / (2 * math.pi))
        return np.array([2 * math.pi * turns, 0.0, 0.0, 0.0])

    def verify(self, trajectory: Trajectory) -> Verification:
        """Replay the trajectory and check its end and the limits on a dense grid."""
        constraints = (
            Constraint('torque', lambda t, x, u: self.torque_limit - np.abs(u[:, 0]), unit='N m'),
            Constraint(
                'disk_angle', lambda t, x, u: self.disk_angle - np.abs(x[:, 1]), unit='rad'
            ),
        )
        return verify(
            self.plant, trajectory, self.goal(trajectory), TERMINAL_TOLERANCE, constraints
        )

    def hold(self) -> Trajectory | None:
        """Return the plan that does nothing, where the start is the goal; else None."""
        nearest = self.turns
        if nearest is None:
            nearest = round(float(self.start[0]) / (2 * math.pi))
        error = self.start - np.array([2 * math.pi * nearest, 0.0, 0.0, 0.0])
        if (np.abs(error) > 0.5 * TERMINAL_TOLERANCE).any():
            return None
        times = to_nanoseconds([0.0, _HOLD_TIME])
        return self.trajectory(times, np.tile(self.start, (2, 1)), np.zeros((2, 1)))

    def trajectory(self, times: Array, states: Array, controls: Array) -> Trajectory:
        """Return a trajectory of held torques with names, units and rates."""
        plant = self.plant
        return Trajectory(
            times=times,
            states=states,
            controls=controls,
            state_names=plant.state_names,
            control_names=plant.control_names,
            state_units=plant.state_units,
            control_units=plant.control_units,
        ).with_rates(plant.derivative)
