# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Plans and plants as markers for RViz and Foxglove."""

from __future__ import annotations

import math

from geometry_msgs.msg import Point, Vector3
import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tdm_planner.nodes.messages import WORLD_FRAME
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

LONGEST_PATH = 300  # points

_GREY = ColorRGBA(r=0.45, g=0.45, b=0.5, a=1.0)
_DARK = ColorRGBA(r=0.2, g=0.2, b=0.25, a=1.0)
_RED = ColorRGBA(r=0.85, g=0.2, b=0.2, a=1.0)
_BLUE = ColorRGBA(r=0.1, g=0.4, b=0.9, a=0.9)
_GREEN = ColorRGBA(r=0.1, g=0.7, b=0.3, a=0.6)


def pendulum_points(plant: RotaryPendulum, theta: Array, psi: Array) -> tuple[Array, Array]:
    """Positions of the pendulum's pivot and tip, (..., 3) m, in the world's frame.

    The origin is the disk's centre, z up, psi about z from x, theta from upright; the rod is taken
    as uniform, twice as long as its centre of mass is far.
    """
    theta, psi = np.broadcast_arrays(theta, psi)
    zero = np.zeros_like(psi)
    radial = np.stack([np.cos(psi), np.sin(psi), zero], axis=-1)
    tangent = np.stack([-np.sin(psi), np.cos(psi), zero], axis=-1)
    up = np.stack([zero, zero, zero + 1.0], axis=-1)
    pivot = plant.arm_length * radial
    rod = np.sin(theta)[..., None] * tangent + np.cos(theta)[..., None] * up
    return pivot, pivot + 2.0 * plant.com_distance * rod


def pendulum_markers(plant: RotaryPendulum, state: Array, plan: Trajectory | None) -> MarkerArray:
    """Draw the rig in a state (4,), and the planned path of the tip with its goal."""
    radius = plant.arm_length
    pivot, tip = pendulum_points(plant, state[0], state[1])
    height = 2.0 * plant.com_distance + 0.02
    base = _marker('base', Marker.CYLINDER, _DARK, Vector3(x=radius, y=radius, z=height))
    base.pose.position.z = -height / 2 - 0.01
    disk = _marker('disk', Marker.CYLINDER, _GREY, Vector3(x=2 * radius, y=2 * radius, z=0.01))
    disk.pose.orientation.z = math.sin(state[1] / 2)
    disk.pose.orientation.w = math.cos(state[1] / 2)
    above = np.array([0.0, 0.0, 0.006])
    arm = _marker('arm', Marker.LINE_LIST, _RED, Vector3(x=0.004))
    arm.points = _points(np.stack([above, pivot + above]))
    rod = _marker('rod', Marker.LINE_LIST, _RED, Vector3(x=0.008))
    rod.points = _points(np.stack([pivot, tip]))
    markers = [base, disk, arm, rod]
    if plan is not None:
        markers += _plan_markers(plant, plan)
    return MarkerArray(markers=markers)


def _plan_markers(plant: RotaryPendulum, plan: Trajectory) -> list[Marker]:
    thin = np.unique(
        np.linspace(0, plan.times.size - 1, min(LONGEST_PATH, plan.times.size)).astype(int)
    )
    _, tips = pendulum_points(plant, plan.states[thin, 0], plan.states[thin, 1])
    path = _marker('planned_path', Marker.LINE_STRIP, _BLUE, Vector3(x=0.002))
    path.points = _points(tips)
    goal = _marker('goal', Marker.SPHERE, _GREEN, Vector3(x=0.02, y=0.02, z=0.02))
    goal.pose.position = _points(tips[-1:])[0]
    return [path, goal]


def _marker(namespace: str, kind: int, colour: ColorRGBA, scale: Vector3) -> Marker:
    marker = Marker(ns=namespace, id=0, type=kind, action=Marker.ADD, color=colour, scale=scale)
    marker.header.frame_id = WORLD_FRAME
    return marker


def _points(positions: Array) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in positions.tolist()]
