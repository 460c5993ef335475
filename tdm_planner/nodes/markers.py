# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Plants and plans as markers for RViz and Foxglove, drawn with the shapes of `tdm_planner.drawing`.

There are two kinds of MarkerArrays. A plan's is latched and complete: every message deletes the
drawing of the one before. A moving plant's is published repeatedly with the same namespaces and
numbers, and disappears by its lifetime when its publisher is gone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
import re
from typing import Any
import zlib

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Vector3
import numpy as np
from std_msgs.msg import ColorRGBA, Header
from tdm_planner.arrays import Array
from tdm_planner.drawing import (
    Box,
    COLOURS,
    Disc,
    Drawn,
    DrawnPath,
    in_space,
    Line,
    points_of,
    rgb,
    Shape,
    Style,
    STYLE_COLOURS,
    SWITCH,
    WAY,
    way_of,
)
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import to_duration, to_quaternion
from visualization_msgs.msg import Marker, MarkerArray

MARKER_DEPTH = 5  # messages a slow viewer may lag behind
MARKER_RATE = 20.0  # Hz of a plant in motion, while a viewer subscribes
LIFETIME = 0.5  # s that something moving stays visible without news

LONGEST_PATH = 300  # points

_TRAIL_POINTS = 100
_SHORTEST_SPACING = 0.02  # s between places of a trail
_ROUNDING = 1e-6  # s
_WIDTH = 0.012  # of lines, as a share of the drawing's size
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 49)
_OPACITY: Mapping[Style, float] = {
    'body': 1.0, 'limit': 0.7, 'reach': 0.8, 'goal': 0.7, 'force': 0.9,
}  # fmt: skip


def _painted(colour: str, alpha: float = 1.0) -> ColorRGBA:
    red, green, blue = (part / 255.0 for part in rgb(colour))
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)


_WHITE, _TRAIL, _PATH = _painted('#ffffff'), _painted(SWITCH), _painted(WAY, 0.9)
_COLOURS = {style: _painted(STYLE_COLOURS[style], alpha) for style, alpha in _OPACITY.items()}


def colour_of(name: str, alpha: float = 1.0) -> ColorRGBA:
    """
    Return the colour of a robot, the same wherever it is drawn.

    Names that end in a number take the colours in turn; others by a checksum of the name.
    """
    number = re.search(r'\d{1,9}$', name)
    index = int(number.group()) - 1 if number else zlib.crc32(name.encode())
    return _painted(COLOURS[index % len(COLOURS)], alpha)


def to_points(positions: Array) -> list[Point]:
    """Positions (n, 2) or (n, 3) [m] as messages."""
    return [Point(**dict(zip('xyz', row, strict=False))) for row in positions.tolist()]


@dataclass(frozen=True)
class Pen:
    """Makes markers in one frame, with its `stamp` and `lifetime` [s]; 0 is for ever."""

    frame: str
    stamp: Time = field(default_factory=Time)
    lifetime: float = 0.0

    def marker(self, namespace: str = '', number: int = 0, **fields: Any) -> Marker:
        """Return a marker with further fields of the message."""
        header = Header(frame_id=self.frame, stamp=self.stamp)
        lifetime = to_duration(self.lifetime)
        return Marker(header=header, ns=namespace, id=number, lifetime=lifetime, **fields)

    def line(
        self, namespace: str, number: int, points: list[Point], colour: ColorRGBA, width: float
    ) -> Marker:
        """Return a line through two points or more."""
        scale = Vector3(x=width)
        kind = Marker.LINE_STRIP
        return self.marker(namespace, number, type=kind, points=points, color=colour, scale=scale)

    def text(self, namespace: str, text: str, position: Sequence[float], height: float) -> Marker:
        """Return white letters that face the viewer, capitals `height` m high."""
        return self.marker(
            namespace,
            type=Marker.TEXT_VIEW_FACING,
            text=text,
            pose=to_pose(position),
            color=_WHITE,
            scale=Vector3(z=height),
        )


def to_pose(position: Sequence[float], yaw: float = 0.0) -> Pose:
    """Return a pose at a position [m], turned about the vertical by `yaw` [rad]."""
    point = Point(**dict(zip('xyz', position, strict=False)))
    return Pose(position=point, orientation=to_quaternion(yaw))


