# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The rotary pendulum as a URDF, for RViz's RobotModel and joint_state tools."""

from __future__ import annotations

from xml.etree import ElementTree

from tdm_planner.plants.rotary_pendulum import RotaryPendulum

_HEAD = """<?xml version="1.0"?>
<!-- Written by `make config` for the plant's default parameters; the plant node publishes its own
     on robot_description. Joint positions are the states: disk = psi, pendulum = theta, both zero
     with the pendulum upright above +x. -->
"""
_COLOURS = {
    'dark': '0.25 0.25 0.3 1',
    'grey': '0.5 0.5 0.52 1',
    'red': '0.85 0.2 0.2 1',
}


def pendulum_urdf(plant: RotaryPendulum) -> str:
    """
    Return the URDF of a pendulum, with the plant's masses, inertias and lengths.

    Links `world` (fixed), `base`, `disk`, `rod`; continuous joints `disk`, about z, and
    `pendulum`, about -x of the disk, on the disk's rim. The plant does not know the disk's mass,
    which has no influence on the motion: the disk is a uniform one of its moment of inertia.
    """
    inertia, radius, rod_length = plant.inertia, plant.arm_length, 2.0 * plant.com_distance
    thick, high = 0.12 * radius, 1.15 * rod_length  # of the disk; of the base, for the rod to hang
    robot = ElementTree.Element('robot', name='rotary_pendulum')
    for name, rgba in _COLOURS.items():
        ElementTree.SubElement(
            ElementTree.SubElement(robot, 'material', name=name), 'color', rgba=rgba
        )
    ElementTree.SubElement(robot, 'link', name='world')
    base = _link(robot, 'base')
    _cylinder(base, 'dark', 0.5 * radius, high, -0.5 * (thick + high))
    disk = _link(robot, 'disk')
    mass = 2.0 * inertia.disk / radius**2
    _inertial(disk, mass, 0.0, (0.5 * inertia.disk, 0.5 * inertia.disk, inertia.disk))
    _cylinder(disk, 'grey', radius, thick, 0.0)
    rod = _link(robot, 'rod')
    # The plant's axes are x across, y along the rod, z the pivot's; the link's are pivot, across,
    # along.
    moments = (inertia.z, inertia.x, inertia.y)
    _inertial(rod, plant.mass, plant.com_distance, moments)
    _cylinder(rod, 'red', 0.035 * rod_length, rod_length, 0.5 * rod_length)
    _joint(robot, 'base', 'fixed', 'world', 'base')
    _joint(robot, 'disk', 'continuous', 'base', 'disk', axis='0 0 1')
    rim = f'{radius!r} 0 0'
    _joint(robot, 'pendulum', 'continuous', 'disk', 'rod', origin=rim, axis='-1 0 0')
    ElementTree.indent(robot)
    return _HEAD + ElementTree.tostring(robot, encoding='unicode') + '\n'


def _link(robot: ElementTree.Element, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(robot, 'link', name=name)


def _inertial(
    link: ElementTree.Element, mass: float, height: float, moments: tuple[float, float, float]
) -> None:
    inertial = ElementTree.SubElement(link, 'inertial')
    ElementTree.SubElement(inertial, 'origin', xyz=f'0 0 {height!r}', rpy='0 0 0')
    ElementTree.SubElement(inertial, 'mass', value=repr(mass))
    values = dict(zip(('ixx', 'iyy', 'izz'), map(repr, moments), strict=True))
    ElementTree.SubElement(inertial, 'inertia', values, ixy='0', ixz='0', iyz='0')


def _cylinder(
    link: ElementTree.Element, material: str, radius: float, length: float, height: float
) -> None:
    visual = ElementTree.SubElement(link, 'visual')
    ElementTree.SubElement(visual, 'origin', xyz=f'0 0 {height:.6g}', rpy='0 0 0')
    geometry = ElementTree.SubElement(visual, 'geometry')
    ElementTree.SubElement(geometry, 'cylinder', radius=f'{radius:.6g}', length=f'{length:.6g}')
    ElementTree.SubElement(visual, 'material', name=material)


def _joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    origin: str = '0 0 0',
    axis: str = '',
) -> None:
    joint = ElementTree.SubElement(robot, 'joint', name=name, type=kind)
    ElementTree.SubElement(joint, 'origin', xyz=origin, rpy='0 0 0')
    ElementTree.SubElement(joint, 'parent', link=parent)
    ElementTree.SubElement(joint, 'child', link=child)
    if axis:
        ElementTree.SubElement(joint, 'axis', xyz=axis)
