# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Shapes of a drawing as solids in space: copies of a unit cylinder, ball and box, and thin lines.

All shapes of one kind are one array, however many vehicles there are: a frame of the page is a few
messages. What lies in the plane is drawn flat, at height 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from tdm_planner.drawing import COLOURS, Disc, Line, points_of, Shape, Style

Array = NDArray[np.float64]
Colour = tuple[int, int, int]

UPWARDS: Final = np.array([1.0, 0.0, 0.0, 0.0])  # the rotation that turns nothing

_PAINT: dict[Style, Colour] = {
    'body': (66, 72, 84),
    'limit': (203, 62, 62),
    'reach': (222, 160, 40),
    'goal': (24, 150, 90),
    'force': (235, 95, 30),
}
_PLANNED: Colour = (70, 130, 235)
_CLEAR: dict[Style, float] = {'limit': 0.5, 'reach': 0.3}  # opacity of discs and boxes
_THICK: dict[Style, float] = {'body': 1.0, 'force': 1.8}  # of lines that are tubes, in widths
_FLAT: dict[Style, float] = {
    'body': 1.2,
    'limit': 2.0,
    'reach': 0.15,
}  # height of a disc in widths
_WIDTH = 0.007  # of a tube, as a share of the drawing's size
_THIN = 0.2  # along y, as a share of its size, of what moves in the plane of x and z


class Look(NamedTuple):
    """How a group of shapes is drawn: colours of bodies and their lines, opacity, styles."""

    body: Colour | None = None
    line: Colour | None = None
    opacity: float = 1.0
    styles: frozenset[Style] = frozenset(_PAINT)


GHOST: Final = Look(_PLANNED, _PLANNED, 0.35, frozenset({'body'}))
PATH: Final = _PLANNED  # of the only vehicle
NOTHING: Final[Sequence[tuple[Sequence[Shape], Look]]] = ()
GOAL: Final = Look(_PAINT['goal'], _PAINT['goal'], 0.45, frozenset({'body'}))


@dataclass(frozen=True, eq=False)
class Solids:
    """
    Copies of a unit shape.

    `places` (n, 3) and `sizes` (n, 3) [m], `rotations` (n, 4) wxyz, `colours` (n, 3); `groups`
    (n,) are the groups of shapes that they are of.
    """

    places: Array
    rotations: Array
    sizes: Array
    colours: NDArray[np.uint8]
    groups: NDArray[np.int_]


class _Copy(NamedTuple):
    place: Array
    rotation: Array
    size: Array
    colour: Colour
    group: int


@dataclass(frozen=True, eq=False)
class Picture:
    """
    What is drawn.

    Solids by kind and opacity; the ends (n, 2, 3) [m] of thin lines, with their colours.
    """

    solids: dict[tuple[str, float], Solids]
    lines: Array
    line_colours: NDArray[np.uint8]


def picture(
    groups: Iterable[tuple[Sequence[Shape], Look]],
    width: float,
    paths: Iterable[tuple[Array, Colour]] = (),
) -> Picture:
    """
    Return the solids of groups of shapes; lines of bodies and forces are `width` m thick.

    `paths` are ways (n, 2 or 3) that are drawn as thin lines.
    """
    copies: dict[tuple[str, float], list[_Copy]] = {}
    ends: list[Array] = []
    paints: list[Colour] = []
    for way, colour in paths:
        places = in_space(way)
        ends.extend(np.stack([places[:-1], places[1:]], axis=1))
        paints.extend([colour] * (len(places) - 1))
    for group, (shapes, look) in enumerate(groups):
        for shape in shapes:
            if shape.style not in look.styles:
                continue
            points, paint = in_space(points_of(shape, 1)[0]), _PAINT[shape.style]
            if isinstance(shape, Line):
                if shape.style == 'body':
                    paint = look.line or paint
                pairs = np.stack([points[:-1], points[1:]], axis=1)
                if shape.style not in _THICK:
                    ends.extend(pairs)
                    paints.extend([paint] * len(pairs))
                    continue
                thick = width * _THICK[shape.style]
                copies.setdefault(('cylinder', look.opacity), []).extend(
                    _Copy(*_tube(first, last, thick), paint, group) for first, last in pairs
                )
                continue
            if shape.style == 'body':
                paint = look.body or paint
            height = width * _FLAT.get(shape.style, 1.0)
            turn, centre = UPWARDS, points[0]
            if isinstance(shape, Disc):
                flat = len(shape.centre) == 2
                kind = 'cylinder' if flat else 'ball'
                sizes = np.array([shape.radius, shape.radius, height if flat else shape.radius])
            else:
                kind, turn = 'box', about((0.0, 0.0, 1.0), float(np.asarray(shape.turn)))
                centre = in_space(np.array([float(np.asarray(part)) for part in shape.centre]))
                sizes = np.array([*map(float, shape.size), height][:3])
            clear = look.opacity * _CLEAR.get(shape.style, 1.0)
            copy = _Copy(centre, turn, sizes, paint, group)
            copies.setdefault((kind, clear), []).append(copy)
    return Picture(
        {kind: _stacked(found) for kind, found in copies.items()},
        np.array(ends).reshape(-1, 2, 3),
        np.repeat(np.array(paints, dtype=np.uint8).reshape(-1, 1, 3), 2, axis=1),
    )


