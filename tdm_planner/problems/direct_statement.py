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

"""Whether what a `DirectProblem` states beside its functions can be used at all."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from tdm_planner.direct_method.checks import shown, whole
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.exceptions import InvalidProblem

if TYPE_CHECKING:
    from tdm_planner.problems.direct_problem import DirectProblem

_NODES = 5, 10_000
_STARTS = 1, 10_000


def check_statement(problem: DirectProblem) -> None:
    """
    Check performance index, units, tolerance and the numbers of nodes and starts.

    Raises
    ------
    InvalidProblem
        Naming what is missing or not allowed.

    """
    stated = {name: getattr(type(problem), name) for name in ('final_cost', 'running_cost')}
    if all(found is getattr(Formulation, name) for name, found in stated.items()):
        raise InvalidProblem(
            f'{problem.name} states no performance index: define final_cost or running_cost'
        )
    for kind in ('state', 'control'):
        _check_units(problem, kind)
    whole(problem.nodes, 'nodes', *_NODES)
    whole(problem.starts, 'starts', *_STARTS)
    if problem.terminal_tolerance is not None:
        _check_tolerance(problem.terminal_tolerance, len(problem.state_names))


def _check_units(problem: DirectProblem, kind: str) -> None:
    names = getattr(problem, f'{kind}_names', ())
    units = getattr(problem, f'{kind}_units', None)
    if not isinstance(units, tuple | list) or not all(isinstance(unit, str) for unit in units):
        raise InvalidProblem(
            f'{kind}_units = {shown(units)} must be a tuple of units, such as '
            + ("('m', 'm/s')" if kind == 'state' else "('N',)")
        )
    if len(names) != len(units):
        raise InvalidProblem(
            f'{problem.name} has {len(names)} {kind}_names but {len(units)} {kind}_units'
        )


def _check_tolerance(tolerance: Any, count: int) -> None:
    try:
        found = np.asarray(tolerance)
    except ValueError:  # nested sequences of several lengths
        found = np.asarray(None)
    if found.dtype.kind not in 'iuf' or found.shape != (count,) or not (found > 0).all():
        raise InvalidProblem(
            f'terminal_tolerance = {shown(tolerance)} is not allowed: must be {count} positive '
            'numbers, one for each state, inf where any end will do'
        )
