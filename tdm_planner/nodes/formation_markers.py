# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Arena, goals and planned paths of a formation as markers in the frame `arena`."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from tdm_planner.nodes.markers import colour_of, GREY, Pen, points_of, to_quaternion
from tdm_planner.plant_kind import ARENA_FRAME
from tdm_planner.problems.formation_parameters import Arena
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]

LONGEST_PATH = 200  # points

_ZONE = ColorRGBA(r=0.8, g=0.2, b=0.2, a=0.6)
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 49)
_NO_PATHS: Mapping[str, Array] = MappingProxyType({})


def formation_markers(
    arena: Arena, goals: Mapping[str, Array], paths: Mapping[str, Array] = _NO_PATHS
) -> MarkerArray:
    """
    Draw set-up and plan; what an earlier message drew is deleted first.

    `goals` holds x, y, yaw (3,) [m, rad] and `paths` x, y (n, 2) [m] by robot. Namespaces:
    `arena`, the walls; `obstacles`, the keep-out zones; and, numbered by robot, `goal`, an arrow;
    `safety_circle` of half the minimum separation around it; `planned_path`.
    """
    pen = Pen(ARENA_FRAME)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    walls = points_of(corners * [arena.length, arena.width])
    markers = [pen.delete_all(), pen.line('arena', 0, walls, GREY, 0.02)]
    zones = arena.obstacles[: len(arena.obstacles) // 3 * 3]
    for k, (x, y, radius) in enumerate(np.reshape(zones, (-1, 3)).tolist()):
        size = (2 * radius, 2 * radius, 0.05)
        if radius > 0:
            markers.append(pen.solid('obstacles', k, Marker.CYLINDER, _ZONE, size, (x, y)))
    ring = 0.5 * arena.minimum_separation * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
    arrow = arena.minimum_separation * np.array([0.5, 0.08, 0.08])
    for k, (name, goal) in enumerate(goals.items()):
        x, y, yaw = goal.tolist()
        colour = colour_of(name)
        turned = to_quaternion(yaw)
        markers += [
            pen.solid('goal', k, Marker.ARROW, colour, arrow.tolist(), (x, y), turned),
            pen.line('safety_circle', k, points_of(goal[:2] + ring), colour, 0.008),
        ]
        if name in paths:
            path = points_of(_thinned(paths[name]))
            markers.append(pen.line('planned_path', k, path, colour_of(name, 0.8), 0.015))
    return MarkerArray(markers=markers)


def _thinned(path: Array) -> Array:
    kept = np.linspace(0, len(path) - 1, min(LONGEST_PATH, len(path))).astype(int)
    return np.asarray(path[kept])
