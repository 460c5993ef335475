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
What the library's structure costs: the pendulum's search against the same one in flat loops.

Both are measured in processor time, in turns, and come by the same plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import math
import time
from typing import Any

from benchmark import by_hand
from benchmark.pendulum import problem, REGIMES, start_state
from benchmark.progress import counted
import numpy as np
from tdm_planner.direct_method import Budget
from tdm_planner.problems import PendulumSwingUp, Solution
from tdm_planner.problems.switching_search import Candidate, polish

_DEADLINE = 60.0  # [s], never reached: time decides nothing


def run(states: int = 20, repetitions: int = 3) -> dict[str, Any]:
    """Solve from random states in both regimes both ways; medians of the ratios of times."""
    problems = [problem(t, start_state(s)) for t in REGIMES.values() for s in range(states)]
    whole, part = [], []
    for made in counted(problems, 'overhead'):
        # The first arrivals of the search, to compare the minimiser alone.
        found = by_hand.arrivals(made, np.random.default_rng(0))[:3]
        ways: tuple[Callable[[], object], ...] = (
            partial(by_library, made),
            partial(by_hand.solve, made),
            partial(_polish, made, found),
            partial(_polish_by_hand, made, found),
        )
        seconds = np.min([[_seconds(way) for way in ways] for _ in range(repetitions)], axis=0)
        whole.append(seconds[:2])
        part.append(seconds[2:])
    totals, minimiser = np.array(whole), np.array(part)
    ratios = totals[:, 0] / totals[:, 1]
    return {
        'cases': len(problems),
        'library_ms': 1e3 * float(np.median(totals[:, 0])),
        'by_hand_ms': 1e3 * float(np.median(totals[:, 1])),
        'overhead': float(np.median(ratios)) - 1.0,
        'largest_overhead': float(ratios.max()) - 1.0,
        'minimiser_overhead': float(np.median(minimiser[:, 0] / minimiser[:, 1])) - 1.0,
    }


def by_library(made: PendulumSwingUp) -> Solution:
    """Solve without regard to time."""
    return made.solve(_DEADLINE, seed=0)


def _polish(made: PendulumSwingUp, found: Sequence[Any]) -> None:
    for arcs in found:
        polish(made.task, Candidate(*arcs), by_hand.COARSE, 1e-8, Budget(60.0))


def _polish_by_hand(made: PendulumSwingUp, found: Sequence[Any]) -> None:
    for durations, torques, turns in found:
        numbers = by_hand.numbers(made)
        by_hand.polish(numbers, durations, torques, turns, by_hand.COARSE, math.inf)


def _seconds(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def table(figures: dict[str, Any]) -> str:
    """Return the figures as text."""
    return '\n'.join(
        [
            f'{figures["cases"]} swing-ups, processor time over that of a hand-written loop:',
            f'  request to verified plan   {figures["overhead"]:+8.1%} median, '
            f'{figures["largest_overhead"]:+.1%} largest '
            f'({figures["library_ms"]:.0f} ms, by hand {figures["by_hand_ms"]:.0f} ms)',
            f'  minimiser alone            {figures["minimiser_overhead"]:+8.1%} median',
        ]
    )