def _stacked(copies: Sequence[_Copy]) -> Solids:
    return Solids(
        np.array([copy.place for copy in copies]),
        np.array([copy.rotation for copy in copies]),
        np.array([copy.size for copy in copies]),
        np.array([copy.colour for copy in copies], dtype=np.uint8),
        np.array([copy.group for copy in copies], dtype=int),
    )


def _tube(first: Array, last: Array, radius: float) -> tuple[Array, Array, Array]:
    """Return place, rotation and size of the unit cylinder between two points."""
    way = last - first
    length = float(np.linalg.norm(way))
    return 0.5 * (first + last), from_vertical(way), np.array([radius, radius, length])


def in_space(points: Array) -> Array:
    """Return points (..., 2 or 3) in space; those of the plane are at height 0."""
    missing = 3 - points.shape[-1]
    return np.pad(points, [(0, 0)] * (points.ndim - 1) + [(0, missing)])


def from_vertical(direction: Array) -> Array:
    """Return the rotation wxyz (4,) that turns z into a direction (3,), by the shortest way."""
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        return UPWARDS
    x, y, z = (direction / length).tolist()
    across = x * x + y * y
    if across == 0.0:
        return UPWARDS if z > 0.0 else np.array([0.0, 1.0, 0.0, 0.0])
    half = np.array([1.0 + z if z > 0.0 else across / (1.0 - z), -y, x, 0.0])
    return np.asarray(half / np.linalg.norm(half))


def about(axis: ArrayLike, angle: float) -> Array:
    """Return the rotation wxyz (4,) by an angle [rad] about a unit axis (3,)."""
    return _wxyz(Rotation.from_rotvec(angle * np.asarray(axis, dtype=float)))


def from_axes(x: Array, y: Array, z: Array) -> Array:
    """Return the rotation wxyz (4,) that turns the axes of space into three others (3,) each."""
    return _wxyz(Rotation.from_matrix(np.stack([x, y, z], axis=1)))


def axes_of(rotation: Array) -> tuple[Array, Array, Array]:
    """Return the axes (3,) into which a rotation wxyz (4,) turns those of space."""
    matrix = Rotation.from_quat(np.roll(rotation, -1)).as_matrix()
    return matrix[:, 0], matrix[:, 1], matrix[:, 2]


def _wxyz(rotation: Rotation) -> Array:
    return np.roll(rotation.as_quat(), 1)


class View(NamedTuple):
    """Where the camera stands and what it looks at; size and lowest point of what is drawn [m]."""

    camera: Array
    target: Array
    size: float
    floor: float

    @property
    def width(self) -> float:
        """Radius of tubes [m]."""
        return _WIDTH * self.size


def view_on(shapes: Iterable[Shape]) -> View:
    """Return a view on shapes: on the plane from above, on x and z from the front."""
    corners, flat = [], True
    for shape in shapes:
        points = points_of(shape, 1)[0]
        flat &= points.shape[1] == 2
        around = shape.radius if isinstance(shape, Disc) else 0.0
        corners += [in_space(points) - around, in_space(points) + around]
    found = np.concatenate(corners or [np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])])
    if flat:
        found[:, 2] = 0.0
    low, high = found.min(axis=0), found.max(axis=0)
    target, size = 0.5 * (low + high), max(float((high - low).max()), 1e-3)
    away = [1.1, -1.1, 0.7]
    if flat:
        away = [0.0, -0.35, 0.85]
    elif high[1] - low[1] < _THIN * size:
        away = [0.0, -1.0, 0.25]
    return View(target + size * np.array(away), target, size, float(low[2]))


def colour_of(number: int, count: int) -> Colour | None:
    """Return the colour of one of several vehicles; of the only one: that of bodies."""
    if count == 1:
        return None
    text = COLOURS[number % len(COLOURS)]
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)
