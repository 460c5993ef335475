# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What a user states of an optimal control problem for the direct method to solve it.

A few *outputs* are written as reference functions of the virtual arc; the states and controls
follow from them and their derivatives by time (`invert`), states that cannot be inverted are
integrated. `tdm_planner.direct_method.transcription` makes a nonlinear program of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bases import Shapes
from tdm_planner.direct_method.checks import number, shown, whole
from tdm_planner.exceptions import InvalidProblem

Values = NDArray[Any]  # of numbers, or of symbols while a function is traced
Conditions = Sequence[float | None] | Mapping[int, float]
Components = Sequence[Values] | Values
Outputs = Mapping[str, Sequence[Values]]

_MOST_FREE = 200  # parameters of one output
_HIGHEST_ORDER = 60  # of a derivative


@dataclass(frozen=True, eq=False)
class Output:
    """
    A coordinate that is given as a reference function.

    `start` and `end` hold its boundary values and their derivatives by time: (x, x., x.., ...),
    None where one is free, or a mapping from order to value. `free` further parameters are
    varied: a polynomial's order rises by one with each (section 3 of Yakimenko 2006). With
    `shapes`, it is a function (1) of Taranenko instead, and all coefficients that the conditions
    leave are varied. `derivatives` by time are computed for `invert`. `scale` is a typical
    change along the arc, estimated from the conditions unless given.

    Raises
    ------
    InvalidProblem
        If one of them is not what it should be.

    """

    start: Conditions = ()
    end: Conditions = ()
    free: int = 0
    shapes: Shapes | None = None
    derivatives: int = 2
    scale: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        for where in ('start', 'end'):
            for order in self.conditions(where):
                whole(order, f'the order of a derivative given at the {where}', 0, _HIGHEST_ORDER)
        whole(self.free, 'free', 0, _MOST_FREE)
        whole(self.derivatives, 'derivatives', 0, _HIGHEST_ORDER)
        if self.scale is not None:
            number(self.scale, 'scale', positive=True)
        if self.shapes is not None and not isinstance(self.shapes, Shapes):
            raise InvalidProblem(
                f'shapes = {shown(self.shapes)} is not a family of shapes, such as SineSeries(3)'
            )
        if self.shapes is not None and self.free:
            raise InvalidProblem(
                f'free = {self.free} is for polynomials: of shapes, all coefficients that the '
                'conditions leave are varied'
            )

    def conditions(self, where: str) -> dict[int, float]:
        """Boundary values at `where`, start or end, by order of the derivative."""
        given = self.start if where == 'start' else self.end
        try:
            if isinstance(given, str | bytes):
                raise TypeError
            pairs = list(given.items() if isinstance(given, Mapping) else enumerate(given))
        except TypeError:
            raise InvalidProblem(
                f'{where} = {shown(given)} must be a sequence of boundary values '
                '(x, x., x.., ...), or a mapping from order to value'
            ) from None
        return {
            order: number(value, f'derivative {shown(order)} at the {where}')
            for order, value in pairs
            if value is not None
        }


@dataclass(frozen=True)
class Duration:
    """
    Time for the whole arc [s]: varied between `shortest` and `longest`, or `fixed` at `guess`.

    `speed_factor_order` is the degree of the speed factor dt/ds, a Bernstein polynomial whose
    coefficients are varied; 0 is tau = t. Where all boundary conditions are at rest and the
    outputs have many free parameters a speed factor is worth little.
    """

    guess: float = 1.0
    shortest: float | None = None
    longest: float | None = None
    fixed: bool = False
    speed_factor_order: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        given = {'guess': self.guess, 'shortest': self.shortest, 'longest': self.longest}
        for what, value in given.items():
            if value is not None or what == 'guess':
                number(value, f'the duration: {what}', positive=True)
        if not isinstance(self.fixed, bool):
            raise InvalidProblem(
                f'the duration: fixed = {self.fixed!r} is not allowed: must be True or False, '
                'with the time in guess'
            )
        whole(self.speed_factor_order, 'speed_factor_order', 0, _HIGHEST_ORDER)
        shortest, longest = self.bounds
        if not shortest <= self.guess <= longest:
            raise InvalidProblem(
                f'the duration {self.guess:g} s must lie between the shortest, {shortest:g} s, '
                f'and the longest, {longest:g} s'
            )
        if self.fixed and self.speed_factor_order:
            raise InvalidProblem(
                f'speed_factor_order = {self.speed_factor_order} is not allowed: must be 0 where '
                'the duration is fixed'
            )

    @property
    def bounds(self) -> tuple[float, float]:
        """Shortest and longest [s]."""
        shortest = 1e-2 * self.guess if self.shortest is None else self.shortest
        longest = 1e2 * self.guess if self.longest is None else self.longest
        return shortest, longest


