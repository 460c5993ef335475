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
A problem that only states itself; search, verification and trajectory are the library's.

    @dataclass(frozen=True)
    class MyProblem(DirectProblem):
        name: ClassVar[str] = 'my_problem'
        state_names, state_units = ('x', 'v'), ('m', 'm/s')
        control_names, control_units = ('force',), ('N',)

        start: MyStart = group(MyStart)
        solver: DirectSolverParameters = group(DirectSolverParameters)

        def outputs(self): ...       # reference functions with their boundary conditions
        def duration(self): ...      # varied or fixed, speed factor
        def invert(self, y, z): ...  # states and controls from the outputs' derivatives
        def derivative(self, x, u): ...  # the plant, for the verification and for integration
        def margins(self, t, x, u): ...  # limits
        def final_cost(self, t, x): ...  # performance index

See `tdm_planner.direct_method.formulation.Formulation` for each of them, and docs/plants for
worked examples. Registered under the entry-point group `tdm_planner.problems`, such a problem is
planned for by ``tdm plan`` and by the planner node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import NotFinite
from tdm_planner.parameters import parameter, POSITIVE
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.direct_search import DirectSearch
from tdm_planner.problems.direct_statement import check_statement
from tdm_planner.problems.request import SolverParameters
from tdm_planner.problems.search import Plan
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint

Array = NDArray[np.float64]

_AT_BOUND = 1e-5  # share by which a duration at a bound may differ from it


@dataclass(frozen=True)
class DirectSolverParameters(SolverParameters):
    """How long and how hard to search; the search ends earlier when all starts are done."""

    deadline: float = parameter(
        3.0,
        'time allowed for a plan; the best verified one is returned',
        unit='s',
        allowed=POSITIVE,
    )


class DirectProblem(Formulation, Problem):
    """
    An optimal control problem stated by a `Formulation`; see this module's docstring.

    `nodes` (at least) along the arc are where limits are kept while searching; more are taken
    where the check of a plan asks for them. `starts` first guesses are tried. A plan's end may
    differ by `terminal_tolerance` (nx,) from the goal when replayed; by default by 1e-3 of the
    largest range that a state of the same unit runs through.
    """

    nodes: ClassVar[int] = 41
    starts: ClassVar[int] = 4
    terminal_tolerance: ClassVar[tuple[float, ...] | None] = None

    def search(
        self, budget: Budget, rng: np.random.Generator, previous: Solution | None
    ) -> DirectSearch:
        """Return the search; an earlier plan's varied parameters are the first guess."""
        check_statement(self)
        first = None if previous is None else previous.parameters
        return DirectSearch(self, DirectPlant(self), budget, rng, first)

    def constraints_on(self, trajectory: Trajectory) -> Sequence[Constraint]:
        """Return the limits that `margins` states."""
        stated = CheckedFormulation(self)

        def margin(name: str, times: Array, states: Array, controls: Array) -> Array:
            return stated.margins(times, states, controls)[name]

        names = stated.margins(trajectory.times, trajectory.states, trajectory.controls)
        return tuple(Constraint(name, partial(margin, name)) for name in names)

    def cost_to_go(self, solution: Solution, elapsed: float) -> float:
        """Return J of what is left of a plan `elapsed` s after its start."""
        whole = solution.trajectory
        if elapsed >= whole.duration:
            return 0.0
        rest, stated = whole.after(max(elapsed, 0.0)), CheckedFormulation(self)
        running = stated.running_cost(rest.times[None], rest.states[None], rest.controls[None])
        final = stated.final_cost(rest.times[-1:], rest.states[-1:])
        return float(trapezoid(running[0], rest.times) + final[0])

    def describe(self, plan: Plan) -> str:
        """Return the summary of a plan, one sentence; it says where the duration is at a bound."""
        allowed, note = self.duration(), ''
        shortest, longest = allowed.bounds
        if not allowed.fixed:
            if plan.duration <= shortest * (1.0 + _AT_BOUND):
                note = f', duration at its shortest allowed value, {shortest:g} s'
            elif plan.duration >= longest * (1.0 - _AT_BOUND):
                note = f', duration at its longest allowed value, {longest:g} s'
        return super().describe(plan) + note


@dataclass(frozen=True)
class DirectPlant:
    """The plant of a formulation, as the verification integrates it."""

    formulation: Formulation

    @cached_property
    def _stated(self) -> CheckedFormulation:
        return CheckedFormulation(self.formulation)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.formulation.state_names

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of the states."""
        return self.formulation.state_units

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the controls."""
        return self.formulation.control_names

    @property
    def control_units(self) -> tuple[str, ...]:
        """Units of the controls."""
        return self.formulation.control_units

    def derivative(self, state: Array, control: Array) -> Array:
        """
        Time derivative of the states: (..., nx), (..., nu) -> (..., nx).

        Raises
        ------
        NotFinite
            Naming the state, if a rate is not a finite number.

        """
        stacked = self._stated.derivative(state, control)
        if not np.isfinite(stacked).all():
            index = np.unravel_index(int(np.argmin(np.isfinite(stacked))), stacked.shape)
            raise NotFinite(
                f"derivative gives the rate of '{self.state_names[index[-1]]}' = {stacked[index]} "
                f'in state {state[index[:-1]]} under control {control[index[:-1]]}'
            )
        return stacked
