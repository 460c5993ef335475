# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A stated problem as a node knows it: its class by name, and its parameters among the node's.

They have the same names in the planner, the tracker and the plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from typing import Any, get_type_hints

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import specifications
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_planner.problems.registry import load_problem

_NOT_OF_THE_PLANT = ('solver', 'start')


def stated_problem(name: str) -> type[DirectProblem]:
    """
    Return the class of a stated problem, by its registered name or ``module:Class``.

    Raises
    ------
    InvalidProblem
        If there is none, or it brings its own transcription.

    """
    found = load_problem(name)
    if not issubclass(found, DirectProblem):
        raise InvalidProblem(
            f"problem '{name}' brings nodes of its own: only a DirectProblem is simulated and "
            'tracked by its statement'
        )
    return found


def with_parameters_of(
    base: type[Any], problem: type[DirectProblem], besides: Sequence[str] = _NOT_OF_THE_PLANT
) -> type[Any]:
    """
    Return the dataclass of a node's parameters: those of `base`, and the problem's own.

    Raises
    ------
    InvalidProblem
        If both have one of the same name.

    """
    mine = {item.name for item in dataclasses.fields(base)}
    added: list[tuple[str, Any, Any]] = []
    kind: Any = problem
    field: Any = dataclasses.field
    hints = get_type_hints(problem)
    for item in dataclasses.fields(kind):
        if item.name in besides:
            continue
        if item.name in mine:
            raise InvalidProblem(
                f"parameter '{item.name}' of {problem.__name__} is one of the node's own: name it "
                'otherwise'
            )
        copied: Any = field(
            default=item.default, default_factory=item.default_factory, metadata=item.metadata
        )
        added.append((item.name, hints[item.name], copied))
    return dataclasses.make_dataclass(
        f'{problem.__name__}{base.__name__}', added, bases=(base,), frozen=True
    )


def problem_from(problem: type[DirectProblem], values: Mapping[str, Any]) -> DirectProblem:
    """Make the problem from a node's parameters; its start and solver are the defaults."""
    own = specifications(problem)
    skipped = tuple(f'{name}.' for name in _NOT_OF_THE_PLANT)
    given = {n: v for n, v in values.items() if n in own and not n.startswith(skipped)}
    return problem.from_parameters(given)
