# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Shapes of a drawing as solids in space: copies of a unit cylinder, ball and box, and thin lines.

All shapes of one kind are one array, however many vehicles there are: a frame of the page is a few
messages. What lies in the plane is drawn flat, at height 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.arrays import Array
from tdm_planner.drawing import (
    Box,
    Disc,
    in_space,
    Line,
    points_of,
    rgb,
    Shape,
    Style,
    STYLE_COLOURS,
    WAY,
    way_of,
)
from viser.transforms import SO3

Rotation = NDArray[np.floating[Any]]  # wxyz (4,)
Colour = tuple[int, int, int]
Kind = tuple[str, float]  # of solids, and their opacity

_PAINT: dict[Style, Colour] = {style: rgb(text) for style, text in STYLE_COLOURS.items()}
_CLEAR: dict[Style, float] = {'limit': 0.5, 'reach': 0.3}  # opacity of discs and boxes
_THICK: dict[Style, float] = {'body': 1.0, 'force': 1.8}  # of lines that are tubes, in widths
_FLAT: dict[Style, float] = {'body': 1.2, 'limit': 2.0, 'reach': 0.15}  # height of discs, widths
_WIDTH = 0.007  # of a tube, as a share of the drawing's size
_THIN = 0.2  # along y, as a share of its size, of what moves in the plane of x and z
PATH: Final = rgb(WAY)  # of the only vehicle


class DrawingStyle(NamedTuple):
    """
    How a group of shapes is drawn: the colour of its bodies, and its opacity.

    Of a faint group only the bodies are drawn, and their lines have its colour too.
    """

    colour: Colour | None = None
    opacity: float = 1.0


GHOST: Final = DrawingStyle(PATH, 0.35)
GOAL: Final = DrawingStyle(_PAINT['goal'], 0.45)


class Solids(NamedTuple):
    """
    Copies of a unit shape.

    `places` (n, 3) and `sizes` (n, 3) [m], `rotations` (n, 4) wxyz, `colours` (n, 3); `groups`
    (n,) are the groups of shapes that they are of.
    """

    places: Array
    rotations: Array
    sizes: Array
    colours: NDArray[np.int_]
    groups: NDArray[np.int_]


class Picture(NamedTuple):
    """Solids by kind and opacity; the ends (n, 2, 3) [m] of thin lines, with their colours."""

    solids: dict[Kind, Solids]
    lines: Array
    line_colours: NDArray[np.uint8]


def picture(
    groups: Iterable[tuple[Sequence[Shape], DrawingStyle]],
    width: float,
    paths: Iterable[tuple[Array, Colour]] = (),
) -> Picture:
    """Return the solids of groups of shapes, and ways (n, 2 or 3) as lines; `width` is in m."""
    copies: dict[Kind, list[tuple[Any, ...]]] = {}
    thin = [(in_space(way), colour) for way, colour in paths]
    for group, (shapes, look) in enumerate(groups):
        faint = look.opacity < 1.0
        for shape in shapes:
            body = shape.style == 'body'
            if faint and not body:
                continue
            coloured = body and (faint or not isinstance(shape, Line))
            paint = (look.colour if coloured else None) or _PAINT[shape.style]
            points, opacity = in_space(points_of(shape, 1)[0]), look.opacity
            if not isinstance(shape, Line):
                opacity *= _CLEAR.get(shape.style, 1.0)
                kind, *placed = _solid(shape, width * _FLAT.get(shape.style, 1.0))
                copies.setdefault((kind, opacity), []).append((*placed, paint, group))
            elif shape.style in _THICK:
                thick = width * _THICK[shape.style]
                tubes = [(*_tube(*ends, thick), paint, group) for ends in pairwise(points)]
                copies.setdefault(('cylinder', opacity), []).extend(tubes)
            else:
                thin.append((points, paint))
    lines = [np.stack([points[:-1], points[1:]], axis=1) for points, _ in thin]
    paints = [np.full((len(points) - 1, 2, 3), paint) for points, paint in thin]
    return Picture(
        {kind: Solids(*map(np.array, zip(*found, strict=True))) for kind, found in copies.items()},
        np.concatenate([np.zeros((0, 2, 3)), *lines]),
        np.concatenate([np.zeros((0, 2, 3)), *paints]).astype(np.uint8),
    )


def _solid(shape: Disc | Box, height: float) -> tuple[str, Array, Rotation, Sequence[float]]:
    place = in_space(way_of(shape, 1)[0])
    if isinstance(shape, Box):
        turn = SO3.from_z_radians(float(np.asarray(shape.turn)))
        return 'box', place, turn.wxyz, [*shape.size, height][:3]
    flat, radius = len(shape.centre) == 2, shape.radius
    kind, high = ('cylinder', height) if flat else ('ball', radius)
    return kind, place, SO3.identity().wxyz, [radius, radius, high]


def _tube(first: Array, last: Array, radius: float) -> tuple[Array, Rotation, Sequence[float]]:
    """Return place, rotation and size of the unit cylinder between two points."""
    way = last - first
    length = float(np.linalg.norm(way))
    return 0.5 * (first + last), along(way), [radius, radius, length]


def along(way: Array) -> Rotation:
    """Return a rotation after which z lies along a way (3,), in either sense."""
    x, y, z = -way if way[2] < 0.0 else way
    half = np.array([np.linalg.norm(way) + z, -y, x, 0.0])
    return half / np.linalg.norm(half) if half.any() else SO3.identity().wxyz


class View(NamedTuple):
    """Where the camera stands, what it looks at, and the size of what is drawn [m]."""

    camera: Array
    target: Array
    size: float

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
    return View(target + size * np.array(away), target, size)
