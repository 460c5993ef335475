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

"""What a `DirectProblem` states beside its equations: whether it can be used, and its limits."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.checks import shown, whole
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint

if TYPE_CHECKING:
    from tdm_planner.problems.direct_problem import DirectProblem

Array = NDArray[np.float64]

MARGIN_TOLERANCE = 1e-5  # for what is exactly on a limit
_END_TOLERANCE = 1e-3  # of the conditions that are stated at the ends
_CONTRADICTED = 1e-2  # share by which rates differ where two statements contradict each other
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


def check_dynamics(program: Transcription, xi: Array) -> None:
    """
    Check that `invert` and `derivative` state the same motion, at most nodes of a candidate.

    Formulas may be abrupt somewhere.

    Raises
    ------
    InvalidProblem
        Naming the first state whose rates differ.

    """
    with np.errstate(all='ignore'):
        by_inverse, rates = program.flow(xi)
    finite = np.isfinite(by_inverse + rates)
    gaps, sizes = np.abs(by_inverse - rates), np.abs(by_inverse) + np.abs(rates)
    allowed = _CONTRADICTED * np.where(finite, sizes, 0.0).max(axis=0)
    wrong = finite & (gaps > allowed)
    for index in np.flatnonzero(2 * wrong.sum(axis=0) > finite.sum(axis=0)):
        node = int(np.argmax(wrong[:, index]))
        raise InvalidProblem(
            f"derivative gives the rate of '{program.formulation.state_names[index]}' = "
            f'{rates[node, index]:.6g} where the states of invert change by '
            f'{by_inverse[node, index]:.6g}: one of the two is wrong '
            '(`tdm check` compares all of them)'
        )


def check_ends(stated: CheckedFormulation, ends: Ends) -> None:
    """
    Check the limits at the start and at the end, as far as the boundary conditions tell.

    Raises
    ------
    InvalidProblem
        Naming the limit that every motion violates there.

    """
    rng, duration = np.random.default_rng(2), stated.duration()
    for side, where in enumerate(('start', 'end')):
        filled = []
        for given in (ends.states[side], ends.controls[side]):
            free = rng.normal(size=(3, given.size))
            filled.append(np.where(np.isfinite(given), given, free))
        times = duration.guess * np.array([0.7, 1.0, 1.3]) * side
        with np.errstate(all='ignore'):
            margins = stated.margins(times, *filled)
        for name, values in margins.items():
            if np.ptp(values) == 0.0 and values[0] < -MARGIN_TOLERANCE:
                raise InvalidProblem(
                    f"the {where} violates the limit '{name}' by {-values[0]:.3g}, whatever the "
                    f'motion: change the {where} or the limit'
                )


def limits_of(
    stated: CheckedFormulation, trajectory: Trajectory, tolerance: float = 0.0
) -> tuple[Constraint, ...]:
    """Return the limits on a trajectory, one constraint each."""

    def margin(name: str, times: Array, states: Array, controls: Array) -> Array:
        return stated.margins(times, states, controls)[name]

    names = stated.margins(trajectory.times, trajectory.states, trajectory.controls)
    return tuple(Constraint(name, partial(margin, name), tolerance) for name in names)


def constraints_of(stated: CheckedFormulation, trajectory: Trajectory) -> tuple[Constraint, ...]:
    """Return what a plan is checked for: its limits, and the conditions at both ends."""

    def missed(side: int, index: int, times: Array, states: Array, controls: Array) -> Array:
        conditions = stated.end_conditions if side else stated.start_conditions
        at = slice(-1, None) if side else slice(0, 1)
        left = np.full(times.size, _END_TOLERANCE)
        left[at] -= np.abs(conditions(times[at], states[at])[index])
        return left

    found = list(limits_of(stated, trajectory, MARGIN_TOLERANCE))
    for side, function in enumerate(('start_conditions', 'end_conditions')):
        conditions: Sequence[Any] = getattr(stated, function)(
            trajectory.times[:1], trajectory.states[:1]
        )
        found += [
            Constraint(f'{function} {index}', partial(missed, side, index))
            for index in range(len(conditions))
        ]
    return tuple(found)
