# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The rotary pendulum as a URDF, for RViz's RobotModel and joint_state tools."""

from __future__ import annotations

from tdm_planner.plants.rotary_pendulum import RotaryPendulum


def pendulum_urdf(plant: RotaryPendulum) -> str:
    """
    Return the URDF of a pendulum, with the plant's masses, inertias and lengths.

    Links `world` (fixed), `base`, `disk`, `rod`; continuous joints `disk`, about z, and
    `pendulum`, about -x of the disk, on the disk's rim. The plant does not know the disk's mass,
    which has no influence on the motion: the disk is a uniform one of its moment of inertia.
    """
    of, radius, rod_length = plant.inertia, plant.arm_length, 2.0 * plant.com_distance
    thick, high = 0.12 * radius, 1.15 * rod_length  # of the disk; of the base, for the rod to hang
    half = 0.5 * of.disk
    disk = _inertial(2.0 * of.disk / radius**2, 0.0, (half, half, of.disk))
    # The plant's axes are x across, y along the rod, z the pivot's; the link's are pivot, across,
    # along.
    rod = _inertial(plant.mass, plant.com_distance, (of.z, of.x, of.y))
    return f"""<?xml version="1.0"?>
<!-- Written by `make config` for the plant's default parameters; the plant node publishes its own
     on robot_description. Joint positions are the states: disk = psi, pendulum = theta, both zero
     with the pendulum upright above +x. -->
<robot name="rotary_pendulum">
  <material name="dark">
    <color rgba="0.25 0.25 0.3 1" />
  </material>
  <material name="grey">
    <color rgba="0.5 0.5 0.52 1" />
  </material>
  <material name="red">
    <color rgba="0.85 0.2 0.2 1" />
  </material>
  <link name="world" />
  <link name="base">{_cylinder('dark', 0.5 * radius, high, -0.5 * (thick + high))}
  </link>
  <link name="disk">{disk}{_cylinder('grey', radius, thick, 0.0)}
  </link>
  <link name="rod">{rod}{_cylinder('red', 0.035 * rod_length, rod_length, 0.5 * rod_length)}
  </link>
  <joint name="base" type="fixed">
    <origin xyz="0 0 0" rpy="0 0 0" />
    <parent link="world" />
    <child link="base" />
  </joint>
  <joint name="disk" type="continuous">
    <origin xyz="0 0 0" rpy="0 0 0" />
    <parent link="base" />
    <child link="disk" />
    <axis xyz="0 0 1" />
  </joint>
  <joint name="pendulum" type="continuous">
    <origin xyz="{radius!r} 0 0" rpy="0 0 0" />
    <parent link="disk" />
    <child link="rod" />
    <axis xyz="-1 0 0" />
  </joint>
</robot>
"""


def _inertial(mass: float, height: float, moments: tuple[float, float, float]) -> str:
    x, y, z = moments
    return f"""
    <inertial>
      <origin xyz="0 0 {height!r}" rpy="0 0 0" />
      <mass value="{mass!r}" />
      <inertia ixx="{x!r}" iyy="{y!r}" izz="{z!r}" ixy="0" ixz="0" iyz="0" />
    </inertial>"""


def _cylinder(material: str, radius: float, length: float, height: float) -> str:
    return f"""
    <visual>
      <origin xyz="0 0 {height:.6g}" rpy="0 0 0" />
      <geometry>
        <cylinder radius="{radius:.6g}" length="{length:.6g}" />
      </geometry>
      <material name="{material}" />
    </visual>"""
