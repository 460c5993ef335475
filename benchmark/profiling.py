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
Where the time of a plan goes: flame graphs of cold and warm solves of both problems.

    python -m benchmark profile

draws them into ./profile and prints the shares of the package's functions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
import time
from typing import Any

from benchmark import flame
from benchmark.pendulum import problem as swing_up
from benchmark.pendulum import start_state
from benchmark.progress import report
from benchmark.robots import MARGIN
from benchmark.scenarios import crossing
import numpy as np
import tdm_planner
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.base import Problem

FOLDER = Path('profile')
_NEAR = np.array([0.05, 0.05, 0.25, 0.25])  # rad, rad/s: how far the earlier plan's start is
_NEAR_ROBOT = 0.03  # m
_DEADLINE = 8.0
_LEAST, _SHOWN = 0.01, 16  # share of a cost that is noted; how many are printed
_OWN = {path.stem for path in Path(tdm_planner.__file__).parent.rglob('*.py')}


def _pendulum(case: int, near: bool = False) -> Problem:
    away = np.random.default_rng([case, 7]).uniform(-1.0, 1.0, size=4) * _NEAR * near
    return swing_up(0.02, start_state(case) + away)


def _robots(case: int, near: bool = False) -> Problem:
    values = crossing(case).parameters(**{'arena.tracking_margin': MARGIN})
    values['robot1.start.x'] += _NEAR_ROBOT * near
    return RobotFormation.from_parameters(values)


PROBLEMS: dict[str, Callable[..., Problem]] = {'pendulum': _pendulum, 'robots': _robots}


def sample(
    kind: str, warm: bool, cases: int, seconds: float
) -> tuple[Counter[flame.Stack], float]:
    """Stacks below `solve`, and milliseconds of processor time a solve."""
    stated = [PROBLEMS[kind](case) for case in range(cases)]
    stated[0].solve(_DEADLINE)
    earlier = [
        PROBLEMS[kind](case, near=True).solve(_DEADLINE) if warm else None for case in range(cases)
    ]
    solves, began = 0, time.process_time()
    with flame.Sampler() as sampler:
        while time.process_time() - began < seconds:
            for each, plan in zip(stated, earlier, strict=True):
                each.solve(_DEADLINE, warm_start=plan)
            solves += cases
    milliseconds = 1e3 * (time.process_time() - began) / solves
    return flame.below(sampler.stacks, 'base.solve'), milliseconds


def run(folder: Path | str = FOLDER, cases: int = 20, seconds: float = 6.0) -> dict[str, Any]:
    """Profile `cases` of everything, `seconds` of processor time each; draw into `folder`."""
    figures: dict[str, Any] = {}
    for kind in PROBLEMS:
        for warm in (False, True):
            how = 'warm' if warm else 'cold'
            report(f'{kind}, {how}')
            stacks, milliseconds = sample(kind, warm, cases, seconds)
            title = f'{kind}, {how}: {milliseconds:.1f} ms of processor time a solve'
            file = Path(folder) / f'profile_{kind}_{how}.png'
            flame.draw(flame.tree(stacks, 'base.solve'), _OWN, title, file)
            own = [cost for cost in flame.costs(stacks) if cost[0].split('.')[0] in _OWN]
            figures[f'{kind}, {how}'] = {
                'ms': milliseconds,
                'costs': [cost for cost in own if cost[1] > _LEAST],
                'picture': file.name,
            }
    return figures


def table(figures: dict[str, Any]) -> str:
    """Return the largest costs as text; a function's share holds all it calls."""
    lines = []
    for name, found in figures.items():
        lines.append(f'{name}: {found["ms"]:.1f} ms of processor time a solve')
        lines += [f'  {share:6.1%}  {label}' for label, share in found['costs'][:_SHOWN]]
    return '\n'.join(lines)
