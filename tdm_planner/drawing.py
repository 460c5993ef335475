# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Shapes and colours that plants are drawn with, in the plane or in space, and our own plants' looks.

A point is a sequence of two or three components, x, y (and z, upwards) [m], each a number or an
array over instants: what draws one state draws a whole motion. Markers, reports and pictures draw
the pendulum and the robots as they draw the `drawing` of a stated problem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, ClassVar, Final, Literal, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plant_kind import PENDULUM, PlantKind, ROBOT
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

if TYPE_CHECKING:
    from tdm_planner.problems.formation.parameters import Arena

Point = Sequence[ArrayLike]
Style = Literal['body', 'limit', 'reach', 'goal', 'force']
Components = Mapping[str, Any]  # states or controls by name, numbers or (n,) each

# Told apart by people with any colour vision: after Okabe and Ito, darker where pale on white.
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#c05d94', '#9a7400', '#6f6fc8', '#5c7f8a', '#a0522d')
LIMIT = '#c43d3d'
SWITCH = '#8a8f98'
WAY = '#4682eb'  # of the only vehicle
STYLE_COLOURS: Mapping[Style, str] = {
    'body': '#424854', 'limit': LIMIT, 'reach': '#dea028', 'goal': '#18965a', 'force': '#eb5f1e',
}  # fmt: skip

_ARC = 60  # parts that an arc is drawn in
_BODY: Final = 0.62  # of the safety radius that a robot's body is drawn with


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour such as '#c43d3d'."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


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

    def __post_init__(self) -> None:
        """Raise InvalidProblem for a radius that depends on the states."""
        _check_constant('Disc.radius', [self.radius])


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

    def __post_init__(self) -> None:
        """Raise InvalidProblem for a size that depends on the states."""
        _check_constant('Box.size', self.size)


def _check_constant(what: str, values: Sequence[ArrayLike]) -> None:
    if any(np.ndim(value) for value in values):
        raise InvalidProblem(f'{what} must be constant: it cannot depend on the states')


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


def way_of(shape: Shape, count: int) -> Array:
    """Return where the last point of a line, or a centre, is at `count` instants, (n, 2 or 3)."""
    return _placed(shape.points[-1] if isinstance(shape, Line) else shape.centre, count)


def _placed(point: Point, count: int) -> Array:
    parts = [np.broadcast_to(np.asarray(part, dtype=float), count) for part in point]
    return np.stack(parts, axis=-1)


def in_space(points: Array) -> Array:
    """Return points (..., 2 or 3) in space; those of the plane are at height 0."""
    return np.pad(points, [(0, 0)] * (points.ndim - 1) + [(0, 3 - points.shape[-1])])


class Drawn:
    """
    What a plant looks like; this one has no picture.

    `surroundings` are what stands still around it. While it moves, its ways of the last `span` s
    are drawn.
    """

    kind: PlantKind
    surroundings: Sequence[Shape] = ()
    span: ClassVar[float] = 1.0

    def drawing(self, x: Components, u: Components) -> Sequence[Shape]:
        """Return what the plant looks like in states `x`, under controls `u`."""
        return ()

    def shapes(self, states: Array, controls: Array | None = None) -> Sequence[Shape]:
        """Return the drawing in states (nx,) or (n, nx), whose first are its own, and controls."""
        x = zip(self.kind.state_names, states.T, strict=False)
        u = () if controls is None else zip(self.kind.control_names, controls.T, strict=False)
        return self.drawing(dict(x), dict(u))


class DrawnPath(NamedTuple):
    """Planned states (n, nx) of a plant called `name`; a single one is its goal."""

    drawn: Drawn
    states: Array
    name: str = ''


class PendulumDrawing(Drawn):
    """
    The rotary pendulum in the frame `world`; its rod is uniform.

    `torque` is the largest [N m], `disk_angle` how far the disk may turn [rad].
    """

    kind = PENDULUM

    def __init__(
        self, plant: RotaryPendulum, torque: float = 1.0, disk_angle: float = math.pi
    ) -> None:
        self.plant, self.torque = plant, torque
        disk = _arc(plant.arm_length, math.pi)
        stops = _arc(1.15 * plant.arm_length, min(disk_angle, math.pi))
        self.surroundings = Line(disk, 'reach'), Line(stops, 'limit')

    def drawing(self, x: Components, u: Components) -> Sequence[Shape]:
        """Arm and rod; the torque as an arc from the arm onwards."""
        arm, rod = self.plant.arm_length, 2.0 * self.plant.com_distance
        c, s = np.cos(x['psi']), np.sin(x['psi'])
        across, up = rod * np.sin(x['theta']), rod * np.cos(x['theta'])
        pivot = (arm * c, arm * s, 0.0)
        tip = (arm * c - across * s, arm * s + across * c, up)
        shapes = [Line(((0.0, 0.0, 0.0), pivot)), Line((pivot, tip), trail=True)]
        if 'torque' in u:
            turn = np.nan_to_num(u['torque']) / self.torque * math.pi / 2
            angles = [x['psi'] + share * turn for share in np.linspace(0.0, 1.0, 9)]
            arc = [(0.6 * arm * np.cos(a), 0.6 * arm * np.sin(a), 0.0) for a in angles]
            shapes.append(Line(arc, 'force'))
        return shapes


def _arc(radius: float, reach: float) -> list[tuple[float, float, float]]:
    angles = np.linspace(-reach, reach, _ARC)
    return [(radius * math.cos(a), radius * math.sin(a), 0.0) for a in angles]


@dataclass(frozen=True)
class RobotDrawing(Drawn):
    """
    A floating robot in the frame `arena`; the jet of its thruster is drawn against the force.

    `separation` is the distance [m] that robots keep, None where it is not known; `radius` that of
    the body [m], by default a share of it; `thrust` is the largest [N].
    """

    separation: float | None = None
    thrust: float = 1.0
    radius: float = 0.0
    surroundings: Sequence[Shape] = ()
    kind = ROBOT
    span = 60.0

    def drawing(self, x: Components, u: Components) -> Sequence[Shape]:
        """Body and heading, the safety circle, and the jet."""
        half = (self.separation or 0.3) / 2
        body, centre = self.radius or _BODY * half, (x['x'], x['y'])
        ahead = (x['x'] + body * np.cos(x['yaw']), x['y'] + body * np.sin(x['yaw']))
        shapes: list[Shape] = [Disc(centre, body, trail=True), Line((centre, ahead))]
        if self.separation is not None:
            shapes.append(Disc(centre, half, 'reach'))
        if 'thrust' in u and 'alpha' in x:
            share = np.nan_to_num(u['thrust']) / self.thrust
            turn = x['yaw'] + x['alpha'] + math.pi
            far = body * (1.0 + 1.6 * share)
            jet = [(x['x'] + r * np.cos(turn), x['y'] + r * np.sin(turn)) for r in (body, far)]
            shapes.append(Line(jet, 'force'))
        return shapes


def arena_drawing(arena: Arena) -> Sequence[Shape]:
    """Return walls, what the robots' centres keep from them, and the zones to keep out of."""
    length, width, inner = arena.length, arena.width, arena.minimum_separation / 2
    walls = Line(_rectangle(0.0, 0.0, length, width))
    kept = Line(_rectangle(inner, inner, length - inner, width - inner), 'limit')
    return [walls, kept, *(Disc((x, y), r, 'limit') for x, y, r in arena.zones.tolist())]


def _rectangle(left: float, low: float, right: float, high: float) -> list[tuple[float, float]]:
    return [(left, low), (right, low), (right, high), (left, high), (left, low)]
