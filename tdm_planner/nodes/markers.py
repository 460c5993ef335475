# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Plants and plans as markers for RViz and Foxglove, drawn with the shapes of `tdm_planner.drawing`.

There are two kinds of MarkerArrays. A plan's is latched and complete: every message deletes the
drawing of the one before. A moving plant's is published repeatedly with the same namespaces and
numbers, and disappears by its lifetime when its publisher is gone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
import math
import re
from typing import NamedTuple
import zlib

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Quaternion, Vector3
import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from tdm_planner.drawing import Box, Disc, Drawn, Line, points_of, Shape, way_of
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]

MARKER_DEPTH = 5  # messages a slow viewer may lag behind
LONGEST_LIFETIME = 3600.0  # s
LIFETIME = 0.5  # s that something moving stays visible without news, at least

LONGEST_PATH = 300  # points

_TRAIL_POINTS = 100
_SHORTEST_SPACING = 0.02  # s between places of a trail
_ROUNDING = 1e-6  # s
_WIDTH = 0.012  # of lines, as a share of the drawing's size
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 49)
_WHITE = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
_TRAIL = ColorRGBA(r=0.5, g=0.5, b=0.52, a=1.0)
_PATH = ColorRGBA(r=0.2, g=0.5, b=1.0, a=0.9)
_COLOURS = {
    'body': ColorRGBA(r=0.25, g=0.25, b=0.3, a=1.0),
    'limit': ColorRGBA(r=0.85, g=0.2, b=0.2, a=0.7),
    'reach': ColorRGBA(r=0.95, g=0.7, b=0.1, a=0.8),
    'goal': ColorRGBA(r=0.1, g=0.75, b=0.35, a=0.7),
    'force': _PATH,
}

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


def to_points(positions: Array) -> list[Point]:
    """Positions (n, 2) or (n, 3) [m] as messages."""
    return [Point(**dict(zip('xyz', row, strict=False))) for row in positions.tolist()]


@dataclass(frozen=True)
class MarkerFactory:
    """Makes markers in one frame, with its `stamp` and `lifetime` [s]; 0 is for ever."""

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
        marker = self.solid(namespace, number, kind, _WHITE, scale, position)
        marker.text = text
        return marker

    def delete(self, namespace: str, number: int) -> Marker:
        """Return a message that removes one marker."""
        marker = Marker(ns=namespace, id=number, action=Marker.DELETE)
        marker.header.frame_id, marker.header.stamp = self.frame, self.stamp
        return marker

    def delete_all(self) -> Marker:
        """Return a message that removes everything that the topic has drawn."""
        marker = Marker(action=Marker.DELETEALL)
        marker.header.frame_id, marker.header.stamp = self.frame, self.stamp
        return marker


class Trail:
    """The recent positions of a point, not older than `age` s."""

    def __init__(self, age: float) -> None:
        self.age = age
        self._places: deque[tuple[float, Point]] = deque()

    def add(self, instant: float, place: Point) -> None:
        """Remember a place; an instant [s] before the last one starts a new trail."""
        places = self._places
        if places and instant < places[-1][0]:
            places.clear()
        places.append((instant, place))
        while instant - places[0][0] > self.age + _ROUNDING:
            places.popleft()

    @property
    def points(self) -> list[Point]:
        """Return the places, oldest first."""
        return [point for _, point in self._places]


class Picture:
    """
    A plant in motion: `add` states to the trails, `draw` as often as it is to be shown.

    Namespaces are the styles of the shapes, `trail` and `name`; numbers are places in the drawing.
    A plant with a name has its colour, and shows it.
    """

    def __init__(self, drawn: Drawn, trail: float, name: str = '') -> None:
        self._trails: dict[int, Trail] = {}
        self.set_up(drawn, trail, name)

    def set_up(self, drawn: Drawn, trail: float, name: str = '') -> None:
        """Draw another plant, with a trail of `trail` s, from now on."""
        self._drawn, self._name = drawn, name
        self._age, self._spacing = trail, max(trail / _TRAIL_POINTS, _SHORTEST_SPACING)
        for kept in self._trails.values():
            kept.age = trail
        self._width = 0.0  # of lines [m], until the first drawing
        self._due = -math.inf  # instant [s] of the next place of the trails

    def add(self, instant: float, state: Array) -> None:
        """Lengthen the trails by the places in a state (nx,) at an instant [s]."""
        if self._due - self._spacing <= instant < self._due - _ROUNDING:
            return
        self._due = instant + self._spacing
        for number, shape in enumerate(self._shapes(state, None)):
            if shape.trail:
                trail = self._trails.setdefault(number, Trail(self._age))
                trail.add(instant, to_points(_followed(shape, 1))[0])

    def clear(self) -> None:
        """Forget the trails, where the plant did not move but was put elsewhere."""
        self._trails.clear()
        self._due = -math.inf

    def draw(
        self, stamp: Time, state: Array, control: Array, lifetime: float = LIFETIME
    ) -> MarkerArray:
        """Return the plant in a state (nx,) under controls (nu,), visible for `lifetime` [s]."""
        pen, shapes = (
            MarkerFactory(self._drawn.kind.frame, stamp, lifetime),
            self._shapes(state, control),
        )
        width, name = self._width, self._name
        shown = [_marker(pen, k, shape, width, name) for k, shape in enumerate(shapes)]
        for number, trail in self._trails.items():
            if len(trail.points) > 1:
                colour = colour_of(name) if name else _TRAIL
                shown.append(pen.line('trail', number, trail.points, colour, 0.5 * width))
        if name:
            x, y, _ = _followed(shapes[0], 1)[0].tolist()
            shown.append(pen.text('name', 0, name, (x, y - 20.0 * width, 0.0), 10.0 * width))
        return MarkerArray(markers=shown)

    def _shapes(self, state: Array, control: Array | None) -> Sequence[Shape]:
        kind = self._drawn.kind
        controls = () if control is None else control
        shapes = self._drawn.drawing(
            dict(zip(kind.state_names, state, strict=False)),
            dict(zip(kind.control_names, controls, strict=False)),
        )
        self._width = self._width or _WIDTH * _size(shapes)
        return shapes


