# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A formation of another size: fewer robots than a parameter file names, or more."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.problems.formation.parameters import (
    Arena,
    DEFAULT_ROBOTS,
    formation_specifications,
    FormationParameters,
)

Array = NDArray[np.float64]

MOST_ROBOTS = 100
_CLEARANCE = 1.5  # of two places, in units of minimum_separation
_GRID = 40  # candidate places along the longer side of the arena


def resized(values: Mapping[str, Any], number: int) -> dict[str, Any]:
    """
    Return the parameters by dotted name that make a formation one of `number` robots.

    The first ones that `values` (by dotted name) names in `robots` take part. Where more are
    wanted, robot4, robot5, ... are added: each starts as far as possible from all others, facing
    the formation, and takes the free place in it that is nearest to the anchor.

    Raises
    ------
    InvalidProblem
        If the number is not in [1, 100], or the arena has no room for so many.

    """
    if not 1 <= number <= MOST_ROBOTS:
        raise InvalidProblem(
            f'number_of_robots = {number} is not allowed: must be in [1, {MOST_ROBOTS}]'
        )
    specs = formation_specifications(values)
    names = list(values.get('robots', DEFAULT_ROBOTS))[:number]
    changed: dict[str, Any] = {}
    if len(names) < number:
        numbered = (f'robot{k}' for k in count(1))
        added = [next(n for n in numbered if n not in names) for _ in range(number - len(names))]
        given = {name: spec.check(values.get(name, spec.default)) for name, spec in specs.items()}
        changed = _places(build(FormationParameters, values), given, names, added)
        names += added
    return {'robots': names, **changed}


def _places(
    formation: FormationParameters, given: Mapping[str, Any], names: list[str], added: list[str]
) -> dict[str, Any]:
    """Return starts and places in the formation of the robots that are added."""
    free = _free_points(formation.arena)
    anchor = np.array(formation.formation.anchor)
    cosine, sine = np.cos(anchor[2]), np.sin(anchor[2])
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    known = [(given[f'{name}.start.x'], given[f'{name}.start.y']) for name in names]
    starts = [np.array(place) for place in known if None not in place]
    offsets = [given[f'formation.{name}'] for name in names]
    goals = [anchor[:2] + rotation @ offset[:2] for offset in offsets if offset is not None]
    least = _CLEARANCE * formation.arena.minimum_separation
    made: dict[str, Any] = {}
    for k, name in enumerate(added):
        room, open_points = _room(free, starts), free[_room(free, goals) >= least]
        if not len(open_points) or room.max() < least:
            raise InvalidProblem(
                f'number_of_robots = {len(names) + len(added)} is not allowed: there is room in '
                f'the arena for {len(names) + k} at the most'
            )
        starts.append(free[room.argmax()])
        goals.append(open_points[np.linalg.norm(open_points - anchor[:2], axis=1).argmin()])
        across = anchor[:2] - starts[-1]
        x, y = starts[-1].round(6).tolist()
        offset = (rotation.T @ (goals[-1] - anchor[:2])).round(6).tolist()
        made[f'{name}.start.x'], made[f'{name}.start.y'] = x, y
        made[f'{name}.start.yaw'] = round(float(np.arctan2(across[1], across[0])), 6)
        made[f'formation.{name}'] = [*offset, 0.0]
    return made


def _free_points(arena: Arena) -> Array:
    """Return points (n, 2) on which a robot keeps clear of walls and keep-out zones."""
    gap = arena.minimum_separation
    step = max(arena.length, arena.width) / _GRID
    x, y = (
        np.linspace(gap, side - gap, max(0, round((side - 2 * gap) / step) + 1))
        for side in (arena.length, arena.width)
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    zones = np.array(arena.obstacles).reshape(-1, 3)
    away = np.linalg.norm(points[:, None] - zones[:, :2], axis=2)
    return np.asarray(points[(away >= zones[:, 2] + gap).all(axis=1)])


def _room(points: Array, taken: list[Array]) -> Array:
    """Return the distances (n,) of points (n, 2) from the nearest place that is taken."""
    if not taken:
        return np.full(len(points), np.inf)
    return np.asarray(np.linalg.norm(points[:, None] - np.array(taken), axis=2).min(axis=1))
