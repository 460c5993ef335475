# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Distances between the robots at equal times (19), and from what stands still in the arena.

Motions are sampled at common instants; between two instants the nearest approach is where the
chords of the motions are nearest, and there the distance and its gradient are taken exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


_MOST_INSTANTS = 4000


class PairApproaches(NamedTuple):
    """
    Near approaches of two robots: index of the pair (r,) and instant [s] (r,).

    `margins` (r,) are distance / clearance - 1, `unit` (r, 2) points from the second to the first.
    """

    pair: Indices
    time: Array
    margins: Array
    unit: Array


class CircleApproaches(NamedTuple):
    """
    Near approaches of a robot to a circle: robot, circle and arc (r,).

    `margins` (r,) are distance / clearance - 1, `unit` (r, 2) points from the circle's centre.
    """

    robot: Indices
    circle: Indices
    arc: Array
    margins: Array
    unit: Array


class PairSeparation:
    """
    Rows for all pairs of moving robots that come near one another.

    `interval` [s] between common instants; approaches nearer than (1 + `near`) clearances count.
    """

    def __init__(self, model: ReferenceMotion, interval: float, near: float) -> None:
        self.model, self.interval, self.near = model, interval, near
        moving = np.flatnonzero(~model.task.staying)
        first, second = np.triu_indices(moving.size, 1)
        self.first, self.second = moving[first], moving[second]
        self.clearances = model.task.pair_clearances(self.first, self.second)

    def nearest(self, motion: FormationMotion) -> PairApproaches:
        """Find the near approaches."""
        if not self.first.size:
            return self.at(motion, np.zeros(0, dtype=np.intp), np.zeros(0))
        last = float((motion.durations + self.model.task.coast).max())
        # A motion far longer than this time scale keeps the number of instants, not the interval.
        interval = max(self.interval, last / _MOST_INSTANTS)
        t: Array = interval * np.arange(int(np.ceil(last / interval)) + 1.0)
        position = self.model.position_at(motion, t)
        share, distance = _nearest_on_chords(position[self.first] - position[self.second])
        pair, k = np.nonzero(distance < (1.0 + self.near) * self.clearances[:, None])
        return self.at(motion, pair, (k + share[pair, k]) * interval)

    def at(self, motion: FormationMotion, pair: Indices, t: Array) -> PairApproaches:
        """Distances of the pairs (r,) at the instants t (r,) s."""
        both = np.concatenate([self.first[pair], self.second[pair]])
        positions = self._positions(motion, both, np.tile(t, 2))
        first, second = np.split(positions, [t.size])
        apart = first - second
        distance = np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        margins = distance / self.clearances[pair] - 1.0
        return PairApproaches(pair, t, margins, apart / distance[:, None])

    def robots(self, near: PairApproaches) -> tuple[Indices, Indices]:
        """Return both robots of every approach."""
        return self.first[near.pair], self.second[near.pair]

    def _positions(self, motion: FormationMotion, robots: Indices, t: Array) -> Array:
        values = self.model.values(self.model.arcs(motion, robots, t))
        value = (motion.position[robots] @ values[..., None])[..., 0]
        early = np.minimum(t - self.model.task.coast[robots], 0.0)
        return np.asarray(value + self.model.task.velocity[robots] * early[:, None])

    def rows(self, motion: FormationMotion, near: PairApproaches) -> Array:
        """Margins of the near approaches differentiated with respect to Z (r, n, P)."""
        count = np.arange(near.pair.size)
        jacobian = np.zeros((near.pair.size, self.model.task.n, self.model.size))
        direction = near.unit / self.clearances[near.pair, None]
        robots = self.robots(near)
        both = np.concatenate(robots)
        s = self.model.arcs(motion, both, np.tile(near.time, 2))
        _, slopes = self.model.points(motion, both, s, at_fixed_time=True)
        first, second = np.split(slopes, [count.size])
        jacobian[count, robots[0]] = np.einsum('rd,rdp->rp', direction, first)
        jacobian[count, robots[1]] = -np.einsum('rd,rdp->rp', direction, second)
        return jacobian


class CircleSeparation:
    """Rows for moving robots near circles that stand still: keep-out zones and staying robots."""

    def __init__(self, model: ReferenceMotion, segments: int, near: float) -> None:
        self.model, self.near = model, near
        self.centres, self.clearances = model.task.circles()
        self.moving = np.flatnonzero(~model.task.staying)
        self.arcs = np.linspace(0.0, 1.0, segments + 1)
        self.values = model.values(self.arcs)

    def nearest(self, motion: FormationMotion) -> CircleApproaches:
        """Find the near approaches."""
        if not self.centres.size or not self.moving.size:
            none = np.zeros(0, dtype=np.intp)
            return CircleApproaches(none, none, np.zeros(0), np.zeros(0), np.zeros((0, 2)))
        position = motion.position[self.moving] @ self.values.T
        apart = position[:, None] - self.centres[None, :, :, None]
        flat = apart.reshape(-1, 2, self.arcs.size)
        share, distance = _nearest_on_chords(flat)
        shape = (self.moving.size, len(self.centres), self.arcs.size - 1)
        limit = (1.0 + self.near) * self.clearances[self.moving]
        robot, circle, k = np.nonzero(distance.reshape(shape) < limit[..., None])
        s = (k + share.reshape(shape)[robot, circle, k]) / (self.arcs.size - 1)
        return self.at(motion, self.moving[robot], circle, s)

    def at(
        self, motion: FormationMotion, robot: Indices, circle: Indices, s: Array
    ) -> CircleApproaches:
        """Distances of robots (r,) from circles (r,) at the arcs s (r,)."""
        position = (motion.position[robot] @ self.model.values(s)[..., None])[..., 0]
        apart = position - self.centres[circle]
        distance = np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        margins = distance / self.clearances[robot, circle] - 1.0
        return CircleApproaches(robot, circle, s, margins, apart / distance[:, None])

    def rows(self, motion: FormationMotion, near: CircleApproaches) -> Array:
        """Margins of the near approaches differentiated with respect to Z (r, n, P)."""
        jacobian = np.zeros((near.robot.size, self.model.task.n, self.model.size))
        direction = near.unit / self.clearances[near.robot, near.circle, None]
        _, slope = self.model.points(motion, near.robot, near.arc, at_fixed_time=False)
        jacobian[np.arange(near.robot.size), near.robot] = np.einsum(
            'rd,rdp->rp', direction, slope
        )
        return jacobian


def _nearest_on_chords(apart: Array) -> tuple[Array, Array]:
    """Nearest points to the origin on the chords of `apart` (p, 2, K): shares and distances."""
    begin, chord = apart[:, :, :-1], np.diff(apart, axis=2)
    along = -(begin * chord).sum(axis=1)
    share = np.clip(along / ((chord * chord).sum(axis=1) + 1e-12), 0.0, 1.0)
    nearest = begin + share[:, None] * chord
    return share, np.sqrt((nearest * nearest).sum(axis=1))
