# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
First guesses: what every robot may choose, combined so that none comes too near another.

Which robot passes on which side of another decides which local minimum is found: of every set of
sides the combination that looks best is given, the most promising first.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.formation.program import FormationProgram

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

INSTANTS = 60  # at which the ways of choices are compared
_EXHAUSTIVE = 5000  # combinations of choices up to which all are screened
_TRIES = 30  # random combinations to begin with, where they are more
_SWEEPS = 6  # of a coordinate descent, at most


def screened(
    program: FormationProgram,
    paths: Array,
    single: Array,
    bows: Array,
    meeting: float,
    wanted: float,
    price: float,
    rng: np.random.Generator,
) -> Indices:
    """
    Return combinations (m, n) of choices, the best of every set of sides, the best set first.

    `paths` (n, c, K, 2) are the ways of every robot's choices at equal times, `single` (n, c)
    what they cost. A metre that robots are nearer than `wanted` clearances, or than they may to
    what stands still, costs `price`. Sides are those of robots that come within `meeting`
    clearances of one another, and the signs of `bows` (c,).
    """
    n, count = single.shape
    centres, reach = program.task.circles()
    apart = np.linalg.norm(paths[:, :, None] - centres[:, None], axis=-1).min(axis=-1)
    single = single + price * np.maximum(reach[:, None] - apart, 0.0).sum(axis=-1)
    pair, sides = np.zeros((2, n, n, count, count))
    couples = list(itertools.combinations(range(n), 2))
    for i, j in couples:
        clearance = program.clearances[i, j]
        if clearance == 0.0:
            continue
        nearest = np.zeros((count, count))
        _encounters(paths[i], paths[j], nearest, sides[i, j])
        sides[i, j] *= nearest < meeting * clearance
        pair[i, j] = price * np.maximum(wanted * clearance - nearest, 0.0)
        pair[j, i] = pair[i, j].T
    combinations = _combined(single, pair, rng)
    passed = np.zeros((len(combinations), len(couples)))
    for q, (i, j) in enumerate(couples):
        passed[:, q] = sides[i, j][combinations[:, i], combinations[:, j]]
    turned = np.sign(bows[combinations])[:, program.varied]
    _, first = np.unique(np.hstack([passed, turned]), axis=0, return_index=True)
    return combinations[np.sort(first)]


@compiled
def _encounters(one: Array, other: Array, nearest: Array, sides: Array) -> None:
    """Least distances (c, d) of paths (c, K, 2), (d, K, 2), and the sense in which they pass."""
    for c in range(len(one)):
        for d in range(len(other)):
            least, at = np.inf, 0
            for k in range(one.shape[1]):
                x, y = one[c, k, 0] - other[d, k, 0], one[c, k, 1] - other[d, k, 1]
                square = x * x + y * y
                if square < least:
                    least, at = square, k
            nearest[c, d] = np.sqrt(least)
            k = min(max(at, 1), one.shape[1] - 2)
            x, y = one[c, k] - other[d, k]
            u, v = one[c, k + 1] - other[d, k + 1] - one[c, k - 1] + other[d, k - 1]
            sides[c, d] = 1.0 if x * v - y * u > 0.0 else -1.0


def _combined(single: Array, pair: Array, rng: np.random.Generator) -> Indices:
    """
    Return combinations (m, n) of what every robot may choose, the cheapest first.

    `single` (n, c) is the cost of each robot's choices, `pair` (n, n, c, c) what a choice of one
    robot and a choice of another cost together. All of them, where they are not too many; else
    the first of all choices, and others by coordinate descent from random ones.
    """
    n, c = single.shape
    if c**n <= _EXHAUSTIVE:
        every = np.array(list(itertools.product(range(c), repeat=n)))
    else:
        drawn = (np.asarray(rng.integers(0, c, n), dtype=np.intp) for _ in range(_TRIES))
        descended = [_descended(single, pair, choice, rng) for choice in drawn]
        every = np.array([np.zeros(n, dtype=np.intp), *descended])
    total = single[np.arange(n), every].sum(axis=1)
    for i, j in itertools.combinations(range(n), 2):
        total += pair[i, j][every[:, i], every[:, j]]
    return np.asarray(every[np.argsort(total, kind='stable')])


def _descended(single: Array, pair: Array, choice: Indices, rng: np.random.Generator) -> Indices:
    """Improve what every robot chooses (n,), one robot at a time and in random order."""
    n = len(choice)
    for _ in range(_SWEEPS):
        before = choice.copy()
        for i in rng.permutation(n):
            cost = single[i] + pair[i, np.arange(n), :, choice].sum(axis=0)
            choice[i] = int(np.argmin(cost))
        if (choice == before).all():
            break
    return choice
