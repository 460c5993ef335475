# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Random crossings of n robots into a formation: the family on which the planner is measured."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.problems import RobotFormation

MINIMUM_SEPARATION = 0.4
ARRIVAL_INTERVAL = 4.0
MISMATCH = 0.05  # of plants that are not their trackers' models
HELD_ANGLE, DISK_ANGLE = 0.05, 2.0  # rad
ARRIVED = 0.02  # m
SLOW_RIG: dict[str, Any] = {
    'plant.mass': 10.5,
    'plant.inertia': 0.063,
    'limits.thrust': 0.315,
    'limits.torque': 0.00189,
    'limits.thruster_rate': 0.5,
    'arena.minimum_separation': MINIMUM_SEPARATION,
    'arrival_interval': ARRIVAL_INTERVAL,
    'weights.time': 0.015,
    'weights.sequence': 0.015,
    'weights.gas': 0.97,
}
RIGS: dict[str, dict[str, Any]] = {
    'quick robots': {'limits.thrust': 1.05, 'limits.thruster_rate': 2.0, 'limits.torque': 0.02},
    'air bearing': {},
}


@dataclass(frozen=True)
class Crossing:
    """
    Starts at rest and goals: positions (n, 2) m, yaw (n,) rad, in a square arena of `side` m.

    The goals are `anchor` [x, y, yaw] and `offsets` (n, 2) in the anchor's frame.
    """

    side: float
    start: Array
    start_yaw: Array
    goal: Array
    anchor: Array
    offsets: Array

    @property
    def names(self) -> list[str]:
        """Names of the robots, in the order of arrival."""
        return [f'robot{i + 1}' for i in range(len(self.start))]

    def parameters(self, **changes: Any) -> dict[str, Any]:
        """Return the parameters of `robot_formation` on the slow air-bearing rig."""
        values = SLOW_RIG | {
            'robots': self.names,
            'arena.length': self.side,
            'arena.width': self.side,
            'formation.anchor': self.anchor.tolist(),
        }
        for i, name in enumerate(self.names):
            values[f'{name}.start.x'] = float(self.start[i, 0])
            values[f'{name}.start.y'] = float(self.start[i, 1])
            values[f'{name}.start.yaw'] = float(self.start_yaw[i])
            values[f'formation.{name}'] = [*self.offsets[i].tolist(), 0.0]
        return values | changes


def crossing(seed: int, n: int = 3) -> Crossing:
    """
    Draw starts and goals until straight, simultaneous motions would collide.

    Starts are uniform, .3 m from the walls and two separations apart; goals are a polygon (n <= 3)
    or a grid of spacing .65 to .9 m, turned and placed at random, dealt out at random.
    """
    rng = np.random.default_rng(seed)
    side = 4.0 * max(1.0, math.sqrt(n / 3.0))
    while True:
        start = _starts(rng, n, side)
        shape = _shape(rng, n)
        turn = rng.uniform(0.0, 2.0 * np.pi)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        centre = rng.uniform(0.25 * side, 0.75 * side, 2)
        offsets = shape[rng.permutation(n)]
        goal = centre + offsets @ rotation.T
        inside = goal.min() >= 0.25 and goal.max() <= side - 0.25
        far = np.linalg.norm(goal - start, axis=1).min() >= 0.8
        if inside and far and (n == 1 or _collide(start, goal)):
            break
    return Crossing(
        side=side,
        start=start,
        start_yaw=rng.uniform(-np.pi, np.pi, n),
        goal=goal,
        anchor=np.array([*centre, turn]),
        offsets=offsets,
    )


def crossing_of(rig: str, seed: int, **changes: Any) -> RobotFormation:
    """Return the crossing of a seed by three robots of one of the `RIGS`."""
    return RobotFormation.from_parameters(crossing(seed).parameters(**RIGS[rig], **changes))


def _starts(rng: np.random.Generator, n: int, side: float) -> Array:
    found: list[Array] = []
    while len(found) < n:
        point = rng.uniform(0.3, side - 0.3, 2)
        if all(np.linalg.norm(point - other) > 2 * MINIMUM_SEPARATION for other in found):
            found.append(point)
    return np.array(found)


def _shape(rng: np.random.Generator, n: int) -> Array:
    spacing = rng.uniform(0.65, 0.9)
    if n <= 3:
        angle = np.arange(n) * 2 * np.pi / n
        radius = {1: 0.0, 2: spacing / 2, 3: spacing / math.sqrt(3)}[n]
        return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    columns = math.ceil(math.sqrt(n))
    grid = spacing * np.array([(i % columns, i // columns) for i in range(n)], dtype=float)
    return np.asarray(grid - grid.mean(axis=0))


def _collide(start: Array, goal: Array) -> bool:
    """Whether straight motions with a quintic law of time come within .8 of the separation."""
    n = len(start)
    arrival = 30.0 + ARRIVAL_INTERVAL * np.arange(n)
    s = np.minimum(1.0, np.linspace(0.0, arrival[-1], 400) / arrival[:, None])
    share = 10 * s**3 - 15 * s**4 + 6 * s**5
    path = start[:, None] + share[..., None] * (goal - start)[:, None]
    i, j = np.triu_indices(n, 1)
    nearest = np.linalg.norm(path[i] - path[j], axis=-1).min()
    return bool(nearest <= 0.8 * MINIMUM_SEPARATION)
