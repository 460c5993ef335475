# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A motion at the nodes of the arc, and the check that a first one is made of numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import components
from tdm_planner.exceptions import InvalidProblem, NotFinite

Array = NDArray[np.float64]

_SAME = 1e-9  # share by which a state passed on may differ from itself


@dataclass(frozen=True, eq=False)
class ArcMotion:
    """A candidate at K nodes: times (K,), states (K, nx), controls (K, nu)."""

    times: Array
    states: Array
    controls: Array


def check_finite(stated: CheckedFormulation, motion: ArcMotion, nodes: Array) -> None:
    """
    Check all that is stated along a motion.

    Raises
    ------
    NotFinite
        Naming function, node and value, for the first node where something is not finite: what is
        wrong there spoils the integration of all that follow.

    """
    last = nodes.size - 1
    found = [
        (last if at_end else int(np.argmin(np.isfinite(values))), what, values)
        for what, values, at_end in _stated_values(stated, motion)
        if not np.isfinite(values).all()
    ]
    if found:
        node, what, values = min(found, key=lambda item: item[0])
        raise NotFinite(
            f'{what} = {values[0 if values.size == 1 else node]} at node {node} of {nodes.size} '
            f'(s = {nodes[node]:.3g}, t = {motion.times[node]:.3g} s): it must be a '
            'number along the first guess, or near it (`first_guess` states another)'
        )


def check_integrated(
    stated: CheckedFormulation, motion: ArcMotion, integrated: Array, nodes: Array
) -> None:
    """
    Check that the states of a motion are the `integrated` ones (K, nz).

    Raises
    ------
    InvalidProblem
        Naming state, node and both values, where `invert` gives another state instead.

    """
    for name, expected in zip(stated.integrated(), integrated.T, strict=True):
        given = motion.states[:, stated.state_names.index(name)]
        size = float(np.abs(expected).max())
        same = np.isclose(given, expected, rtol=_SAME, atol=_SAME * size, equal_nan=True)
        if not same.all():
            node = int(np.argmin(same))
            raise InvalidProblem(
                f"invert gives the state '{name}' = {given[node]:g} at node {node} of "
                f'{nodes.size} (s = {nodes[node]:.3g}), but integrated gives {expected[node]:g}: '
                f"it must be z['{name}'], or not be integrated"
            )


def _stated_values(
    stated: CheckedFormulation, motion: ArcMotion
) -> Iterator[tuple[str, Array, bool]]:
    """Yield what every function gives along the motion, (K,), or (1,) and True at its end."""
    times, states, controls = motion.times, motion.states, motion.controls
    rates = stated.derivative(states, controls)
    integrated = stated.integrated()  # these are wrong because their rates are
    for what, names, values in (
        ('invert gives state', stated.state_names, states),
        ('invert gives control', stated.control_names, controls),
        ('derivative gives the rate of', stated.state_names, rates),
    ):
        for name, value in zip(names, components(values), strict=True):
            if what != 'invert gives state' or name not in integrated:
                yield f"{what} '{name}'", value, False
    for name, value in stated.margins(times, states, controls).items():
        yield f"margins gives '{name}'", value, False
    yield 'running_cost gives J', stated.running_cost(times, states, controls), False
    start, end = (times[:1], states[:1]), (times[-1:], states[-1:])
    yield 'final_cost gives J', stated.final_cost(*end), True
    for index, value in enumerate(stated.start_conditions(*start)):
        yield f'start_conditions gives number {index}', value, False
    for index, value in enumerate(stated.end_conditions(*end)):
        yield f'end_conditions gives number {index}', value, True
