# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The rotary pendulum as a URDF, for RViz's RobotModel and joint_state tools."""

from __future__ import annotations

from string import Template

from tdm_planner.parameter_files import config_file
from tdm_planner.plants.rotary_pendulum import RotaryPendulum


def pendulum_urdf(plant: RotaryPendulum) -> str:
    """
    Return the URDF of a pendulum, with the plant's masses, inertias, lengths and damping.

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
