# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The floating robot with its reaction wheel, and the walls it may bounce off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.floating_robot import FloatingRobot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WheeledRobot:
    """
    The floating robot's seven states, then angle and speed of the wheel relative to the robot.

    The wheel follows from the conservation of angular momentum; it does not act back on the
    robot's motion beyond the torque commanded.
    """

    robot: FloatingRobot

    state_names: ClassVar[tuple[str, ...]] = (
        *FloatingRobot.state_names,
        'wheel_angle',
        'wheel_speed',
    )
    state_units: ClassVar[tuple[str, ...]] = (*FloatingRobot.state_units, 'rad', 'rad/s')
    control_names: ClassVar[tuple[str, ...]] = FloatingRobot.control_names
    control_units: ClassVar[tuple[str, ...]] = FloatingRobot.control_units

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (..., 9), (..., 3) -> (..., 9)."""
        motion = self.robot.derivative(state[..., :7], control)
        # The wheel's speed is linear in the yaw rate, so its derivative is in omega'.
        wheel = np.stack([state[..., 8], self.robot.wheel_speed(motion[..., 5])], axis=-1)
        return np.concatenate([motion, wheel], axis=-1)


@dataclass(frozen=True)
class Walls:
    """
    Walls of the arena [0, length] x [0, width], off which a disk of `radius` bounces.

    The contact is elastic and without friction. `on_collision` is called at every bounce, with
    the axis and the speed of the impact [m/s].
    """

    length: float
    width: float
    radius: float
    on_collision: Callable[[str, float], None]

    def __call__(self, state: Array) -> Array:
        """Return the state (nx,) after a contact, or as it is."""
        for axis, (name, side) in enumerate((('x', self.length), ('y', self.width))):
            position, speed = float(state[axis]), float(state[2 + axis])
            nearest = min(max(position, self.radius), side - self.radius)
            if (position - nearest) * speed > 0.0:
                state = state.copy()
                # Mirror the part of the motion that went through the wall.
                state[axis] = 2.0 * nearest - position
                state[2 + axis] = -speed
                self.on_collision(name, abs(speed))
        return state