class Picture:
    """
    A plant in motion: `add` states to the trails, `draw` as often as it is to be shown.

    Namespaces are the styles of the shapes, `trail` and `name`; numbers are places in the drawing.
    A plant with a name has its colour, and shows it. A state that cannot be drawn is skipped:
    `warn` is called with the first reason.
    """

    def __init__(self, drawn: Drawn, name: str, warn: Callable[[str], object]) -> None:
        self._name, self._warn = name, warn
        self._trails: dict[int, deque[tuple[float, Point]]] = {}  # by shape: instants, places
        self.set_up(drawn)

    def set_up(self, drawn: Drawn) -> None:
        """Draw another plant from now on."""
        self._drawn = drawn
        self._spacing = max(drawn.span / _TRAIL_POINTS, _SHORTEST_SPACING)
        self._width = 0.0  # of lines [m], until the first drawing
        self._due = -math.inf  # instant [s] of the next place of the trails
        self._warned = False

    def add(self, instant: float, state: Array) -> None:
        """Lengthen the trails by the places in a state (nx,) at an instant [s]."""
        if instant < self._due - self._spacing:  # the clock was set back
            self.clear()
        if instant < self._due - _ROUNDING:
            return
        self._due = instant + self._spacing
        for number, shape in enumerate(self._shapes(state)):
            if shape.trail:
                trail = self._trails.setdefault(number, deque())
                trail.append((instant, to_points(way_of(shape, 1))[0]))
                while instant - trail[0][0] > self._drawn.span + _ROUNDING:
                    trail.popleft()

    def clear(self) -> None:
        """Forget the trails, where the plant did not move but was put elsewhere."""
        self._trails.clear()
        self._due = -math.inf

    def draw(self, stamp: Time, state: Array, control: Array) -> MarkerArray:
        """Return the plant in a state (nx,) under controls (nu,); nothing if it fails."""
        if not (shapes := self._shapes(state, control)):
            return MarkerArray()
        pen, name = Pen(self._drawn.kind.frame, stamp, LIFETIME), self._name
        self._width = width = self._width or _WIDTH * _size(self._shapes(state))
        shown = [_marker(pen, k, shape, width, name) for k, shape in enumerate(shapes)]
        for number, trail in self._trails.items():
            if len(trail) > 1:
                colour, points = colour_of(name) if name else _TRAIL, [place for _, place in trail]
                shown.append(pen.line('trail', number, points, colour, 0.5 * width))
        if name:
            x, y, *_ = way_of(shapes[0], 1)[0].tolist()
            shown.append(pen.text('name', name, (x, y - 20.0 * width), 10.0 * width))
        return MarkerArray(markers=shown)

    def _shapes(self, *values: Array) -> Sequence[Shape]:
        """Return the shapes in a state; none if a user's drawing of it fails."""
        try:
            return self._drawn.shapes(*values)
        except InvalidProblem as error:
            if not self._warned:
                self._warned = True
                self._warn(f'the plant is not drawn: {error}')
            return ()


def plan_markers(
    frame: str, surroundings: Sequence[Shape], ways: Sequence[DrawnPath]
) -> MarkerArray:
    """
    Draw a plan: the surroundings, the planned paths, and every plant at its goal.

    The drawing of an earlier message is deleted first. Namespaces are those of `Picture`, and
    `planned_path`; each plant has a hundred numbers, the first hundred are the surroundings'.
    """
    pen = Pen(frame)
    shown = [pen.marker(action=Marker.DELETEALL)]
    ends = [way.drawn.shapes(way.states[-1]) for way in ways]
    width = _WIDTH * _size([*surroundings, *(shape for end in ends for shape in end)])
    shown += [_marker(pen, k, shape, width) for k, shape in enumerate(surroundings)]
    for count, (way, end) in enumerate(zip(ways, ends, strict=True), start=1):
        thin = np.linspace(0, len(way.states) - 1, min(LONGEST_PATH, len(way.states))).astype(int)
        for place, shape in enumerate(way.drawn.shapes(way.states[thin])):
            number = 100 * count + place
            if shape.trail and thin.size > 1:
                path = to_points(way_of(shape, thin.size))
                colour = colour_of(way.name, 0.8) if way.name else _PATH
                shown.append(pen.line('planned_path', number, path, colour, 0.5 * width))
            last = end[place]
            if last.style == 'body':
                last = replace(last, style='goal')
            if last.style in ('goal', 'reach'):
                shown.append(_marker(pen, number, last, width, way.name))
    return MarkerArray(markers=shown)


def _size(shapes: Sequence[Shape]) -> float:
    """Return the largest extent of shapes in one state [m]."""
    corners = [in_space(points_of(shape, 1)[0]) for shape in shapes]
    extents = np.ptp(np.concatenate(corners), axis=0).tolist() if corners else []
    radii = [shape.radius for shape in shapes if isinstance(shape, Disc)]
    return float(max([1e-3, *extents, *radii]))


def _marker(pen: Pen, number: int, shape: Shape, width: float, name: str = '') -> Marker:
    """Return a shape as a marker; bodies and goals of a plant with a name have its colour."""
    style, colour, points = shape.style, _COLOURS[shape.style], points_of(shape, 1)[0]
    flat = points.shape[1] == 2
    if isinstance(shape, Line):
        if flat:  # above what is drawn in the plane
            points = np.pad(points, ((0, 0), (0, 1)), constant_values=width)
        return pen.line(style, number, to_points(points), colour, width)
    if name and style in ('body', 'goal'):
        colour = colour_of(name, colour.a)
    if isinstance(shape, Box):
        size, kind = [*map(float, shape.size)], Marker.CUBE
        turn = math.remainder(float(np.asarray(shape.turn)), math.tau)
    elif flat and style == 'reach':
        circle = shape.radius * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
        return pen.line(style, number, to_points(points + circle), colour, 0.5 * width)
    else:
        kind = Marker.CYLINDER if flat else Marker.SPHERE
        size, turn = [2.0 * shape.radius] * points.shape[1], 0.0
    pose = to_pose(way_of(shape, 1)[0].tolist(), turn)
    scale = Vector3(**dict(zip('xyz', [*size, width], strict=False)))
    return pen.marker(style, number, type=kind, pose=pose, color=colour, scale=scale)
