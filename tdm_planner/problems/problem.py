# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""An optimal control problem cast in the direct method: parameters in, a verified plan out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import Field, fields, is_dataclass, replace
from functools import wraps
from inspect import isroutine, unwrap
import re
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from tdm_planner.direct_method.hints import told
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import (
    Infeasible,
    InvalidProblem,
    one_line,
    TdmError,
    VerificationFailed,
)
from tdm_planner.parameters import (
    build,
    check_fields,
    NON_NEGATIVE,
    ParameterSpec,
    SEED,
    shown,
    specifications,
    to_mapping,
)
from tdm_planner.problems.planner_parameters import problem_parameters, SolverParameters
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint

C = TypeVar('C')
P = TypeVar('P', bound='Problem')
_LIBRARY = 'tdm_planner.'  # where modules of ours begin


class Search(ABC, Generic[C]):
    """
    The direct method's outer loop (section 3 of Yakimenko 2006); `run` carries it out.

    Initial guesses are minimised to candidates; the most promising are refined with more nodes and
    written out as trajectories until one passes the check; where none does, it begins anew, wider.
    What a problem brings is how its candidates come about and how they are refined.

    `budget` is the time it may take; `rejected` why the last candidate gave no plan that passes
    the check, empty if none was tried.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self.rejected = ''

    @abstractmethod
    def candidates(self) -> Iterable[C]:
        """Minimise from a round of initial guesses; feasible results, the most promising first."""

    @abstractmethod
    def plans(self, candidate: C) -> Iterator[Solution]:
        """
        Yield plans of one candidate, the next one more finely refined than the one before.

        `run` takes the next one only where the last one failed its verification. Ends when the
        budget is spent; of the first candidate one plan is still tried then.
        """

    @abstractmethod
    def failure(self) -> Infeasible:
        """Return the reason why there is no plan."""

    def is_worth_checking(self, candidate: C, plan: Solution) -> bool:
        """Whether a candidate is worth a check though there is a plan."""
        return True

    def accept(self, plan: Solution) -> bool:
        """
        Take a verified plan; return True to end the search with it.

        Otherwise it stays a candidate for the cheapest plan of the round.
        """
        return True

    @property
    def remark(self) -> str:
        """Return what the plan's summary is to say beside its figures."""
        return ''

    def widen(self) -> bool:
        """Prepare another round after one without a plan; False ends the search."""
        return True

    def run(self) -> Solution:
        """
        Return the first plan to satisfy, else the cheapest of the round that passes the check.

        Raise Infeasible if there is none; its subclass says why.
        """
        while True:
            best: Solution | None = None
            for candidate in self.candidates():
                if best is None or self.is_worth_checking(candidate, best):
                    plan = self._verified(candidate)
                    if plan is not None and self.accept(plan):
                        return plan
                    if plan is not None and (best is None or plan.cost < best.cost):
                        best = plan
                if self.budget.spent:
                    break
            if best is not None:
                return best
            if self.budget.spent or not self.widen():
                raise self.failure()

    def _verified(self, candidate: C) -> Solution | None:
        for plan in self.plans(candidate):
            if plan.verification.ok:
                return plan
            self.rejected = plan.verification.reasons[0]
        return None


