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

"""Motion of the rotary pendulum under arcs of constant torque: one, or many steered at a time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import os

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.pendulum_kernels import roll_arcs
from tdm_planner.plants.pendulum_steering import steer_arcs
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

Array = NDArray[np.float64]

# Sum of squares at which a start has arrived, and the effort spent on one.
ARRIVED = 1e-12
_TARGET = 1e-20
_ITERATIONS = 25
_CHUNK = 50  # starts between two looks at the clock


@dataclass(frozen=True)
class ArcBatch:
    """
    Many sequences of arcs from one start state.

    `durations` (B, K) [s], zero from `arcs` (B,) on; `torques` (B, K) [N m]; `turns` (B,) the
    number of turns of the goal, NaN for the nearest; `costs` (B,) the sum of squared distances
    from the goal, infinite where not yet computed.
    """

    durations: Array
    arcs: NDArray[np.intp]
    torques: Array
    turns: Array
    costs: Array


def roll_states(
    plant: RotaryPendulum, start: Array, intervals: Array, torques: Array, steps: int
) -> Array:
    """Integrate over `intervals` [s] under held `torques`, both (n,): states (n + 1, 4)."""
    nodes, unused = np.empty((intervals.size * steps + 1, 4)), np.empty((1, 4, 1))
    roll_arcs(plant.coefficients, start, intervals, torques, steps, nodes, unused, False)
    return nodes[::steps].copy()


def steer(
    plant: RotaryPendulum,
    start: Array,
    batch: ArcBatch,
    psi_max: float,
    steps: int,
    stop: Callable[[], bool],
) -> int:
    """
    Vary all durations until the motions end upright at rest; the batch changes in place.

    Levenberg-Marquardt on (theta - 2 pi n, psi, theta'/w0, psi'/w0, excess of |psi|) for every
    start on its own. One core is left to the control loop: chunks of starts are shared out evenly
    among threads on the others. `stop` is asked between chunks and ends it early. Returns the
    number of integrations. The result does not depend on the number of cores.
    """
    chunks = range(0, batch.arcs.size, _CHUNK)
    workers = max(1, min(_cores() - 1, len(chunks)))
    constants, w0 = plant.coefficients, plant.natural_frequency

    def work(worker: int) -> int:
        rollouts = 0
        for first in chunks[worker::workers]:
            if stop():
                break
            rows = slice(first, first + _CHUNK)
            rollouts += steer_arcs(
                constants,
                start,
                batch.durations[rows],
                batch.arcs[rows],
                batch.torques[rows],
                batch.turns[rows],
                psi_max,
                w0,
                steps,
                _ITERATIONS,
                _TARGET,
                batch.costs[rows],
            )
        return rollouts

    if workers == 1:
        return work(0)
    with ThreadPoolExecutor(workers) as pool:
        return sum(pool.map(work, range(workers)))


def compile_kernels(plant: RotaryPendulum) -> None:
    """Compile the kernels or load them from the disk."""
    start = np.array([0.1, 0.0, 0.0, 0.0])
    durations, torques = np.full((1, 4), 1e-3), np.zeros((1, 4))
    batch = ArcBatch(durations, np.array([4]), torques, np.zeros(1), np.full(1, np.inf))
    steer(plant, start, batch, 1.0, 2, lambda: False)
    roll_states(plant, start, durations[0], torques[0], 1)


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
