# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A floating robot in motion as markers in the frame `arena`."""

from __future__ import annotations

from dataclasses import dataclass

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from tdm_planner.nodes.markers import colour_of, LIFETIME, Pen, to_quaternion, Trail, WHITE
from tdm_planner.plant_kind import ARENA_FRAME
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]

TRAIL_LIFETIME = 4.0  # in lifetimes of the rest: not every message repeats the long trail

_TRAIL_SPACING = 0.25  # s
_TRAIL_EVERY = 5  # messages
_LEAST_THRUST = 1e-3  # of the largest; less is not drawn
_FLAME, _TIP = ColorRGBA(r=1.0, g=0.85, b=0.3, a=0.95), ColorRGBA(r=1.0, g=0.3, b=0.1, a=0.15)


@dataclass(frozen=True)
class RobotLook:
    """
    What a robot looks like.

    `radius` of its body and `separation`, the least distance of two robots [m]; `thrust` is the
    largest [N].
    """

    name: str
    radius: float
    separation: float
    thrust: float


class RobotPicture:
    """
    A robot in motion: `add` states to the trail, `draw` as often as it is to be shown.

    Namespaces, each with the number 0: `body`; `heading`, an arrow towards the front; `plume`, the
    jet of the thruster; `separation`, a disc of half the minimum separation: where two of them
    touch, the robots are as near as they may be; `name`; `trail`.

    The plume's orientation is yaw + alpha, the direction of the force on the robot; the jet itself
    leaves the opposite side of the body, as gas does. Its length is four radii at full thrust and
    in proportion below.
    """

    def __init__(self, look: RobotLook, trail: float) -> None:
        self.look = look
        self._trail = Trail(trail, _TRAIL_SPACING)
        self._drawn = 0

    def set_up(self, look: RobotLook, trail: float) -> None:
        """Draw another look and length of the trail [s] from now on."""
        self.look, self._trail.age = look, trail

    def add(self, instant: int, state: Array) -> None:
        """Lengthen the trail by the place in a state (7,) at an instant [ns]."""
        x, y = state[:2].tolist()
        self._trail.add(instant, x, y, 0.01)

    def clear(self) -> None:
        """Forget the trail, where the robot did not move but was put elsewhere."""
        self._trail.clear()
        self._drawn = 0

    def draw(
        self, stamp: Time, state: Array, control: Array, lifetime: float = LIFETIME
    ) -> MarkerArray:
        """Return the robot in a state (7,) under controls (3,), visible for `lifetime` [s]."""
        look, pen = self.look, Pen(ARENA_FRAME, stamp, lifetime)
        x, y, _, _, yaw, _, alpha = state[:7].tolist()
        radius = look.radius
        body = (2 * radius, 2 * radius, 0.6 * radius)
        arrow = (1.5 * radius, 0.25 * radius, 0.25 * radius)
        disc = (look.separation, look.separation, 0.002)
        colour = colour_of(look.name)
        turned = to_quaternion(yaw)
        markers = [
            pen.solid('body', 0, Marker.CYLINDER, colour, body, (x, y, 0.3 * radius)),
            pen.solid('heading', 0, Marker.ARROW, WHITE, arrow, (x, y, 0.75 * radius), turned),
            pen.solid(
                'separation', 0, Marker.CYLINDER, colour_of(look.name, 0.25), disc, (x, y, 0.002)
            ),
            pen.text('name', 0, look.name, (x, y - 1.7 * radius, 0.7 * radius), 0.6 * radius),
            self._plume(pen, (x, y), yaw + alpha, float(control[0])),
        ]
        if self._drawn % _TRAIL_EVERY == 0:
            markers.append(self._drawn_trail(stamp, colour, TRAIL_LIFETIME * lifetime))
        self._drawn += 1
        return MarkerArray(markers=markers)

    def _plume(
        self, pen: Pen, place: tuple[float, float], direction: float, thrust: float
    ) -> Marker:
        share = min(thrust / self.look.thrust, 1.0)
        if not share > _LEAST_THRUST:
            return pen.delete('plume', 0)
        marker = pen.solid(
            'plume',
            0,
            Marker.TRIANGLE_LIST,
            _FLAME,
            (1.0, 1.0, 1.0),
            (*place, 0.35 * self.look.radius),
            to_quaternion(direction),
        )
        # In the marker's frame the force is along x: the jet begins at the body's back, wider
        # the longer it is.
        begin = -self.look.radius
        end = begin - 4.0 * self.look.radius * share
        half = 0.15 * self.look.radius + 0.45 * self.look.radius * share
        wings = Point(x=end, y=half), Point(x=end, y=-half)
        # Both senses of rotation: seen from above and from below.
        marker.points = [Point(x=begin), *wings, Point(x=begin), *reversed(wings)]
        marker.colors = [_FLAME, _TIP, _TIP] * 2
        return marker

    def _drawn_trail(self, stamp: Time, colour: ColorRGBA, lifetime: float) -> Marker:
        pen = Pen(ARENA_FRAME, stamp, lifetime)
        points = self._trail.points
        if len(points) < 2:
            return pen.delete('trail', 0)
        return pen.line('trail', 0, points, colour, 0.12 * self.look.radius)
