# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Distances between the robots at equal times (19), and from what stands still in the arena.

Motions are sampled at common instants; between two instants the nearest approach is where the
chords of the motions are nearest, and there the distance and its gradient are taken exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.reference_motion import Motion, ReferenceMotion

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


_MOST_INSTANTS = 4000


class PairApproaches(NamedTuple):
    """Near approaches of two robots: index of the pair (r,) and instant [s] (r,).

    `margins` (r,) are distance / clearance - 1, `unit` (r, 2) points from the second to the first.
    """

    pair: Indices
    time: Array
    margins: Array
    unit: Array


class CircleApproaches(NamedTuple):
    """Near approaches of a robot to a circle: robot, circle and arc (r,).

    `margins` (r,) are distance / clearance - 1, `unit` (r, 2) points from the circle's centre.
    """

    robot: Indices
    circle: Indices
    arc: Array
    margins: Array
    unit: Array


class PairSeparation:
    """Rows for all pairs of moving robots that come near one another.

    `interval` [s] between common instants; approaches nearer than (1 + `near`) clearances count.
    """

    def __init__(self, model: ReferenceMotion, interval: float, near: float) -> None:
        self.model, self.interval, self.near = model, interval, near
        moving = np.flatnonzero(~model.task.staying)
        first, second = np.triu_indices(moving.size, 1)
        self.first, self.second = moving[first], moving[second]
        self.clearances = model.task.pair_clearances(self.first, self.second)

    def nearest(self, motion: Motion) -> PairApproaches:
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

    def at(self, motion: Motion, pair: Indices, t: Array) -> PairApproaches:
        """Distances of the pairs (r,) at the instants t (r,) s."""
        apart = self._positions(motion, self.first[pair], t)
        apart = apart - self._positions(motion, self.second[pair], t)
        distance = np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        margins = distance / self.clearances[pair] - 1.0
        return PairApproaches(pair, t, margins, apart / distance[:, None])

    def robots(self, near: PairApproaches) -> tuple[Indices, Indices]:
        """Return both robots of every approach."""
        return self.first[near.pair], self.second[near.pair]

    def _arcs(self, motion: Motion, robots: Indices, t: Array) -> Array:
        if self.model.degree:
            return np.asarray(self.model.arc_at(motion, t)[robots, np.arange(t.size)])
        since = t - self.model.task.coast[robots]
        return np.asarray(np.clip(since / motion.rates[robots, 0], 0.0, 1.0))

    def _positions(self, motion: Motion, robots: Indices, t: Array) -> Array:
        s = self._arcs(motion, robots, t)
        monomials = s[:, None] ** np.arange(self.model.order + 1)
        value = (motion.position[robots] @ monomials[..., None])[..., 0]
        early = np.minimum(t - self.model.task.coast[robots], 0.0)
        return np.asarray(value + self.model.task.velocity[robots] * early[:, None])

    def rows(self, motion: Motion, near: PairApproaches) -> Array:
        """Margins of the near approaches differentiated with respect to Z (r, n, P)."""
        count = np.arange(near.pair.size)
        jacobian = np.zeros((near.pair.size, self.model.task.n, self.model.size))
        direction = near.unit / self.clearances[near.pair, None]
        for sign, robots in zip((1.0, -1.0), self.robots(near), strict=True):
            s = self._arcs(motion, robots, near.time)
            _, slope = self.model.points(motion, robots, s, at_fixed_time=True)
            jacobian[count, robots] = sign * np.einsum('rd,rdp->rp', direction, slope)
        return jacobian


class CircleSeparation:
    """Rows for moving robots near circles that stand still: keep-out zones and staying robots."""

    def __init__(self, model: ReferenceMotion, segments: int, near: float) -> None:
        self.model, self.near = model, near
        self.centres, self.clearances = model.task.circles()
        self.moving = np.flatnonzero(~model.task.staying)
        self.arcs = np.linspace(0.0, 1.0, segments + 1)
        self.monomials = self.arcs[:, None] ** np.arange(model.order + 1)

    def nearest(self, motion: Motion) -> CircleApproaches:
        """Find the near approaches."""
        if not self.centres.size or not self.moving.size:
            none = np.zeros(0, dtype=np.intp)
            return CircleApproaches(none, none, np.zeros(0), np.zeros(0), np.zeros((0, 2)))
        position = motion.position[self.moving] @ self.monomials.T
        apart = position[:, None] - self.centres[None, :, :, None]
        flat = apart.reshape(-1, 2, self.arcs.size)
        share, distance = _nearest_on_chords(flat)
        shape = (self.moving.size, len(self.centres), self.arcs.size - 1)
        limit = (1.0 + self.near) * self.clearances[self.moving]
        robot, circle, k = np.nonzero(distance.reshape(shape) < limit[..., None])
        s = (k + share.reshape(shape)[robot, circle, k]) / (self.arcs.size - 1)
        return self.at(motion, self.moving[robot], circle, s)

    def at(self, motion: Motion, robot: Indices, circle: Indices, s: Array) -> CircleApproaches:
        """Distances of robots (r,) from circles (r,) at the arcs s (r,)."""
        monomials = s[:, None] ** np.arange(self.model.order + 1)
        position = (motion.position[robot] @ monomials[..., None])[..., 0]
        apart = position - self.centres[circle]
        distance = np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        margins = distance / self.clearances[robot, circle] - 1.0
        return CircleApproaches(robot, circle, s, margins, apart / distance[:, None])

    def rows(self, motion: Motion, near: CircleApproaches) -> Array:
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
