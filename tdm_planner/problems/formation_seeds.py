# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
First guesses: quintic motions bowed to either side, screened by how near the robots come.

First guesses decide on which side robots pass one another, which local minimum is found.
"""

from __future__ import annotations

from collections.abc import Iterator
import itertools

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bases import PolynomialBasis, PowerProducts
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.reference_motion import ReferenceMotion

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

BOWS = np.array([0.1, -0.1, 0.22, -0.22])
_EXHAUSTIVE = 5000  # combinations of bows up to which all are screened
_GAS_OF_A_MOVE = 2.4  # gas of a typical motion, in distances over time
_INSTANTS = 40
_TRIES = 12
_SWEEPS = 6  # of a coordinate descent, at most


def first_arrival(task: FormationTask) -> float:
    """Arrival time of the first robot [s] that a rough estimate of (28) prefers."""
    way = np.linalg.norm(task.goal - task.departure, axis=1)
    turn = np.abs(task.goal_yaw - task.departure_yaw)
    speed = np.linalg.norm(task.velocity, axis=1)
    later = task.interval * np.arange(task.n) - task.coast
    quickest = np.sqrt(6.5 * way / task.thrust) + 2 * speed / task.thrust
    quickest = np.maximum(quickest, np.sqrt(6.5 * turn / task.torque))
    quickest = np.maximum(quickest, 4 * np.abs(task.yaw_rate) / task.torque)
    least = max(float((quickest - later).max()), 0.5)
    times = np.linspace(least, max(task.longest, 1.01 * least), 300)
    gas = (_GAS_OF_A_MOVE * way[:, None] / np.maximum(times + later[:, None], 0.5)).sum(axis=0)
    estimate = task.weights[0] * times + task.weights[2] * gas
    return float(times[np.argmin(estimate)])


def combined(
    single: Array, pair: Array, begin: Indices, tries: int, rng: np.random.Generator
) -> Indices:
    """
    Return combinations (m, n) of what every robot may choose, the cheapest first.

    `single` (n, c) is the cost of each robot's choices, `pair` (n, n, c, c) what a choice of one
    robot and a choice of another cost together. All of them, where they are not too many; else
    those to `begin` with (k, n), and others by coordinate descent from `tries` random ones.
    """
    n, c = single.shape
    if c**n <= _EXHAUSTIVE:
        every = np.array(list(itertools.product(range(c), repeat=n)))
    else:
        drawn = (np.asarray(rng.integers(0, c, n), dtype=np.intp) for _ in range(tries))
        every = np.array([*begin, *(_descended(single, pair, choice, rng) for choice in drawn)])
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


class BowSeeds:
    """First guesses for a model: every robot's motion bowed by a share of its way."""

    def __init__(self, model: ReferenceMotion, rng: np.random.Generator) -> None:
        self.model, self.rng = model, rng
        task = model.task
        first = first_arrival(task)
        arrivals = first + task.interval * np.arange(task.n)
        self.durations = np.minimum(
            np.maximum(arrivals - task.coast, 0.3 * first), 0.98 * task.longest
        )

    def bowed(self, bows: Array, s: Array, derivative: int = 0) -> Array:
        """Motions (n, c, 2, K) bowed by `bows` (n, c), or a derivative, at arcs s (n, K)."""
        task, model = self.model.task, self.model
        way = task.goal - task.departure
        conditions = np.stack(
            [task.departure, self.durations[:, None] * task.velocity, task.goal], axis=-1
        )
        quintic = PolynomialBasis.of((0, 1, 2), (0, 1, 2)).values(s, derivative)[..., [0, 1, 3]]
        straight = conditions @ np.swapaxes(quintic, 1, 2)
        normal = np.stack([-way[:, 1], way[:, 0]], axis=1)
        power = 2 if model.vary_ends or model.order < 7 else 3
        # One in the middle of the arc.
        bump = (-4.0) ** power * PowerProducts(((power, power),)).values(s, derivative)[..., 0]
        side = bows[..., None, None] * normal[:, None, :, None] * bump[:, None, None]
        return np.asarray(straight[:, None] + side)

    def fit(self, bows: Array) -> Array:
        """Scaled varied parameters (n, P) of motions nearest to those bowed by `bows` (n,)."""
        b = np.repeat(self.durations[:, None], self.model.nb, axis=1)

        def bend(s: Array) -> Array:
            return self.bowed(bows[:, None], np.broadcast_to(s, (len(b), s.size)), 2)[:, 0]

        return self.model.fit(b, bend)

    def __iter__(self) -> Iterator[Array]:
        """Screened guesses, best first, on distinct sides; then random bows without end."""
        choices = self._screened()
        for choice in choices:
            yield self.fit(BOWS[choice])
        while True:
            yield self.fit(self.rng.uniform(-0.35, 0.35, self.model.task.n))

    def _screened(self) -> list[Indices]:
        n = self.model.task.n
        begin = np.tile(np.arange(2)[:, None], n)
        every = combined(*self._tables(), begin, _TRIES, self.rng)
        moving = ~self.model.task.staying
        _, first = np.unique((BOWS[every] > 0)[:, moving], axis=0, return_index=True)
        return list(every[np.sort(first)])

    def _tables(self) -> tuple[Array, Array]:
        """Badness of every robot's bow (n, c) and of every two robots' bows (n, n, c, c)."""
        task = self.model.task
        n, c = task.n, len(BOWS)
        t = np.linspace(0.0, (self.durations + task.coast).max(), _INSTANTS)
        s = np.clip((t - task.coast[:, None]) / self.durations[:, None], 0.0, 1.0)
        path = self.bowed(np.broadcast_to(BOWS, (n, c)), s)
        reach = task.separation / 2
        outside = np.maximum(reach - path, path - task.sides[:, None] + reach).max(axis=(2, 3))
        single = 0.75 * np.abs(BOWS) * task.separation + 3 * np.maximum(outside, 0.0)
        centres, clearances = task.circles()
        if len(centres):
            apart = np.linalg.norm(path[:, :, None] - centres[:, :, None], axis=3).min(axis=-1)
            single += 3 * np.maximum(clearances[:, None] - apart, 0.0).sum(axis=-1)
        pair = np.zeros((n, n, c, c))
        for i, j in itertools.combinations(range(n), 2):
            apart = np.linalg.norm(path[i][:, None] - path[j][None], axis=2).min(axis=-1)
            pair[i, j] = 3 * np.maximum(task.separation - apart, 0.0)
            pair[j, i] = pair[i, j].T
        return single, pair
