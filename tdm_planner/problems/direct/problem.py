# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A problem that only states itself; search, verification and trajectory are the library's.

    @dataclass(frozen=True)
    class MyProblem(DirectProblem):
        name: ClassVar[str] = 'my_problem'
        state_names, state_units = ('x', 'v'), ('m', 'm/s')
        control_names, control_units = ('force',), ('N',)

        start: MyStart = group(MyStart)

        def outputs(self): ...       # reference functions with their boundary conditions
        def duration(self): ...      # varied or fixed, speed factor
        def invert(self, y, z): ...  # states and controls from the outputs' derivatives
        def derivative(self, x, u): ...  # the plant, for the verification and for integration
        def margins(self, t, x, u): ...  # limits
        def control_limits(self): ...  # those of the controls, by name
        def final_cost(self, t, x): ...  # performance index

See `tdm_planner.direct_method.formulation.Formulation` for each of them, and docs/plants for
worked examples. Registered under the entry-point group `tdm_planner.problems`, such a problem is
planned for by ``tdm plan`` and by the planner node.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, MISSING, replace
from functools import cache
from inspect import isfunction, unwrap
import re
from types import CodeType
from typing import Any, cast, ClassVar

import numpy as np
from tdm_planner.direct_method.arc_basis import ArcLayout, NodeGraphs
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.drawing import Shape
from tdm_planner.exceptions import InvalidProblem, VerificationFailed
from tdm_planner.parameters import group, MISSPELLED, parameter, positive, suggestion
from tdm_planner.problems.direct.refinement import prepare_refinement
from tdm_planner.problems.direct.search import DirectSearch
from tdm_planner.problems.direct.statement import check_statement, CONDITIONS, limits_of
from tdm_planner.problems.planner_parameters import SolverParameters
from tdm_planner.problems.problem import computed, Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint

_AT_BOUND = 1e-4  # share by which a duration at a bound may differ from it


@dataclass(frozen=True)
class DirectSolverParameters(SolverParameters):
    """How long and how hard to search; the search ends once most initial guesses agree."""

    deadline: float = positive(
        3.0, 'time allowed for a plan; the best verified one is returned', 's'
    )
    refine: bool = parameter(
        True, "refine plans by collocation; false: the direct method's own plan"
    )


