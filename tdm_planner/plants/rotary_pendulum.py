# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The rotary (Furuta) pendulum: equations of motion, derivatives, energy; its URDF.

theta is the pendulum's angle from UPRIGHT, psi the disk's (arm's), both positive about their axes
as in section 4.1 of Yakimenko (2006). With m the pendulum's mass, l the distance from its pivot to
its centre of mass, r the arm's length, I_d the disk's inertia about the vertical and I_x, I_y, I_z
the pendulum's about its centre of mass (y along the rod, z the pivot's axis), d_1 and d_2 the
damping of pivot and disk,

    A = I_z + m l^2,  c = I_x - I_y + m l^2,  B = m l r cos(theta),
    J = I_d + m r^2 + (I_x + m l^2) sin(theta)^2 + I_y cos(theta)^2,

    A theta'' + B psi'' = r_1 = (c/2) sin(2 theta) psi'^2 + m g l sin(theta) - d_1 theta'
    B theta'' + J psi'' = r_2 = T - c sin(2 theta) theta' psi' + m l r sin(theta) theta'^2
                                - d_2 psi'.

These are equations (6)-(7) of the paper, which has no damping, with their misprints mended; the
same form follows from Cazzolato and Prime, "On the Dynamics of the Furuta Pendulum" (2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from string import Template
from typing import Any, ClassVar, NamedTuple

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import config_file
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, positive, Validated
from tdm_planner.plants.base import SymbolicPlant

# Below this share of A J the mass matrix's determinant is lost in rounding.
_SMALLEST_DETERMINANT = 1e-9
_MOST_ACROSS = 100.0  # times the inertia upright that steps account for
_SOON = 0.25  # times the rate at which damping stops a motion, over w0: as many more steps
_MOST_QUICK = 32.0  # times the usual steps; with more of them no plan would be in time


class Coefficients(NamedTuple):
    """
    The nine lumped constants in which the equations of motion are linear.

    `coupling` is c [kg m^2], `pendulum` A, `disk` I_d + m r^2, `disk_sine` I_x + m l^2,
    `disk_cosine` I_y, `arm` m l r [all kg m^2], `gravity` m g l [N m], `pivot_damping` d_1 and
    `disk_damping` d_2 [N m s].
    """

    coupling: float
    pendulum: float
    disk: float
    disk_sine: float
    disk_cosine: float
    arm: float
    gravity: float
    pivot_damping: float
    disk_damping: float


def mechanics(
    k: Coefficients, theta: Any, theta_dot: Any, psi_dot: Any
) -> tuple[Any, Any, Any, Any]:
    """Return B, J, r_1 and r_2 - T; the arguments may be numbers, arrays or symbols alike."""
    sine, cosine = np.sin(theta), np.cos(theta)
    turning = k.coupling * sine * cosine * psi_dot
    return (
        k.arm * cosine,
        k.disk + k.disk_sine * sine * sine + k.disk_cosine * cosine * cosine,
        turning * psi_dot + k.gravity * sine - k.pivot_damping * theta_dot,
        (k.arm * sine * theta_dot - 2.0 * turning) * theta_dot - k.disk_damping * psi_dot,
    )


def accelerations(
    k: Coefficients, theta: Any, theta_dot: Any, psi_dot: Any, torque: Any
) -> tuple[Any, Any]:
    """Return theta'' and psi'' under a torque, for arguments of any kind."""
    return accelerations_by(k, theta, theta_dot, psi_dot, 0.0, torque)


def accelerations_by(
    k: Coefficients, theta: Any, theta_dot: Any, psi_dot: Any, moment: Any, torque: Any
) -> tuple[Any, Any]:
    """Return theta'' and psi'' under a moment about the pivot and a torque."""
    b, j, r1, r2 = mechanics(k, theta, theta_dot, psi_dot)
    r1, r2, inverse = r1 + moment, r2 + torque, 1.0 / (k.pendulum * j - b * b)
    return (j * r1 - b * r2) * inverse, (k.pendulum * r2 - b * r1) * inverse


def runge_kutta(
    k: Coefficients, theta: Any, theta_dot: Any, psi_dot: Any, torque: Any, h: Any
) -> tuple[Any, ...]:
    """Return theta, the change of psi, theta' and psi' after one classical step of `h` s."""
    begin, slopes = (theta, 0.0, theta_dot, psi_dot), [(0.0,) * 4]
    for share in (0.0, 0.5, 0.5, 1.0):
        x = [value + share * h * slope for value, slope in zip(begin, slopes[-1], strict=True)]
        slopes.append((x[2], x[3], *accelerations(k, x[0], x[2], x[3], torque)))
    stages = zip(begin, *slopes[1:], strict=True)
    return tuple(x + h / 6.0 * (a + 2.0 * (b + c) + d) for x, a, b, c, d in stages)


def driven(
    k: Coefficients, theta: Any, theta_dot: Any, psi_dot: Any, psi_ddot: Any
) -> tuple[Any, Any]:
    """Return theta'' and the torque at which the disk has psi'', for arguments of any kind."""
    b, j, r1, r2 = mechanics(k, theta, theta_dot, psi_dot)
    theta_ddot = (r1 - b * psi_ddot) / k.pendulum
    return theta_ddot, b * theta_ddot + j * psi_ddot - r2


@dataclass(frozen=True)
class PendulumLimits(Validated):
    """Limits of motor and rig."""

    torque: float = positive(0.02, "largest torque of the disk's motor, either way", 'N m')
    disk_angle: float = positive(2.0, 'largest angle of the disk, either way', 'rad')


@dataclass(frozen=True)
class PendulumInertia(Validated):
    """Moments of inertia."""

    disk: float = positive(
        2.334e-4, 'moment of inertia of disk, arm and motor about the vertical', 'kg m^2'
    )
    x: float = positive(
        3.3282e-5,
        "pendulum's moment of inertia about its centre of mass, axis across rod and pivot",
        'kg m^2',
    )
    y: float = positive(
        2.7e-7,
        "pendulum's moment of inertia about its centre of mass, axis along the rod",
        'kg m^2',
    )
    z: float = positive(
        3.3282e-5,
        "pendulum's moment of inertia about its centre of mass, axis of the pivot",
        'kg m^2',
    )


@dataclass(frozen=True)
class PendulumDamping(Validated):
    """Torques against the motion that grow with the speed: of bearings, and of a back e.m.f."""

    pivot: float = parameter(
        0.0, "damping of the pendulum's pivot", unit='N m s', allowed=NON_NEGATIVE
    )
    disk: float = parameter(
        0.0, "damping of the disk's axis and motor", unit='N m s', allowed=NON_NEGATIVE
    )


@dataclass(frozen=True)
class RotaryPendulum(Validated, SymbolicPlant):
    """
    A pendulum on the rim of a driven disk; the defaults are those of a Quanser QUBE-Servo 2.

    Raise InvalidProblem for a parameter that is not allowed, or values whose equations of motion
    are singular.
    """

    mass: float = positive(0.024, "pendulum's mass", 'kg')
    com_distance: float = positive(
        0.0645, "distance from the pivot to the pendulum's centre of mass", 'm'
    )
    arm_length: float = positive(
        0.085, "distance from the disk's axis to the pendulum's pivot", 'm'
    )
    gravity: float = positive(9.81, 'acceleration due to gravity', 'm/s^2')
    inertia: PendulumInertia = group(PendulumInertia)
    damping: PendulumDamping = group(PendulumDamping)

    state_names: ClassVar[tuple[str, ...]] = ('theta', 'psi', 'theta_dot', 'psi_dot')
    state_units: ClassVar[tuple[str, ...]] = ('rad', 'rad', 'rad/s', 'rad/s')
    control_names: ClassVar[tuple[str, ...]] = ('torque',)
    control_units: ClassVar[tuple[str, ...]] = ('N m',)

    def __post_init__(self) -> None:
        """Check the values, alone and together."""
        super().__post_init__()
        k = self.coefficients
        scale = k.pendulum * (k.disk + k.disk_cosine)
        determinant = self.determinant
        usable = 1e-200 < scale < 1e200 and 1e-100 < k.gravity < 1e100
        if not (usable and determinant > _SMALLEST_DETERMINANT * scale):
            raise InvalidProblem(
                "parameters 'plant.*' do not make a rig that can be computed: with mass "
                f'{self.mass:g} kg, com_distance {self.com_distance:g} m and arm_length '
                f'{self.arm_length:g} m the inertias must be neither negligible nor excessive'
            )

        most = _MOST_QUICK / _SOON * self.natural_frequency
        if self._stopping > most:
            raise InvalidProblem(
                f"parameters 'plant.damping.*' stop a motion within {1.0 / self._stopping:.3g} s: "
                f'must leave it {1.0 / most:.3g} s or more'
            )

    @cached_property
    def coefficients(self) -> Coefficients:
        """Lumped constants of the equations of motion."""
        first_moment = self.mass * self.com_distance
        second_moment = first_moment * self.com_distance
        return Coefficients(
            coupling=self.inertia.x - self.inertia.y + second_moment,
            pendulum=self.inertia.z + second_moment,
            disk=self.inertia.disk + self.mass * self.arm_length**2,
            disk_sine=self.inertia.x + second_moment,
            disk_cosine=self.inertia.y,
            arm=first_moment * self.arm_length,
            gravity=first_moment * self.gravity,
            pivot_damping=self.damping.pivot,
            disk_damping=self.damping.disk,
        )

    @property
    def natural_frequency(self) -> float:
        """Return the angular frequency of small swings about hanging, disk held, w0 [rad/s]."""
        return math.sqrt(self.coefficients.gravity / self.coefficients.pendulum)

    @property
    def determinant(self) -> float:
        """Return the determinant of the mass matrix upright or hanging [kg^2 m^4], its least."""
        k = self.coefficients
        return k.pendulum * (k.disk + k.disk_cosine) - k.arm**2

    @property
    def quickness(self) -> float:
        """
        How many times as many steps as usual quick motions take; 1 to 32.

        A light disk turns with the pendulum. Where that has most of the inertia it does so within
        a small angle about upright and hanging. Strong damping stops a motion soon.
        """
        k = self.coefficients
        scale = self.determinant + k.arm**2
        across = (k.disk_sine - k.disk_cosine) / (k.disk + k.disk_cosine)
        across = min(max(across, 1.0), _MOST_ACROSS)
        quick = 0.5 * math.sqrt(across * scale / self.determinant)
        stopped = _SOON * self._stopping / self.natural_frequency
        return min(max(1.0, quick, stopped), _MOST_QUICK)

    @property
    def loss(self) -> float:
        """Share of the energy that damping of the pivot takes in half a small swing."""
        k = self.coefficients
        return -math.expm1(-math.pi * k.pivot_damping / k.pendulum / self.natural_frequency)

    @property
    def _stopping(self) -> float:
        """Return the rate at which damping takes speed away with the pendulum upright [1/s]."""
        k = self.coefficients
        stops = k.pivot_damping * (k.disk + k.disk_cosine) + k.disk_damping * k.pendulum
        return stops / self.determinant

    def disk_acceleration(self, torque: float) -> float:
        """Acceleration that a torque gives the disk with the pendulum upright [rad/s^2]."""
        return torque * self.coefficients.pendulum / self.determinant

    def drive(self, torque: float) -> float:
        """Acceleration of the pendulum by a torque over that by gravity: weak below 1."""
        k = self.coefficients
        return torque * k.arm / ((k.disk + k.disk_cosine) * k.gravity)

    @staticmethod
    def equations(
        k: Coefficients, state: Sequence[Any], control: Sequence[Any]
    ) -> tuple[Any, ...]:
        """Return the rates of the states; the arguments may hold numbers, arrays or symbols."""
        theta, _, theta_dot, psi_dot = state
        return (theta_dot, psi_dot, *accelerations(k, theta, theta_dot, psi_dot, *control))

    def energy(self, state: Array) -> Array:
        """Kinetic and potential energy [J], m g l at rest upright: (..., 4) -> (...)."""
        k = self.coefficients
        theta, theta_dot, psi_dot = state[..., 0], state[..., 2], state[..., 3]
        b, j, _, _ = mechanics(k, theta, theta_dot, psi_dot)
        kinetic = 0.5 * k.pendulum * theta_dot**2 + b * theta_dot * psi_dot + 0.5 * j * psi_dot**2
        total: Array = kinetic + k.gravity * np.cos(theta)
        return total


def pendulum_urdf(plant: RotaryPendulum) -> str:
    """
    Return a pendulum's URDF for RViz and others: its masses, inertias, lengths and damping.

    Links `world` (fixed), `base`, `disk`, `rod`; continuous joints `disk`, about z, and
    `pendulum`, about -x of the disk, on the disk's rim. The plant does not know the disk's mass,
    which has no influence on the motion: the disk is a uniform one of its moment of inertia.
    """
    of, radius, rod_length = plant.inertia, plant.arm_length, 2.0 * plant.com_distance
    thick, high = 0.12 * radius, 1.15 * rod_length  # of the disk; of the base, for the rod to hang
    numbers = {
        'base_height': -0.5 * (thick + high),
        'base_radius': 0.5 * radius,
        'base_length': high,
        'disk_length': thick,
        'disk_mass': 2.0 * of.disk / radius**2,
        'disk_inertia': of.disk,
        'half_disk_inertia': 0.5 * of.disk,
        'arm_length': radius,
        'mass': plant.mass,
        'com_distance': plant.com_distance,
        # The plant's axes are x across, y along the rod, z the pivot's; the link's are pivot,
        # across, along.
        'inertia_x': of.z,
        'inertia_y': of.x,
        'inertia_z': of.y,
        'rod_radius': 0.035 * rod_length,
        'rod_length': rod_length,
        'disk_damping': plant.damping.disk,
        'pivot_damping': plant.damping.pivot,
    }
    template = config_file('pendulum.urdf.template').read_text(encoding='utf-8')
    return Template(template).substitute(numbers)
