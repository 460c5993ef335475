# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The pendulum as markers in the frame `world`: the rig in motion, and a plan."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from tdm_planner.nodes.markers import (
    AMBER,
    BLUE,
    DARK,
    GREEN,
    GREY,
    LIFETIME,
    Pen,
    points_of,
    RED,
    to_quaternion,
    Trail,
)
from tdm_planner.plant_kind import WORLD_FRAME
from tdm_planner.plants.pendulum_geometry import pendulum_points, RigShape
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from visualization_msgs.msg import Marker, MarkerArray

if TYPE_CHECKING:  # a simulated plant has no use for scipy, which trajectories need
    from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

LONGEST_PATH = 300  # points

_SLIM = 0.97  # just inside the shapes of the URDF, so that both can be shown
_TRAIL_SPACING = 0.009  # s: every other state at 200 Hz, with some jitter
_ARC_STEP = math.radians(5.0)
_TRAIL_COLOUR = (1.0, 0.6, 0.2)


def plan_markers(plant: RotaryPendulum, plan: Trajectory) -> MarkerArray:
    """Draw a plan: path of the tip and where it ends; an earlier plan's markers are deleted."""
    shape, pen = RigShape.of(plant), Pen(WORLD_FRAME)
    count = min(LONGEST_PATH, plan.times.size)
    thin = np.unique(np.linspace(0, plan.times.size - 1, count).astype(int))
    _, tips = pendulum_points(plant, plan.states[thin, 0], plan.states[thin, 1])
    ball = [5.0 * shape.rod_radius] * 3
    return MarkerArray(
        markers=[
            pen.delete_all(),
            pen.line('planned_path', 0, points_of(tips), BLUE, 0.5 * shape.rod_radius),
            pen.solid('goal', 0, Marker.SPHERE, GREEN, ball, tips[-1].tolist()),
        ]
    )


class PendulumPicture:
    """
    The rig in motion: `add` every state to the trail, `draw` as often as it is to be shown.

    Namespaces, each with the number 0: `base`; `disk` and `arm` at psi; `disk_limit`, the arc of
    radius 1.25 arm lengths that the arm may sweep (a full circle for limits of half a turn and
    more), red while the arm is beyond; `rod`; `trail` of the tip.
    """

    def __init__(self, plant: RotaryPendulum, disk_limit: float, trail: float) -> None:
        self._trail = Trail(trail, _TRAIL_SPACING)
        self.set_up(plant, disk_limit, trail)

    def set_up(self, plant: RotaryPendulum, disk_limit: float, trail: float) -> None:
        """Draw another plant, limit [rad] and length of the trail [s] from now on."""
        self._shape, self._limit = RigShape.of(plant), disk_limit
        self._trail.age = trail
        self._arc = _arc(1.25 * self._shape.disk_radius, min(disk_limit, math.pi))
        size = int(trail / _TRAIL_SPACING) + 2
        red, green, blue = _TRAIL_COLOUR
        self._fading = [
            ColorRGBA(r=red, g=green, b=blue, a=0.05 + 0.85 * k / size) for k in range(size)
        ]

    def add(self, instant: int, state: Array) -> None:
        """Lengthen the trail by the tip's place in a state (4,) at an instant [ns]."""
        theta, psi = state[:2].tolist()
        self._trail.add(instant, *self._shape.tip(theta, psi))

    def clear(self) -> None:
        """Forget the trail, where the pendulum did not move but was put elsewhere."""
        self._trail.clear()

    def draw(
        self, stamp: Time, state: Array, control: Array, lifetime: float = LIFETIME
    ) -> MarkerArray:
        """Return the rig in a state (4,), visible for `lifetime` [s]."""
        theta, psi = state[:2].tolist()
        shape, pen = self._shape, Pen(WORLD_FRAME, stamp, lifetime)
        half = 0.5 * shape.disk_thickness
        base = [_SLIM * 2 * shape.base_radius] * 2 + [shape.base_height]
        disk = [_SLIM * 2 * shape.disk_radius] * 2 + [_SLIM * shape.disk_thickness]
        turned = to_quaternion(psi)
        x, y = shape.disk_radius * math.cos(psi), shape.disk_radius * math.sin(psi)
        arm = [Point(z=1.1 * half), Point(x=x, y=y, z=1.1 * half)]
        rod = [Point(x=x, y=y), Point(**dict(zip('xyz', shape.tip(theta, psi), strict=True)))]
        below = (0.0, 0.0, -half - 0.5 * shape.base_height)
        arc_colour = RED if abs(psi) > self._limit else AMBER
        return MarkerArray(
            markers=[
                pen.solid('base', 0, Marker.CYLINDER, DARK, base, below),
                pen.solid('disk', 0, Marker.CYLINDER, GREY, disk, (), turned),
                pen.line('disk_limit', 0, self._arc, arc_colour, 0.6 * shape.rod_radius),
                pen.line('arm', 0, arm, RED, shape.rod_radius),
                pen.line('rod', 0, rod, RED, 1.6 * shape.rod_radius),
                self._drawn_trail(pen),
            ]
        )

    def _drawn_trail(self, pen: Pen) -> Marker:
        points = self._trail.points
        if len(points) < 2:
            return pen.delete('trail', 0)
        count = min(len(points), len(self._fading))
        points, fading = points[-count:], self._fading[-count:]
        trail = pen.line('trail', 0, points, fading[-1], 0.6 * self._shape.rod_radius)
        trail.colors = fading
        return trail


def _arc(radius: float, limit: float) -> list[Point]:
    angles = np.linspace(-limit, limit, 2 + int(2 * limit / _ARC_STEP))
    return points_of(radius * np.stack([np.cos(angles), np.sin(angles)], axis=1))