class DirectProblem(Formulation, Problem):
    """
    An optimal control problem stated by a `Formulation`; see this module's docstring.

    The last field is `solver`, a group of `DirectSolverParameters`, unless a class has its own.
    """

    name: ClassVar[str] = 'direct_problem'

    def drawing(self, x: Sequence[Any]) -> Sequence[Shape]:
        """
        Return what the plant looks like in states `x`, by default nothing.

        `x[i]` is the i-th state, a number or an array over instants; the shapes, in the plane or
        in space, are those of `tdm_planner.drawing`.
        """
        return ()

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Name a class that has no name, and give one without solver's parameters the usual."""
        super().__init_subclass__(**arguments)
        if cls.name == DirectProblem.name:
            cls.name = re.sub(r'(?<!^)(?=[A-Z])', '_', cls.__name__).lower()
        if 'solver' not in {**getattr(cls, '__dataclass_fields__', {}), **cls.__annotations__}:
            cls.__annotations__['solver'] = DirectSolverParameters
            cls.solver = group(DirectSolverParameters)  # a field, once it is a dataclass

    @classmethod
    def check_class(cls) -> None:
        """Raise InvalidProblem if the class cannot be used, or has a method that is misspelt."""
        super().check_class()
        (solver,) = (item for item in fields(cast(Any, cls)) if item.name == 'solver')
        made = solver.default is MISSING
        usual = cast(Any, solver.default_factory)() if made else solver.default
        if not isinstance(usual, SolverParameters):
            raise InvalidProblem(
                f"{cls.__name__} has a parameter 'solver' that is no group of SolverParameters: "
                'derive its class from that one'
            )
        for name, doubt in misspelled_attributes(cls, MISSPELLED).items():
            if isfunction(getattr(cls, name)):  # attributes may be for others
                raise InvalidProblem(f'{cls.__name__}.{doubt}')

    def search(
        self, budget: Budget, rng: np.random.Generator, previous: Solution | None
    ) -> DirectSearch:
        """Return the search; the rest of an earlier plan is its initial guess."""
        check_statement(self)
        return DirectSearch(self, budget, rng, previous)

    def assess(self, trajectories: Mapping[str, Trajectory]) -> Solution:
        """Return an earlier plan, with its cost and check recomputed."""
        motion = next(iter(trajectories.values()))
        names = tuple(self.state_names), tuple(self.control_names)
        if (motion.state_names, motion.control_names) != names:
            raise VerificationFailed(f"its states or controls are not those of '{self.name}'")
        search = self.search(Budget(self.solver.deadline), np.random.default_rng(0), None)
        given, parameters = (motion.times, motion.states, motion.controls), np.zeros(0)
        plan = search.checked(*given, 0.0, parameters, motion.interpolation)
        if plan is None:
            raise VerificationFailed(search.rejected)
        return replace(plan, cost=self.cost_to_go(plan, 0.0))

    @property
    def _refined(self) -> bool:
        """Whether candidates are solved again by collocation."""
        return bool(getattr(self.solver, 'refine', True))

    def prepare(self) -> None:
        """Trace the statement and make the programs, so that the first plan does not wait."""
        check_statement(self)
        stated = CheckedFormulation(self)
        with computed():
            trace = Trace.of(stated, compared=True)
            NodeGraphs.of(trace, ArcLayout.of(stated.outputs(), stated.duration()), stated)
            if self._refined:
                prepare_refinement(trace)

    def constraints_on(self, trajectory: Trajectory) -> Sequence[Constraint]:
        """Return the limits that `margins` and `control_limits` state."""
        return limits_of(CheckedFormulation(self), trajectory)

    def cost_to_go(self, solution: Solution, elapsed: float) -> float:
        """Return J of what is left of a plan `elapsed` s after its start."""
        whole = solution.trajectory
        if elapsed >= whole.duration:
            return 0.0
        rest, stated = whole.after(max(elapsed, 0.0)), CheckedFormulation(self)
        rest, trace = rest.with_rates(stated.derivative), Trace.of(stated)
        ends = np.stack([rest.times[:-1], rest.times[1:]], axis=1)
        middle = rest.sample(ends.mean(axis=1))
        times = np.insert(ends, 1, ends.mean(axis=1), axis=1)
        last = rest.controls[:-1] if rest.interpolation == 'zero_order_hold' else rest.controls[1:]
        states = np.stack([rest.states[:-1], middle.state, rest.states[1:]], axis=1)
        controls = np.stack([rest.controls[:-1], middle.control, last], axis=1)
        return trace.cost_along(trace.values(self), times, states, controls)

    def describe(self, plan: Solution) -> str:
        """
        Return the summary of a plan, one sentence.

        It says where the duration is at a bound.
        """
        allowed, note = self.duration(), ''
        shortest, longest = allowed.bounds
        if not allowed.fixed:
            if plan.duration <= shortest * (1.0 + _AT_BOUND):
                note = f', duration at its shortest allowed value, {shortest:g} s'
            elif plan.duration >= longest * (1.0 - _AT_BOUND):
                note = f', duration at its longest allowed value, {longest:g} s'
        check = plan.verification  # conditions, kept within a tolerance, are no limits
        limits = {k: v for k, v in check.worst.items() if k.rpartition(' ')[0] not in CONDITIONS}
        return super().describe(replace(plan, verification=replace(check, worst=limits))) + note


@cache
def misspelled_attributes(problem: type[Problem], likeness: float = 0.6) -> dict[str, str]:
    """Say of attributes of a statement, by name, that they are like those the library uses."""
    if not issubclass(problem, DirectProblem):
        return {}
    own = [kind for kind in problem.__mro__ if kind not in DirectProblem.__mro__]
    used = {name for kind in own for value in vars(kind).values() for name in _names_in(value)}
    others = {*dir(DirectProblem), *used, *(item.name for item in fields(cast(Any, problem)))}
    known = {*vars(Formulation), *Formulation.__annotations__, DirectProblem.drawing.__name__}
    doubts = {}
    for kind in own:
        for name in sorted(set(vars(kind)) - known - others):
            question = suggestion(name, known - set(vars(kind)), likeness)
            if question and name[0] != '_':
                doubts[name] = f'{name} is never used: {question}'
    return doubts


def _names_in(value: Any) -> Iterator[str]:
    """Yield the names of attributes that a function or property uses, or one within it."""
    for holder in ('fget', 'func', '__func__'):  # of properties, cached ones, class methods
        value = getattr(value, holder, value)
    code = getattr(unwrap(value) if callable(value) else value, '__code__', value)
    if isinstance(code, CodeType):
        yield from code.co_names
        for inner in code.co_consts:
            yield from _names_in(inner)
