# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Where the parts of a rotary pendulum are, and how large they are drawn.

The world's frame has its origin at the disk's centre, z up, psi about z from x. theta turns the
rod from upright towards +y of the disk, which is the sense about -x.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

Array = NDArray[np.float64]


def pendulum_points(plant: RotaryPendulum, theta: Array, psi: Array) -> tuple[Array, Array]:
    """
    Positions of the pendulum's pivot and tip, (..., 3) m, in the world's frame.

    The rod is taken as uniform, twice as long as its centre of mass is far.
    """
    theta, psi = np.broadcast_arrays(theta, psi)
    zero = np.zeros_like(psi)
    radial = np.stack([np.cos(psi), np.sin(psi), zero], axis=-1)
    tangent = np.stack([-np.sin(psi), np.cos(psi), zero], axis=-1)
    up = np.stack([zero, zero, zero + 1.0], axis=-1)
    pivot = plant.arm_length * radial
    rod = np.sin(theta)[..., None] * tangent + np.cos(theta)[..., None] * up
    return pivot, pivot + 2.0 * plant.com_distance * rod


@dataclass(frozen=True)
class RigShape:
    """
    Sizes [m] of the rig's parts, in proportion to what the plant's parameters say of them.

    `disk_radius` and `rod_length` follow from the parameters; the others only have to look right.
    """

    disk_radius: float
    disk_thickness: float
    rod_length: float
    rod_radius: float
    base_radius: float
    base_height: float

    @classmethod
    def of(cls, plant: RotaryPendulum) -> RigShape:
        """Return the shape of a pendulum's rig; the base is as high as the hanging rod needs."""
        radius, rod = plant.arm_length, 2.0 * plant.com_distance
        return cls(
            disk_radius=radius,
            disk_thickness=0.12 * radius,
            rod_length=rod,
            rod_radius=0.035 * rod,
            base_radius=0.5 * radius,
            base_height=1.15 * rod,
        )

    def tip(self, theta: float, psi: float) -> tuple[float, float, float]:
        """Position of the rod's tip [m]; `pendulum_points` for one pair of numbers, quicker."""
        cosine, sine = math.cos(psi), math.sin(psi)
        across = self.rod_length * math.sin(theta)
        return (
            self.disk_radius * cosine - across * sine,
            self.disk_radius * sine + across * cosine,
            self.rod_length * math.cos(theta),
        )