class Problem(ABC):
    """
    An optimal control problem: boundary conditions, limits, weights; `solve` gives a plan.

    Subclasses are frozen dataclasses whose fields are groups of parameters (see
    `tdm_planner.parameters`), with a `solver: SolverParameters` among them. All are checked when a
    problem is made, before a `__post_init__` of its own. One that states its reference functions
    and inverse dynamics derives from `DirectProblem`, which transcribes it; one that brings a
    transcription of its own (compiled kernels, several vehicles) gives `search`.
    """

    name: ClassVar[str]
    solver: SolverParameters

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Check the parameters first where the class has a `__post_init__` of its own."""
        super().__init_subclass__(**arguments)
        if '__post_init__' in vars(cls):
            kind: Any = cls
            kind.__post_init__ = _after_a_check(kind.__post_init__)

    def __post_init__(self, *given: Any) -> None:
        """Check every parameter; raises InvalidProblem for the first wrong value."""
        check_fields(self)
        if after := getattr(super(), '__post_init__', None):  # of a mixin
            after(*given)

    def __new__(cls: type[P], *arguments: Any, **named: Any) -> P:
        """Make a problem of a class that is complete."""
        cls.check_class()
        return super().__new__(cls)

    @classmethod
    def check_class(cls) -> None:
        """Raise InvalidProblem if the class is not made as a dataclass, or methods are missing."""
        if not is_dataclass(cls) or any(isinstance(value, Field) for value in vars(cls).values()):
            raise InvalidProblem(
                f'{cls.__name__} is no dataclass: put @dataclass(frozen=True) above it'
            )
        made: Any = getattr(unwrap(cls.__init__), '__code__', None)
        if made is not None and made.co_filename != '<string>':  # where that of a dataclass is
            raise InvalidProblem(
                f'{cls.__name__} has an __init__ of its own: leave it out, @dataclass writes one; '
                'what follows from parameters is a property'
            )
        library = [vars(base) for base in cls.__mro__ if base.__module__.startswith(_LIBRARY)]
        for item in fields(cls):
            found = [base.get(item.name) for base in library]
            hides = any(isroutine(value) or isinstance(value, property) for value in found)
            if hides or item.name == 'name' or (item.name == 'solver' and item.metadata):
                raise InvalidProblem(
                    f"{cls.__name__} has a parameter '{item.name}', which hides what a problem "
                    'has under that name: name it otherwise'
                )
        if not re.fullmatch(r'[A-Za-z]\w*', str(cls.name), re.ASCII):
            raise InvalidProblem(
                f'{cls.__name__}.name = {shown(cls.name)} is not allowed: must be a letter, then '
                'letters, digits and _, as topics are named after it'
            )
        if cls.__abstractmethods__:
            missing = ', '.join(sorted(cls.__abstractmethods__))
            raise InvalidProblem(f'{cls.__name__} is not complete: define {missing}')

    @classmethod
    def parameter_specifications(cls, values: Mapping[str, Any]) -> dict[str, ParameterSpec]:
        """Return every parameter by dotted name; `values` may decide which exist."""
        return specifications(cls)

    @classmethod
    def from_parameters(cls: type[P], parameters: Mapping[str, Any]) -> P:
        """
        Make a problem from a mapping as in the YAML files, nested or with dotted names.

        Of a whole file's document the section of the node `planner` counts.

        Raises
        ------
        InvalidProblem
            Naming the parameter, the value and what is allowed.

        """
        values = problem_parameters(cls, parameters)
        try:
            with np.errstate(all='ignore'):
                return cls.from_values(values)
        except (OverflowError, FloatingPointError) as error:
            raise InvalidProblem(
                f'parameters lie too many orders of magnitude apart: {one_line(error)}'
            ) from None

    @classmethod
    def from_values(cls: type[P], values: Mapping[str, Any]) -> P:
        """Make a problem from checked values by dotted name."""
        return build(cls, values)

    def to_parameters(self) -> dict[str, Any]:
        """Return every parameter's value by dotted name (the inverse of `from_parameters`)."""
        return to_mapping(self)

    def prepare(self) -> None:
        """Do the work that does not depend on the boundary conditions (compile, tabulate)."""
        return

    @property
    def evaluations_per_second(self) -> float:
        """Return how often a search computes the dynamics in a second, about, on one core."""
        return 500.0

    @abstractmethod
    def search(
        self, budget: Budget, rng: np.random.Generator, previous: Solution | None
    ) -> Search[Any]:
        """Return the search for a plan, from an earlier plan as well if one is given."""

    def standing_plan(self) -> Solution | None:
        """Return the plan that does nothing, where the start is the goal; None if it is not."""
        return None

    def constraints_on(self, trajectory: Trajectory) -> Sequence[Constraint]:
        """
        Return the limits on one vehicle's planned motion, as its check keeps them.

        Pictures and reports show what is left to them over time. Empty unless overridden.
        """
        return ()

    def cost_to_go(self, solution: Solution, elapsed: float) -> float | None:
        """
        Return J of what is left of a plan `elapsed` s after its start; None: it is not known.

        It is that of the rest as a plan of its own, from time 0. Replanning on the way replaces a
        plan that would do by a cheaper one only where this is known.
        """
        return None

    def describe(self, plan: Solution) -> str:
        """Return the summary of a plan, one sentence."""
        worst = min(plan.verification.worst.items(), key=lambda item: item[1], default=None)
        closest = ''
        if worst is not None:
            beyond = ', which is allowed' if worst[1] < 0.0 else ''
            closest = f', closest limit {worst[0]} (margin {worst[1]:.2g}{beyond})'
        return f'J = {plan.cost:.6g}, {plan.duration:.4g} s{closest}'

    def solve(
        self,
        deadline: float | None = None,
        seed: int | None = None,
        warm_start: Solution | None = None,
        counted: bool = False,
    ) -> Solution:
        """
        Find the best verified plan within `deadline` s (default: `solver.deadline`).

        `seed` (default: `solver.seed`) is that of the random initial guesses. `warm_start` is a
        plan of a problem of the same kind, with other ends or limits, to start from; of one that
        has been followed, what is left (`TimedPlan.remainder`).
        With `counted` the search does not look at the clock: every second of the deadline is
        `evaluations_per_second` of the dynamics, about as many as one core does. The plan is then
        the same to the last bit however slow or busy the machine.

        Raises
        ------
        InvalidProblem
            If the boundary conditions contradict the limits, or `warm_start` is no such plan.
        Infeasible
            If no plan was found; its subclass says why (deadline, verification).

        """
        with computed():
            self.prepare()
        self._check_warm_start(warm_start)
        allowed = self.solver.deadline if deadline is None else _DEADLINE.check(deadline)
        count = max(1, round(allowed * self.evaluations_per_second))
        budget = Budget(allowed, count if counted else None)
        rng = np.random.default_rng(self.solver.seed if seed is None else _SEED.check(seed))
        with computed():
            plan, remark = self.standing_plan(), ''
            if plan is None:
                search = self.search(budget, rng, warm_start)
                plan, remark = search.run(), search.remark
        return self._with_figures(plan, budget.evaluations, budget.age, remark)

    def assess(self, trajectories: Mapping[str, Trajectory]) -> Solution:
        """
        Return earlier planned motions, by vehicle, with their cost and check recomputed.

        Raise VerificationFailed where the problem cannot tell, as by default.
        """
        raise VerificationFailed(f"problem '{self.name}' cannot assess plans made before")

    def recovered(self, trajectories: Mapping[str, Trajectory]) -> Solution:
        """
        Rebuild a plan of this problem from its trajectories, by vehicle.

        Raises
        ------
        VerificationFailed
            If they do not pass the check of this problem, or it cannot assess them.

        """
        with computed():
            plan = self.assess(trajectories)
        if not plan.verification.ok:
            raise VerificationFailed('; '.join(plan.verification.reasons))
        return self._with_figures(plan)

    def _with_figures(
        self, plan: Solution, evaluations: int = 0, solve_time: float = 0.0, remark: str = ''
    ) -> Solution:
        """Return a plan of a search with all that a user is told of it."""
        return replace(
            plan,
            problem=self.name,
            evaluations=evaluations,
            solve_time=solve_time,
            summary=self.describe(plan) + remark,
        )

    def _check_warm_start(self, plan: Any) -> None:
        if plan is not None and not isinstance(plan, Solution):
            raise InvalidProblem(
                f'warm_start = {shown(plan)} is not allowed: must be a Solution that solve gave'
            )
        if plan is not None and plan.problem != self.name:
            raise InvalidProblem(
                f"warm_start is a plan of '{shown(plan.problem)}' and not of '{self.name}'"
            )


def _after_a_check(own: Callable[..., None]) -> Callable[..., None]:
    """Return a class's `__post_init__` after the check; what it raises is one sentence."""

    @wraps(own)
    def checked(self: Problem, *given: Any) -> None:
        check_fields(self)
        try:
            own(self, *given)
        except (TdmError, OverflowError, FloatingPointError):
            raise
        except Exception as error:  # noqa: B902
            raise InvalidProblem(told(self, '__post_init__', error)) from error

    return checked


@contextmanager
def computed() -> Iterator[None]:
    """
    Say in one sentence that numbers left the range in which they can be computed.

    That is what OverflowError and FloatingPointError say; other errors are the program's own.
    Candidates whose numbers overflow are told by their check, not by warnings.
    """
    with np.errstate(all='ignore'):
        try:
            yield
        except (OverflowError, FloatingPointError) as error:
            raise Infeasible(
                f'the computation broke down ({one_line(error)}): parameters lie '
                'too many orders of magnitude apart, are their units right?'
            ) from error


_DEADLINE = ParameterSpec(
    'deadline', float, None, 'time allowed for a plan', unit='s', range=NON_NEGATIVE
)
_SEED = ParameterSpec('seed', int, None, 'seed of the random starts', range=SEED)
