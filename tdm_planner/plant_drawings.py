# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What the pendulum and a robot look like: shapes in any of their states, and what is around them.

Markers, report and pictures draw them, as they draw the `drawing` of a stated problem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, Final, Protocol

import numpy as np
from tdm_planner.drawing import Disc, Line, Shape
from tdm_planner.plant_kind import PENDULUM, PlantKind, ROBOT
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

Components = Mapping[str, Any]  # states or controls by name, numbers or (n,) each

_ARC = 60  # parts that an arc is drawn in
_BODY: Final = 0.62  # of the safety radius that a robot's body is drawn with


class Drawn(Protocol):
    """A plant that has a picture."""

    @property
    def kind(self) -> PlantKind:
        """Return its states and controls."""

    def drawing(self, x: Components, u: Components) -> Sequence[Shape]:
        """Return what the plant looks like in states `x`, under controls `u`."""

    def surroundings(self) -> Sequence[Shape]:
        """Return what stands still around it."""


@dataclass(frozen=True)
class PendulumDrawing:
    """
    The rotary pendulum in the frame `world`; its rod is uniform.

    `torque` is the largest [N m], `disk_angle` how far the disk may turn [rad].
    """

    plant: RotaryPendulum
    torque: float = 1.0
    disk_angle: float = math.pi
    kind = PENDULUM

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

    def surroundings(self) -> Sequence[Shape]:
        """Disk, and how far the arm may turn."""
        radius, reach = self.plant.arm_length, min(self.disk_angle, math.pi)
        disk, stops = _arc(radius, math.pi), _arc(1.15 * radius, reach)
        return [Line(disk, 'reach'), Line(stops, 'limit')]


def _arc(radius: float, reach: float) -> list[tuple[float, float, float]]:
    angles = np.linspace(-reach, reach, _ARC)
    return [(radius * math.cos(a), radius * math.sin(a), 0.0) for a in angles]


@dataclass(frozen=True)
class RobotDrawing:
    """
    A floating robot in the frame `arena`; the jet of its thruster is drawn against the force.

    `separation` is the distance [m] that robots keep, None where it is not known; `radius` that of
    the body [m], by default a share of it; `thrust` is the largest [N].
    """

    separation: float | None = None
    thrust: float = 1.0
    radius: float = 0.0
    kind = ROBOT

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

    def surroundings(self) -> Sequence[Shape]:
        """Nothing: the arena is that of all robots, see `arena_drawing`."""
        return ()


def arena_drawing(
    length: float, width: float, separation: float, zones: Sequence[Sequence[float]]
) -> Sequence[Shape]:
    """Return walls, what the robots' centres keep from them, and the zones (x, y, radius)."""
    inner = separation / 2
    walls = Line(_rectangle(0.0, 0.0, length, width))
    kept = Line(_rectangle(inner, inner, length - inner, width - inner), 'limit')
    return [walls, kept, *(Disc((x, y), r, 'limit') for x, y, r in zones if r > 0.0)]


def _rectangle(left: float, low: float, right: float, high: float) -> list[tuple[float, float]]:
    return [(left, low), (right, low), (right, high), (left, high), (left, low)]
