# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The floating robot of section 4.2: a thruster that can be turned, and a reaction wheel.

With x, y the position in the arena, u, v the velocity, yaw the attitude (psi of the paper), omega
its rate and alpha the angle of the thrust from the robot's front, equation (17) of Yakimenko
(2006) reads, for a robot of mass m and inertia I,

    x' = u,  y' = v,  u' = (thrust / m) cos(yaw + alpha),  v' = (thrust / m) sin(yaw + alpha),
    yaw' = omega,  omega' = torque / I,  alpha' = thruster_rate.

The torque is that of the wheel's motor on the robot; the wheel takes up its angular momentum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.parameters import positive, Validated
from tdm_planner.plants.base import SymbolicPlant


class RobotInertia(NamedTuple):
    """Mass [kg] and moment of inertia [kg m^2] of a robot."""

    mass: float
    inertia: float


@dataclass(frozen=True)
class RobotLimits(Validated):
    """Limits of the actuators, the same for all robots."""

    thrust: float = positive(1.05, 'largest thrust; F_max is this per mass', 'N')
    torque: float = positive(
        0.02, "largest torque of the wheel's motor, either way; T_max is this per inertia", 'N m'
    )
    thruster_rate: float = positive(
        2.0, 'largest rate at which the thruster turns, either way', 'rad/s'
    )


@dataclass(frozen=True)
class FloatingRobot(Validated, SymbolicPlant):
    """A robot that floats without friction on a flat arena."""

    mass: float = positive(10.5, "robot's mass", 'kg')
    inertia: float = positive(0.063, "robot's moment of inertia about the vertical", 'kg m^2')
    wheel_inertia: float = positive(
        0.001, "reaction wheel's moment of inertia about its axis", 'kg m^2'
    )

    state_names: ClassVar[tuple[str, ...]] = ('x', 'y', 'u', 'v', 'yaw', 'omega', 'alpha')
    state_units: ClassVar[tuple[str, ...]] = ('m', 'm', 'm/s', 'm/s', 'rad', 'rad/s', 'rad')
    control_names: ClassVar[tuple[str, ...]] = ('thrust', 'thruster_rate', 'torque')
    control_units: ClassVar[tuple[str, ...]] = ('N', 'rad/s', 'N m')

    @property
    def coefficients(self) -> RobotInertia:
        """Constants of the equations of motion."""
        return RobotInertia(self.mass, self.inertia)

    @staticmethod
    def equations(
        k: RobotInertia, state: Sequence[Any], control: Sequence[Any]
    ) -> tuple[Any, ...]:
        """Return the rates of the states; the arguments may hold numbers, arrays or symbols."""
        _, _, u, v, yaw, omega, alpha = state
        thrust, rate, torque = control
        push, heading = thrust / k.mass, yaw + alpha
        along, across = push * np.cos(heading), push * np.sin(heading)
        return u, v, along, across, omega, torque / k.inertia, rate

    def wheel_speed(self, omega: Array) -> Array:
        """
        Speed that the wheel gains relative to the robot as the yaw rate gains `omega` [rad/s].

        The angular momentum of both together is conserved.
        """
        return np.asarray(-(1.0 + self.inertia / self.wheel_inertia) * np.asarray(omega))
