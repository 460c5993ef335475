# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What all pictures for RViz and Foxglove are made of: a pen, colours, trails.

There are two kinds of MarkerArrays. What belongs to a plan is latched and complete: every message
deletes what the one before it drew. What moves is published again and again under the same
namespaces and numbers, and disappears by its lifetime when its publisher is gone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
import math
import re
from typing import Protocol
import zlib

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Quaternion, Vector3
import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]

MARKER_DEPTH = 5  # messages a slow viewer may lag behind
LONGEST_LIFETIME = 3600.0  # s
LIFETIME = 0.5  # s that something moving stays visible without news, at least

GREY = ColorRGBA(r=0.5, g=0.5, b=0.52, a=1.0)
DARK = ColorRGBA(r=0.25, g=0.25, b=0.3, a=1.0)
WHITE = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
RED = ColorRGBA(r=0.85, g=0.2, b=0.2, a=1.0)
BLUE = ColorRGBA(r=0.2, g=0.5, b=1.0, a=0.9)
GREEN = ColorRGBA(r=0.1, g=0.75, b=0.35, a=0.7)
AMBER = ColorRGBA(r=0.95, g=0.7, b=0.1, a=0.8)

# Okabe and Ito's colours, which colour-blind people can tell apart.
_PALETTE = (
    (0.902, 0.624, 0.0),
    (0.337, 0.706, 0.914),
    (0.0, 0.620, 0.451),
    (0.941, 0.894, 0.259),
    (0.835, 0.369, 0.0),
    (0.800, 0.475, 0.655),
    (0.0, 0.447, 0.698),
)


def to_quaternion(yaw: float) -> Quaternion:
    """Return the rotation by `yaw` [rad] about the vertical."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def colour_of(name: str, alpha: float = 1.0) -> ColorRGBA:
    """
    Return the colour of a robot, the same wherever it is drawn.

    Names that end in a number take the colours in turn; others by a checksum of the name.
    """
    number = re.search(r'\d{1,9}$', name)
    index = int(number.group()) - 1 if number else zlib.crc32(name.encode())
    red, green, blue = _PALETTE[index % len(_PALETTE)]
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)


def lifetime_at(rate: float) -> float:
    """Return for how long [s] what is drawn at `rate` [Hz] must stay visible, not to flicker."""
    return max(LIFETIME, min(3.0 / rate, LONGEST_LIFETIME))


def points_of(positions: Array) -> list[Point]:
    """Positions (n, 2) or (n, 3) [m] as messages."""
    return [Point(**dict(zip('xyz', row, strict=False))) for row in positions.tolist()]


@dataclass(frozen=True)
class Pen:
    """Draws in one frame: every marker gets its frame, `stamp` and `lifetime` [s], 0 for ever."""

    frame: str
    stamp: Time = field(default_factory=Time)
    lifetime: float = 0.0

    def marker(
        self, namespace: str, number: int, kind: int, colour: ColorRGBA, scale: Sequence[float]
    ) -> Marker:
        """Return a marker at the origin; `scale` [m] is as its kind reads it."""
        marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=colour)
        marker.header.frame_id, marker.header.stamp = self.frame, self.stamp
        marker.scale = Vector3(**dict(zip('xyz', scale, strict=False)))
        whole = int(self.lifetime)
        marker.lifetime = Duration(sec=whole, nanosec=round((self.lifetime - whole) * 1e9))
        return marker

    def solid(
        self,
        namespace: str,
        number: int,
        kind: int,
        colour: ColorRGBA,
        scale: Sequence[float],
        position: Sequence[float],
        orientation: Quaternion | None = None,
    ) -> Marker:
        """Return a sphere, cylinder, arrow... at a position [m]."""
        marker = self.marker(namespace, number, kind, colour, scale)
        marker.pose.position = Point(**dict(zip('xyz', position, strict=False)))
        if orientation is not None:
            marker.pose.orientation = orientation
        return marker

    def line(
        self,
        namespace: str,
        number: int,
        points: Sequence[Point],
        colour: ColorRGBA,
        width: float,
    ) -> Marker:
        """Return a line through two points or more."""
        marker = self.marker(namespace, number, Marker.LINE_STRIP, colour, [width])
        marker.points = list(points)
        return marker

    def text(
        self, namespace: str, number: int, text: str, position: Sequence[float], height: float
    ) -> Marker:
        """Return white letters that face the viewer, capitals `height` m high."""
        kind, scale = Marker.TEXT_VIEW_FACING, (0.0, 0.0, height)
        marker = self.solid(namespace, number, kind, WHITE, scale, position)
        marker.text = text
        return marker

    def delete(self, namespace: str, number: int) -> Marker:
        """Return what takes one marker away."""
        marker = Marker(ns=namespace, id=number, action=Marker.DELETE)
        marker.header.frame_id, marker.header.stamp = self.frame, self.stamp
        return marker

    def delete_all(self) -> Marker:
        """Return what takes everything away that the topic has drawn."""
        marker = Marker(action=Marker.DELETEALL)
        marker.header.frame_id, marker.header.stamp = self.frame, self.stamp
        return marker


class Picture(Protocol):
    """A plant in motion as markers: `add` every state, `draw` as often as it is to be shown."""

    def add(self, instant: int, state: Array) -> None:
        """Lengthen the trail by the place in a state (nx,) at an instant [ns]."""

    def clear(self) -> None:
        """Forget the trail, where the plant did not move but was put elsewhere."""

    def draw(
        self, stamp: Time, state: Array, control: Array, lifetime: float = LIFETIME
    ) -> MarkerArray:
        """Return the plant in a state (nx,) under controls (nu,), visible for `lifetime` [s]."""


class Trail:
    """
    Where something has been lately: places at least `spacing` s apart, not older than `age` s.

    An instant [ns] before the last one starts a new trail.
    """

    def __init__(self, age: float, spacing: float) -> None:
        self.age = age
        self._spacing = spacing
        self._places: deque[tuple[int, Point]] = deque()

    def add(self, instant: int, x: float, y: float, z: float) -> None:
        """Remember a place [m], unless the last one is too recent."""
        places = self._places
        if places and instant < places[-1][0]:
            places.clear()
        if not places or instant - places[-1][0] >= 1e9 * self._spacing:
            places.append((instant, Point(x=x, y=y, z=z)))
        while places and instant - places[0][0] > 1e9 * self.age:
            places.popleft()

    def clear(self) -> None:
        """Forget everything."""
        self._places.clear()

    @property
    def points(self) -> list[Point]:
        """Return the places, oldest first."""
        return [point for _, point in self._places]