@dataclass(frozen=True)
class Integrated:
    """A state that is integrated: its value at the start, and at the end unless that is free."""

    start: float
    end: float | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the values."""
        number(self.start, 'the start of an integrated state')
        if self.end is not None:
            number(self.end, 'the end of an integrated state')
        number(self.scale, 'the scale of an integrated state', positive=True)


class Formulation(ABC):
    """
    An optimal control problem in terms of reference functions.

    States and controls are passed as sequences of components: `x[i]` is the i-th state at all
    nodes, an array. Use numpy's functions (sqrt, arctan2, where, maximum), and nothing that mixes
    nodes. Every function is also called once with symbols, to trace it: `math.sqrt`, `float` or
    `if` on a value cannot be traced.

    `reserve` keeps a share of limits for feedback, by the name of a margin or a control. A plan's
    end may differ by `terminal_tolerance` (nx,) from the goal when replayed; by default by 1e-3 of
    the largest range that a state of the same unit runs through. Without refinement limits are
    kept at `nodes` (at least) along the arc, from `starts` first guesses.
    """

    name: ClassVar[str]
    nodes: ClassVar[int] = 41
    starts: ClassVar[int] = 4
    terminal_tolerance: ClassVar[tuple[float, ...] | None] = None
    reserve: ClassVar[Mapping[str, float]] = MappingProxyType({})

    state_names: ClassVar[tuple[str, ...]]
    state_units: ClassVar[tuple[str, ...]]
    control_names: ClassVar[tuple[str, ...]]
    control_units: ClassVar[tuple[str, ...]]

    @abstractmethod
    def outputs(self) -> Mapping[str, Output]:
        """Return the reference functions and their boundary conditions, by name."""

    @abstractmethod
    def duration(self) -> Duration:
        """Return the time the motion takes, or may take."""

    @abstractmethod
    def invert(self, y: Outputs, z: Mapping[str, Values]) -> tuple[Components, Components]:
        """
        Return states and controls by inverse dynamics.

        `y[name][k]` is the k-th derivative of an output by time, `z[name]` an integrated state.
        """

    @abstractmethod
    def derivative(self, x: Components, u: Components) -> Components:
        """Return the time derivatives of all states: the plant's equations of motion."""

    def integrated(self) -> Mapping[str, Integrated]:
        """Return the states that are integrated, by name; none by default."""
        return {}

    def final_cost(self, t: Values, x: Components) -> Values:
        """Return the part of the performance index J that the end (t_f, x_f) determines."""
        return np.zeros_like(t)

    def running_cost(self, t: Values, x: Components, u: Components) -> Values:
        """Return the integrand of J."""
        return np.zeros_like(t)

    def margins(self, t: Values, x: Components, u: Components) -> Mapping[str, Values]:
        """
        Return what is left to every limit, by name; negative where it is violated.

        Best as a share of the limit, such as ``1 - (u[0]/limit)**2``.
        """
        return {}

    def control_limits(self) -> Mapping[str, tuple[float, float]]:
        """Return the lowest and highest values of controls, by name; none by default."""
        return {}

    def start_conditions(self, t: Values, x: Components) -> Sequence[Values]:
        """Return what must vanish at the start beside the boundary conditions, of order one."""
        return ()

    def first_guess(self, s: Values) -> Mapping[str, Values]:
        """Return outputs along the arc, 0 <= s <= 1, to begin the search with; any of them."""
        return {}

    def end_conditions(self, t: Values, x: Components) -> Sequence[Values]:
        """Return what must vanish at the end beside the boundary conditions, of order one."""
        return ()

    def feedback_weights(self) -> tuple[Any, Any] | None:
        """
        Return the weights Q (nx, nx) and R (nu, nu) of the tracker's LQR.

        Their rows follow `state_names` and `control_names`. By default, None, a deviation is
        divided by the range that its state runs through along the plan.
        """
        return None

    def joints(self) -> Mapping[str, tuple[str, str]]:
        """Return joints by name: the states that are their position and velocity."""
        return {}


def components(values: Values) -> Values:
    """Return an array (..., n) with its components first: (n, ...)."""
    return np.moveaxis(values, -1, 0)
