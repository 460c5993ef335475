# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A formation plan as markers: arena, keep-out zones, planned paths, goals, safety circles."""

from __future__ import annotations

import colorsys

from geometry_msgs.msg import Point, Vector3
import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tdm_planner.nodes.robot_messages import ARENA_FRAME, to_quaternion
from tdm_planner.problems.base import Solution
from tdm_planner.problems.robot_formation import RobotFormation

Array = NDArray[np.float64]

_GREY = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)
_RED = ColorRGBA(r=0.8, g=0.2, b=0.2, a=0.6)
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 49)


def formation_markers(problem: RobotFormation, solution: Solution) -> MarkerArray:
    """Draw a plan; what an earlier plan drew is deleted first."""
    arena = problem.arena
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    walls = _line('arena', 0, corners * [arena.length, arena.width], _GREY, 0.02)
    markers = [_delete_all(), walls]
    for k, (x, y, radius) in enumerate(problem.task.obstacles.tolist()):
        zone = _marker('obstacles', k, Marker.CYLINDER, _RED)
        zone.scale = Vector3(x=2 * radius, y=2 * radius, z=0.05)
        zone.pose.position = Point(x=x, y=y)
        markers.append(zone)
    count = len(solution.trajectories)
    for k, trajectory in enumerate(solution.trajectories.values()):
        colour = ColorRGBA(
            **dict(zip('rgb', colorsys.hsv_to_rgb(k / count, 0.8, 0.8), strict=True)), a=1.0
        )
        path, end = trajectory.states[:, :2], trajectory.states[-1]
        markers.append(_line('planned_path', k, path[:: max(1, len(path) // 200)], colour, 0.015))
        goal = _marker('goal', k, Marker.ARROW, colour)
        goal.pose.position = Point(x=float(end[0]), y=float(end[1]))
        goal.pose.orientation = to_quaternion(float(end[4]))
        goal.scale = Vector3(x=0.3, y=0.04, z=0.04)
        ring = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
        safety = end[:2] + 0.5 * arena.minimum_separation * ring
        markers += [goal, _line('safety_circle', k, safety, colour, 0.008)]
    return MarkerArray(markers=markers)


def _delete_all() -> Marker:
    marker = Marker(action=Marker.DELETEALL)
    marker.header.frame_id = ARENA_FRAME
    marker.pose.orientation.w = 1.0
    return marker


def _marker(namespace: str, number: int, kind: int, colour: ColorRGBA) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=colour)
    marker.header.frame_id = ARENA_FRAME
    return marker


def _line(namespace: str, number: int, path: Array, colour: ColorRGBA, width: float) -> Marker:
    line = _marker(namespace, number, Marker.LINE_STRIP, colour)
    line.scale.x = width
    line.points = [Point(x=x, y=y) for x, y in path.tolist()]
    return line
