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
import math
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import sindg
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import short

Values = NDArray[Any]  # of numbers, or of symbols while a function is traced
Conditions = Sequence[float | None] | Mapping[int, float]
Components = Sequence[Values] | Values
Outputs = Mapping[str, Sequence[Values]]

_LARGEST = 1e100  # its cube can still be computed
_MOST = 100  # terms, and exponents: more cannot be told apart in floating point
_MOST_FREE = 40  # parameters of one output: bases of more are ill-conditioned
_HIGHEST_ORDER = 60  # of a derivative


def number(value: Any, what: str, *, positive: bool = False) -> float:
    """Return a finite (or `positive`) number; if it is none, InvalidProblem names `what`."""
    allowed = 'a positive number' if positive else 'a finite number'
    try:
        found = float(value) if np.ndim(value) == 0 and not isinstance(value, str) else np.nan
    except (TypeError, ValueError, OverflowError):
        found = np.nan
    if not abs(found) <= _LARGEST or (positive and found <= 0):
        raise InvalidProblem(f'{what} = {short(value)} is not allowed: must be {allowed}')
    return found


def checked_integer(value: Any, what: str, least: int, most: int) -> int:
    """Return an integer in [least, most]; if it is none, InvalidProblem names `what`."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (is_whole and least <= value <= most):
        raise InvalidProblem(
            f'{what} = {short(value)} is not allowed: must be an integer from {least} to {most}'
        )
    return int(value)


class Shapes(ABC):
    """
    Functions phi_k(s) on the unit interval with phi_k(0) = phi_k(1) = 0; Phi = sum A_k phi_k.

    Families can be combined: `SineSeries(3) + symmetric_powers(2)`.
    """

    @property
    def size(self) -> int:
        """Return the number of shapes m."""
        return int(self.values(0.0).size)

    @abstractmethod
    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative of every shape at s (...), (..., m)."""

    def __add__(self, other: Shapes) -> Shapes:
        if not isinstance(other, Shapes):
            return NotImplemented
        return CombinedShapes((self, other))


@dataclass(frozen=True)
class CombinedShapes(Shapes):
    """The shapes of several families, one after the other."""

    families: tuple[Shapes, ...]

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m)."""
        return np.concatenate([f.values(s, derivative) for f in self.families], axis=-1)


@dataclass(frozen=True)
class SineSeries(Shapes):
    """sin(k pi s), k = 1..`terms`. All even derivatives vanish at the ends."""

    terms: int

    def __post_init__(self) -> None:
        checked_integer(self.terms, 'the number of terms of a sine series', 1, _MOST)

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m)."""
        k = np.arange(1, self.terms + 1)
        # In degrees, so that the values at both ends are exact.
        angle = 180.0 * k * np.asarray(s, dtype=float)[..., None] + 90.0 * derivative
        return np.asarray((k * np.pi) ** derivative * sindg(angle))


@dataclass(frozen=True)
class PowerProducts(Shapes):
    """
    s^m1 (s - 1)^m2 for every pair (m1, m2) of `exponents`, both at least 1.

    In the paper's argument these are (tau - tau_0)^m1 (tau - tau_f)^m2; their coefficients here
    are the paper's times (tau_f - tau_0)^(m1 + m2), in the unit of x.
    """

    exponents: Any  # kept as a tuple of pairs

    def __post_init__(self) -> None:
        try:
            pairs = tuple((first, second) for first, second in self.exponents)
        except (TypeError, ValueError):
            pairs = ()
        if not pairs:
            raise InvalidProblem(
                f'exponents = {short(self.exponents)} must be pairs, such as [(1, 2), (2, 2)]'
            )
        for pair in pairs:
            for exponent in pair:  # at least 1, for the product to vanish at both ends
                checked_integer(exponent, f'an exponent of {short(pair)}', 1, _MOST)
        object.__setattr__(self, 'exponents', pairs)

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m), by Leibniz' rule."""
        at = np.asarray(s, dtype=float)
        shapes = [product_derivative(at, a, b, derivative) for a, b in self.exponents]
        return np.stack(shapes, axis=-1)


def product_derivative(s: Array, first: int, second: int, derivative: int) -> Array:
    """Return the `derivative`-th derivative of s^first (s - 1)^second, exponents >= 0."""
    total = np.zeros_like(s)
    for j in range(max(0, derivative - second), min(derivative, first) + 1):
        factor = math.comb(derivative, j) * math.perm(first, j) * math.perm(second, derivative - j)
        total = total + factor * s ** (first - j) * (s - 1.0) ** (second - derivative + j)
    return total


def symmetric_powers(terms: int) -> PowerProducts:
    """Return s^k (s - 1)^k, k = 1..`terms`: symmetric about the middle of the arc."""
    count = checked_integer(terms, 'the number of terms of a series of powers', 1, _MOST)
    return PowerProducts(tuple((k, k) for k in range(1, count + 1)))


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
        for where in ('start', 'end'):
            for order in self.conditions(where):
                checked_integer(
                    order, f'the order of a derivative given at the {where}', 0, _HIGHEST_ORDER
                )
        checked_integer(self.free, 'free', 0, _MOST_FREE)
        checked_integer(self.derivatives, 'derivatives', 0, _HIGHEST_ORDER)
        if self.scale is not None:
            number(self.scale, 'scale', positive=True)
        if self.shapes is not None and not isinstance(self.shapes, Shapes):
            raise InvalidProblem(
                f'shapes = {short(self.shapes)} is not a family of shapes, such as SineSeries(3)'
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
                f'{where} = {short(given)} must be a sequence of boundary values '
                '(x, x., x.., ...), or a mapping from order to value'
            ) from None
        return {
            order: number(value, f'the value of order {short(order)} at the {where}')
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
        given = {'guess': self.guess, 'shortest': self.shortest, 'longest': self.longest}
        for what, value in given.items():
            if value is not None or what == 'guess':
                number(value, f'the duration: {what}', positive=True)
        if not isinstance(self.fixed, bool):
            raise InvalidProblem(
                f'the duration: fixed = {self.fixed!r} is not allowed: must be True or False, '
                'with the time in guess'
            )
        checked_integer(self.speed_factor_order, 'speed_factor_order', 0, _HIGHEST_ORDER)
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
    the largest range that a state of the same unit runs through. The direct method's own plans
    keep limits at `nodes` or more along the arc, and begin from `starts` initial guesses.
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
