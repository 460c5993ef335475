# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Shapes that plants are drawn with, in the plane or in space: by markers, reports and pictures.

A point is a sequence of two or three components, x, y (and z, upwards) [m], each a number or an
array over instants: what draws one state draws a whole motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Point = Sequence[ArrayLike]
Style = Literal['body', 'limit', 'reach', 'goal', 'force']


@dataclass(frozen=True, eq=False)
class Line:
    """
    A line through points.

    `style` says what it is: a body, a limit, the reach that is to be kept clear, a goal, a force.
    With `trail` the way of its last point is drawn too.
    """

    points: Sequence[Point]
    style: Style = 'body'
    trail: bool = False


@dataclass(frozen=True, eq=False)
class Disc:
    """A disc, in space a ball, of `radius` m; with `trail` the way of its centre is drawn too."""

    centre: Point
    radius: float
    style: Style = 'body'
    trail: bool = False


@dataclass(frozen=True, eq=False)
class Box:
    """
    A box of `size` (length, width and, in space, height) m, turned by `turn` rad about z.

    With `trail` the way of its centre is drawn too.
    """

    centre: Point
    size: Sequence[float]
    turn: ArrayLike = 0.0
    style: Style = 'body'
    trail: bool = False


Shape = Line | Disc | Box

# Corners of a box, and the way along all of its edges: the lower face, then up, along and down.
_CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
_AROUND = (0, 1, 2, 3, 0)
_EDGES = (*_AROUND, 4, 5, 1, 5, 6, 2, 6, 7, 3, 7, 4)


def points_of(shape: Shape, count: int) -> Array:
    """
    Return the points of a shape at `count` instants, (count, k, 2 or 3).

    Those of a line, a disc's centre, or the way along all edges of a box.
    """
    if isinstance(shape, Line):
        return np.stack([_placed(point, count) for point in shape.points], axis=1)
    centre = _placed(shape.centre, count)[:, None]
    if isinstance(shape, Disc):
        return centre
    half = 0.5 * np.asarray(shape.size, dtype=float)
    corners = _CORNERS * half[:2]
    if half.size > 2:
        faces = [np.insert(corners, 2, side * half[2], axis=1) for side in (-1.0, 1.0)]
        corners = np.concatenate(faces)[list(_EDGES)]
    else:
        corners = corners[list(_AROUND)]
    turn = np.broadcast_to(np.asarray(shape.turn, dtype=float), count)[:, None]
    moved = centre + corners
    x, y = corners[:, 0], corners[:, 1]
    moved[..., 0] = centre[..., 0] + np.cos(turn) * x - np.sin(turn) * y
    moved[..., 1] = centre[..., 1] + np.sin(turn) * x + np.cos(turn) * y
    return moved


def _placed(point: Point, count: int) -> Array:
    """Return a point at every instant, (count, 2 or 3)."""
    parts = [np.broadcast_to(np.asarray(part, dtype=float), count) for part in point]
    return np.stack(parts, axis=-1)
