# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Calls the functions of a user's statement and turns their errors into one-sentence messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from functools import cached_property
from inspect import getattr_static
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.arrays import Array
from tdm_planner.direct_method.formulation import (
    components,
    Duration,
    Formulation,
    Integrated,
    number,
    Output,
    Outputs,
)
from tdm_planner.direct_method.hints import told
from tdm_planner.exceptions import InvalidProblem, place_of, TdmError
from tdm_planner.parameters import short

Values = NDArray[Any]

_LEFT = ', as what is left to a limit: 3 - x, not x < 3'


class CheckedFormulation:
    """
    The functions of a formulation on arrays (K, n) of states and controls at K nodes.

    Every method raises `InvalidProblem`, naming the function and what is wrong with it; an error
    of the user's function is its cause.
    """

    def __init__(self, formulation: Formulation) -> None:
        self.formulation = formulation
        self.state_names = self._names('state')
        self.control_names = self._names('control')
        if both := set(self.state_names) & set(self.control_names):
            raise InvalidProblem(
                f'control_names = {short(self.control_names)} has the name of a state, '
                f"'{min(both)}': messages and files tell the two apart by their names"
            )
        self._margin_names: list[str] | None = None

    @property
    def limit_names(self) -> list[str]:
        """Names of all limits once `margins` was called, those of `control_limits` last."""
        limits = self._limit_margins(np.zeros(len(self.control_names)))
        return [*(self._margin_names or ()), *limits]

    def outputs(self) -> dict[str, Output]:
        """Return the reference functions by name, at least one."""
        found = self._named('outputs', Output)
        if not found:
            raise InvalidProblem('a formulation needs at least one output')
        return found

    def integrated(self) -> dict[str, Integrated]:
        """Return the integrated states by name."""
        found = self._named('integrated', Integrated)
        _check_names('integrated', found, 'states', self.state_names)
        return found

    def duration(self) -> Duration:
        """Return the time for the arc."""
        found = self.call('duration')
        if not isinstance(found, Duration):
            raise InvalidProblem(f'duration returns {short(found)}, expected a Duration')
        return found

    def invert(self, y: Outputs, z: Mapping[str, Values]) -> tuple[Values, Values]:
        """Return states and controls, (..., nx) and (..., nu), from outputs of shape (...)."""
        shape = next(iter(y.values()))[0].shape
        found = self.call('invert', y, z)
        if not isinstance(found, tuple | list) or len(found) != 2:
            raise InvalidProblem(
                f'invert returns {short(found)}, expected a pair: states and controls'
            )
        what = 'of the pair (states, controls) that invert returns'
        states = self._stacked(found[0], self.state_names, f'states, the first {what}', shape)
        controls = f'controls, the second {what}'
        return states, self._stacked(found[1], self.control_names, controls, shape)

    def derivative(self, states: Values, controls: Values) -> Values:
        """Return the rates of all states, (..., nx)."""
        found = self.call('derivative', components(states), components(controls))
        what = 'what derivative returns'
        return self._stacked(found, self.state_names, what, states.shape[:-1])

    def margins(self, times: Values, states: Values, controls: Values) -> dict[str, Values]:
        """Return what is left to every limit, (K,) by name; those of `control_limits` last."""
        found = self._mapping('margins', times, components(states), components(controls))
        names = list(found)
        if self._margin_names is None:
            _check_strings('margins', names)
            for name in {*names} & {*self._limit_margins(np.zeros(len(self.control_names)))}:
                raise InvalidProblem(
                    f"margins names '{name}', as a limit of control_limits is called: name it "
                    'otherwise'
                )
            self._margin_names = names
        if names != self._margin_names:
            raise InvalidProblem(
                f'margins names {names}, but named {self._margin_names} before: the limits must '
                'always be the same, in the same order'
            )
        stated = {
            name: self._shaped(f"margins gives '{name}'", value, times.shape, _LEFT)
            for name, value in found.items()
        }
        return stated | self._limit_margins(components(controls))

    @cached_property
    def control_limits(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of the controls that are limited, by name; may be infinite."""
        found = self._mapping('control_limits')
        limits = {}
        _check_names('control_limits', found, 'controls', self.control_names)
        for name, pair in found.items():
            try:
                low, high = (float(value) for value in pair if not isinstance(value, str))
            except (TypeError, ValueError):
                low, high = math.nan, math.nan
            if not low < high:
                raise InvalidProblem(
                    f"control_limits gives '{name}' = {short(pair)}, expected a pair of numbers, "
                    'the lowest below the highest'
                )
            limits[name] = (low, high)
        return limits

    def _limit_margins(self, u: Any, limits: Any = None) -> dict[str, Any]:
        """Return what is left to `control_limits`, in halves of a control's range."""
        found = {}
        for name, (low, high) in (limits or self.control_limits).items():
            value, ends = u[self.control_names.index(name)], self.control_limits[name]
            size = self._size(name, low, high)
            if math.isfinite(ends[0]):
                found[f'{name}, lowest'] = (value - low) / size
            if math.isfinite(ends[1]):
                found[f'{name}, highest'] = (high - value) / size
        return found

    def size_of(self, margin: str) -> tuple[float, str]:
        """Return size and unit of a margin of 1: `_size` of a control, else 1 and no unit."""
        name = margin.rpartition(', ')[0]
        if name not in self.control_limits:
            return 1.0, ''
        unit = self.formulation.control_units[self.control_names.index(name)]
        return float(self._size(name, *self.control_limits[name])), unit

    def _size(self, control: str, low: Any, high: Any) -> Any:
        """Return half a control's range, or its one limit: its margins are shares of that."""
        lowest, highest = np.isfinite(self.control_limits[control])
        if lowest and highest:
            return 0.5 * (high - low)
        only = high if highest else low
        return np.where(only == 0.0, 1.0, np.abs(only))

    def reserves(self, names: Sequence[str]) -> Array:
        """Return the share of every limit, by its margin's name, that is kept for feedback."""
        shares, given = np.zeros(len(names)), self.attribute('reserve')
        if not isinstance(given, Mapping):
            raise InvalidProblem(
                f'reserve = {short(given)} is not allowed: must be a mapping of limits to shares'
            )
        for limit, share in given.items():
            meant = [n == limit or n.rpartition(', ')[0] == limit for n in names]
            if not any(meant):
                raise InvalidProblem(
                    f'reserve names {short(limit)}, which is not a limit: there are '
                    + ', '.join(f"'{name}'" for name in names)
                )
            if not 0.0 <= number(share, f"the reserve of '{limit}'") < 1.0:
                raise InvalidProblem(
                    f"reserve gives '{limit}' = {share:g}: must be a share, 0 or more and below 1"
                )
            shares[meant] = share
        return shares

    def parts(self, function: str, times: Values, *others: Values) -> list[Values]:
        """Return a cost, or what must vanish at an end, (K,) each, from (K,), (K, nx), (K, nu)."""
        found, what = self.call(function, times, *map(components, others)), f'{function} gives'
        if function.endswith('_cost'):
            return [self._shaped(f'{what} J', found, times.shape)]
        one = getattr(found, 'ndim', 2) < 2
        if one or isinstance(found, str | Mapping) or not hasattr(found, '__iter__'):
            given = 'one value' if one else short(found)
            raise InvalidProblem(
                f'{function} returns {given}, expected a sequence of values that must vanish, '
                'such as [x[0]]'
            )
        return [
            self._shaped(f'{what} number {index}', value, times.shape)
            for index, value in enumerate(found)
        ]

    def values(self, function: str, *arguments: Any) -> dict[str, Values]:
        """Return what one of the traced functions gives, (K,) each, by what messages call it."""
        if function == 'invert':
            return self.called(*self.invert(*arguments))
        if function == 'derivative':
            rates = components(self.derivative(*arguments))
            return {f"the rate of '{n}'": v for n, v in zip(self.state_names, rates, strict=True)}
        if function == 'margins':
            return {f"'{name}'": value for name, value in self.margins(*arguments).items()}
        parts, one = self.parts(function, *arguments), function.endswith('_cost')
        return {'J' if one else f'number {index}': part for index, part in enumerate(parts)}

    def called(self, states: Values, controls: Values) -> dict[str, Values]:
        """Return states and controls, (K,) each, by what messages call them."""
        names = [f"state '{name}'" for name in self.state_names]
        names += [f"control '{name}'" for name in self.control_names]
        return dict(zip(names, [*components(states), *components(controls)], strict=True))

    def guess(self, s: Array) -> dict[str, Array]:
        """Return the outputs that `first_guess` states, (K,) by name, along the arc `s` (K,)."""
        found, guesses = self._mapping('first_guess', s), {}
        _check_names('first_guess', found, 'outputs', self.outputs())
        for name, value in found.items():
            what = f"first_guess gives '{name}'"
            guesses[name] = guess = np.asarray(self._shaped(what, value, s.shape), dtype=float)
            if not np.isfinite(guess).all():
                node = int(np.argmin(np.isfinite(guess)))
                raise InvalidProblem(
                    f'{what} = {guess[node]} at s = {s[node]:.3g}: it must be a number from s = 0 '
                    'to s = 1'
                )
        return guesses

    def symbolic(self, function: str, *arguments: Any) -> list[Any]:
        """Return the parts of what a function gives of symbols; what it raises passes."""
        found = getattr(self.formulation, function)(*deepcopy(arguments))
        if function == 'invert':
            return [*found[0], *found[1]]
        if function == 'margins':
            limits = self.formulation.control_limits()
            return [*found.values(), *self._limit_margins(arguments[2], limits).values()]
        if function in ('running_cost', 'final_cost'):
            return [found]
        return list(found)

    def attribute(self, name: str) -> Any:
        """Return what is stated under a name, maybe by a property; None if nothing is."""
        stated = getattr_static(self.formulation, name, None) is not None
        return self._told(name, lambda: getattr(self.formulation, name)) if stated else None

    def call(self, function: str, *arguments: Any) -> Any:
        """Return what a function of the statement gives; it may write into what it is given."""
        given = deepcopy(arguments)
        return self._told(function, lambda: getattr(self.formulation, function)(*given))

    def _told(self, function: str, run: Callable[[], Any]) -> Any:
        try:
            with np.errstate(all='ignore'):
                return run()
        except TdmError as error:
            where, source = place_of(error)
            if source.startswith('raise '):  # the user's own
                raise
            raise InvalidProblem(str(error) + where.replace(' in', ':', 1)) from error
        except Exception as error:  # noqa: B902
            raise InvalidProblem(told(self.formulation, function, error)) from error

    def _names(self, kind: str) -> tuple[str, ...]:
        example = "('x', 'v')" if kind == 'state' else "('force',)"
        names = self.strings(f'{kind}_names', 'names', example)
        if len(set(names)) != len(names):
            raise InvalidProblem(f'{kind}_names = {short(names)} has the same name twice')
        return names

    def strings(self, attribute: str, what: str, example: str) -> tuple[str, ...]:
        """Return a tuple of strings; if it is none, InvalidProblem shows an `example`."""
        found = self.attribute(attribute)
        if isinstance(found, tuple | list) and found and all(isinstance(s, str) for s in found):
            return tuple(found)
        raise InvalidProblem(
            f'{attribute} = {short(found)} must be a tuple of {what}, such as {example}'
        )

    def _mapping(self, function: str, *arguments: Any) -> Mapping[Any, Any]:
        found = self.call(function, *arguments)
        if not isinstance(found, Mapping):
            raise InvalidProblem(f'{function} returns {short(found)}, expected a mapping by name')
        return found

    def _named(self, function: str, kind: type) -> dict[str, Any]:
        found = self._mapping(function)
        _check_strings(function, found)
        for name, value in found.items():
            if not isinstance(value, kind):
                raise InvalidProblem(
                    f"{function} gives '{name}' = {short(value)}, expected an {kind.__name__}"
                )
        return dict(found)

    def _stacked(
        self, values: Any, names: tuple[str, ...], what: str, shape: tuple[int, ...]
    ) -> Values:
        try:
            parts = list(values)
        except TypeError:
            raise InvalidProblem(
                f'{what} has {short(values)}, expected a sequence of {len(names)} components, '
                'each a number or an array over the nodes'
            ) from None
        if len(parts) != len(names):
            one = getattr(values, 'shape', None) == shape
            given = 'one array over the nodes' if one else f'{len(parts)} components'
            expected = f'{len(names)}: {", ".join(names)}'
            raise InvalidProblem(f'{what} has {given}, expected {expected}')
        rows = zip(names, parts, strict=True)
        return np.stack([self._shaped(f"{what}: '{n}'", part, shape) for n, part in rows], axis=-1)

    @staticmethod
    def _shaped(what: str, value: Any, shape: tuple[int, ...], instead: str = '') -> Values:
        try:
            found = np.asarray(value)
        except (TypeError, ValueError):
            found = np.asarray(None)
        if found.dtype.kind == 'b':
            raise InvalidProblem(f'{what} = True or False, expected a number{instead}')
        if found.dtype.kind not in 'iuf':
            raise InvalidProblem(f'{what} = {short(value)}, which is not a real number')
        try:
            return np.broadcast_to(found, shape)
        except ValueError:
            raise InvalidProblem(
                f'{what} of shape {found.shape}, expected {shape}: one number at every node'
            ) from None


def _check_strings(function: str, names: Iterable[Any]) -> None:
    for name in names:
        if not isinstance(name, str):
            raise InvalidProblem(f'{function} has the name {short(name)}, which must be a string')


def _check_names(function: str, found: Iterable[Any], kind: str, known: Iterable[str]) -> None:
    for name in found:
        if name not in known:
            raise InvalidProblem(
                f'{function} names {short(name)}, which is not one of the {kind} '
                + ', '.join(known)
            )
