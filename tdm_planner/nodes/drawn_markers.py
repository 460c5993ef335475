# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A plant of the user's own as markers: the shapes of its `drawing`, in motion and of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from tdm_planner.drawing import Box, Disc, points_of, Shape
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes import markers
from tdm_planner.nodes.markers import LIFETIME, Pen, to_quaternion, Trail
from tdm_planner.plant_kind import WORLD_FRAME
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_planner.trajectory import Trajectory
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]

TRAIL = 2.0  # s
LONGEST_PATH = 300  # points

_SPACING = 0.02  # s between places of a trail
_WIDTH = 0.012  # of lines, as a share of the drawing's size
_COLOURS = {
    'body': markers.DARK,
    'limit': markers.RED,
    'reach': markers.AMBER,
    'goal': markers.GREEN,
    'force': markers.BLUE,
}


def has_drawing(problem: type[DirectProblem]) -> bool:
    """Whether a problem says what its plant looks like."""
    return problem.drawing is not DirectProblem.drawing


def drawn(problem: DirectProblem, states: Array) -> Sequence[Shape]:
    """
    Return the shapes in states (nx,) or (n, nx).

    Raises
    ------
    InvalidProblem
        If `drawing` fails, or gives something else.

    """
    try:
        shapes = list(problem.drawing(list(states.T)))
        for shape in shapes:
            points_of(shape, 1 if states.ndim == 1 else len(states))
    except Exception as error:  # noqa: B902
        # Whatever the user's function raises, a picture is not worth the node.
        text = ' '.join(str(error).split())
        raise InvalidProblem(f'drawing fails with {type(error).__name__}: {text}') from error
    return shapes


class DrawnPicture:
    """
    A plant in motion: `add` states to the trails, `draw` as often as it is to be shown.

    Namespaces are the styles of the shapes, and `trail`; numbers are places in the drawing.
    """

    def __init__(self, problem: DirectProblem, start: Array) -> None:
        self._problem = problem
        shapes = drawn(problem, start)
        self._width = _WIDTH * _size(shapes)
        self._trails = {k: Trail(TRAIL, _SPACING) for k, s in enumerate(shapes) if s.trail}

    def add(self, instant: int, state: Array) -> None:
        """Lengthen the trails by the places in a state (nx,) at an instant [ns]."""
        shapes = drawn(self._problem, state)
        for number, trail in self._trails.items():
            trail.add(instant, *_followed(shapes[number], 1)[0].tolist())

    def clear(self) -> None:
        """Forget the trails, where the plant did not move but was put elsewhere."""
        for trail in self._trails.values():
            trail.clear()

    def draw(
        self, stamp: Time, state: Array, control: Array, lifetime: float = LIFETIME
    ) -> MarkerArray:
        """Return the plant in a state (nx,), visible for `lifetime` [s]."""
        pen = Pen(WORLD_FRAME, stamp, lifetime)
        shown = [
            _marker(pen, number, shape, self._width)
            for number, shape in enumerate(drawn(self._problem, state))
        ]
        for number, trail in self._trails.items():
            points = trail.points
            if len(points) > 1:
                shown.append(pen.line('trail', number, points, markers.GREY, 0.5 * self._width))
        return MarkerArray(markers=shown)


def drawn_plan(problem: DirectProblem, plan: Trajectory) -> MarkerArray:
    """Draw a plan: the ways of what has trails, and the plant at the end; the last one goes."""
    thin = np.linspace(0, plan.times.size - 1, min(LONGEST_PATH, plan.times.size)).astype(int)
    pen, moving = Pen(WORLD_FRAME), drawn(problem, plan.states[thin])
    end = drawn(problem, plan.states[-1])
    width = _WIDTH * _size(end)
    shown = [pen.delete_all()]
    for number, (shape, last) in enumerate(zip(moving, end, strict=True)):
        if shape.trail:
            path = markers.points_of(_followed(shape, thin.size))
            shown.append(pen.line('planned_path', number, path, markers.BLUE, 0.5 * width))
        if shape.style == 'body':
            goal = _marker(pen, number, replace(last, style='goal'), width)
            shown.append(goal)
    return MarkerArray(markers=shown)


def _followed(shape: Shape, count: int) -> Array:
    """Return where the end of a line, or a centre, is at `count` instants, (count, 3)."""
    points = points_of(shape, count)
    places = points.mean(axis=1) if isinstance(shape, Box) else points[:, -1]
    return np.pad(places, ((0, 0), (0, 3 - places.shape[1])))


def _size(shapes: Sequence[Shape]) -> float:
    """Return the largest extent of shapes in one state [m]."""
    corners = [point for shape in shapes for point in points_of(shape, 1)[0][:, :2]]
    radii = [shape.radius for shape in shapes if isinstance(shape, Disc)]
    extents = np.ptp(corners, axis=0).tolist() if corners else []
    return float(max([1e-3, *radii, *extents]))


def _marker(pen: Pen, number: int, shape: Shape, width: float) -> Marker:
    colour: ColorRGBA = _COLOURS[shape.style]
    if isinstance(shape, Disc):
        (centre,) = points_of(shape, 1)[0].tolist()
        ball = [2.0 * shape.radius] * 3
        if len(centre) == 3:
            return pen.solid(shape.style, number, Marker.SPHERE, colour, ball, centre)
        return pen.solid(shape.style, number, Marker.CYLINDER, colour, [*ball[:2], width], centre)
    if isinstance(shape, Box):
        size = [*map(float, shape.size), width][:3]
        turned = to_quaternion(math.remainder(float(np.asarray(shape.turn)), math.tau))
        centre = [float(np.asarray(part)) for part in shape.centre]
        return pen.solid(shape.style, number, Marker.CUBE, colour, size, centre, turned)
    points = markers.points_of(points_of(shape, 1)[0])
    return pen.line(shape.style, number, points, colour, width)