class DrawnPath(NamedTuple):
    """Planned states (n, nx) of a plant called `name`; a single one is its goal."""

    drawn: Drawn
    states: Array
    name: str = ''


def plan_markers(
    frame: str, surroundings: Sequence[Shape], ways: Sequence[DrawnPath]
) -> MarkerArray:
    """
    Draw a plan: the surroundings, the planned paths, and every plant at its goal.

    The drawing of an earlier message is deleted first. Namespaces are those of `Picture`, and
    `planned_path`; each plant has a hundred numbers, the first hundred are the surroundings'.
    """
    pen = MarkerFactory(frame)
    shown = [pen.delete_all()]
    ends = [list(_in_motion(way, way.states[-1])) for way in ways]
    width = _WIDTH * _size([*surroundings, *(shape for end in ends for shape in end)])
    shown += [_marker(pen, k, shape, width) for k, shape in enumerate(surroundings)]
    for count, (way, end) in enumerate(zip(ways, ends, strict=True), start=1):
        thin = np.linspace(0, len(way.states) - 1, min(LONGEST_PATH, len(way.states))).astype(int)
        for place, shape in enumerate(_in_motion(way, way.states[thin])):
            number = 100 * count + place
            if shape.trail and thin.size > 1:
                path = to_points(_followed(shape, thin.size))
                colour = colour_of(way.name, 0.8) if way.name else _PATH
                shown.append(pen.line('planned_path', number, path, colour, 0.5 * width))
            last = end[place]
            if last.style == 'body':
                last = replace(last, style='goal')
            if last.style in ('goal', 'reach'):
                shown.append(_marker(pen, number, last, width, way.name))
    return MarkerArray(markers=shown)


def _in_motion(way: DrawnPath, states: Array) -> Sequence[Shape]:
    return way.drawn.drawing(dict(zip(way.drawn.kind.state_names, states.T, strict=False)), {})


def _followed(shape: Shape, count: int) -> Array:
    """Return where the end of a line, or a centre, is at `count` instants, (count, 3)."""
    places = way_of(shape, count)
    return np.pad(places, ((0, 0), (0, 3 - places.shape[1])))


def _size(shapes: Iterable[Shape]) -> float:
    """Return the largest extent of shapes in one state [m]."""
    extents = [1e-3]
    corners = []
    for shape in shapes:
        points = points_of(shape, 1)[0]
        corners += np.pad(points, ((0, 0), (0, 3 - points.shape[1]))).tolist()
        extents += [shape.radius] if isinstance(shape, Disc) else []
    extents += np.ptp(corners, axis=0).tolist() if corners else []
    return float(max(extents))


def _marker(pen: MarkerFactory, number: int, shape: Shape, width: float, name: str = '') -> Marker:
    """Return a shape as a marker; bodies and goals of a plant with a name have its colour."""
    style, colour = shape.style, _COLOURS[shape.style]
    if name and not isinstance(shape, Line) and style in ('body', 'goal'):
        colour = colour_of(name, colour.a)
    points = points_of(shape, 1)[0]
    if isinstance(shape, Disc) and style == 'reach' and points.shape[1] == 2:
        circle = shape.radius * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
        return pen.line(style, number, to_points(points + circle), colour, 0.5 * width)
    if isinstance(shape, Disc):
        ball, kind = [2.0 * shape.radius] * 3, Marker.SPHERE
        if points.shape[1] == 2:
            ball, kind = [*ball[:2], width], Marker.CYLINDER
        return pen.solid(style, number, kind, colour, ball, points[0].tolist())
    if isinstance(shape, Box):
        size = [*map(float, shape.size), width][:3]
        turned = to_quaternion(math.remainder(float(np.asarray(shape.turn)), math.tau))
        centre = [float(np.asarray(part)) for part in shape.centre]
        return pen.solid(style, number, Marker.CUBE, colour, size, centre, turned)
    if points.shape[1] == 2:  # above what is drawn in the plane
        points = np.pad(points, ((0, 0), (0, 1)), constant_values=width)
    return pen.line(style, number, to_points(points), colour, width)
