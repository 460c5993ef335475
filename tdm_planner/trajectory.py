# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A trajectory: time stamps, named states and controls with units, read at any instant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, get_args, Literal, NamedTuple, TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PPoly
from tdm_planner.arrays import Array, Integers
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import suggestion

if TYPE_CHECKING:
    from tdm_planner.plants.base import Named

T = TypeVar('T', float, Array)
Interpolation = Literal['zero_order_hold', 'linear', 'cubic']

NANOSECOND = 1e-9
SECOND = 1_000_000_000  # ns


class Sample(NamedTuple):
    """A trajectory read at one instant, (nx,) and (nu,), or at many, (n, nx) and (n, nu)."""

    state: Array
    control: Array


def to_nanoseconds(times: ArrayLike) -> Array:
    """Round times [s] to whole nanoseconds, the resolution of ROS time stamps."""
    return np.round(np.asarray(times, dtype=float) / NANOSECOND) * NANOSECOND


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    States and controls over time, on exactly the samples that are written or published.

    `times` (N,) s, strictly increasing from 0; `states` (N, nx); `controls` (N, nu).
    `interpolation` says how controls run between samples: `zero_order_hold` (the value at t_k acts
    on [t_k, t_k+1)), `linear`, or `cubic` (the not-a-knot spline through all samples); every
    switching instant is a sample. `rates` (N-1, 2, nx), optional, holds the time derivatives of
    the states at the start and at the end of every interval (they differ at a switch), from which
    `sample` reads the states by cubic Hermite interpolation.

    Raises
    ------
    InvalidProblem
        For lengths that do not match, values that are not finite, or times that do not increase.

    """

    times: Array
    states: Array
    controls: Array
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    interpolation: Interpolation = 'zero_order_hold'
    state_units: tuple[str, ...] = ()
    control_units: tuple[str, ...] = ()
    rates: Array | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ('times', 'states', 'controls'):
            values = np.array(getattr(self, name), dtype=float)
            if not np.isfinite(values).all():
                place = ', '.join(map(str, np.argwhere(~np.isfinite(values))[0]))
                raise InvalidProblem(
                    f"trajectory '{name}' holds a value that is not finite, at [{place}]"
                )
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        n = self.times.size
        if self.times.ndim != 1 or n < 2:
            raise InvalidProblem(
                f"trajectory 'times' has shape {self.times.shape}: at least two samples are needed"
            )
        for name, names in (('states', self.state_names), ('controls', self.control_names)):
            shape = getattr(self, name).shape
            if shape != (n, len(names)):
                raise InvalidProblem(
                    f"trajectory '{name}' has shape {shape}, expected {(n, len(names))}"
                )
        if self.rates is not None and self.rates.shape != (n - 1, 2, len(self.state_names)):
            raise InvalidProblem(
                f"trajectory 'rates' has shape {self.rates.shape}, expected a pair of "
                f'{len(self.state_names)} rates for each of {n - 1} intervals'
            )
        if not (np.diff(self.times) > 0).all():
            first = int(np.argmin(np.diff(self.times) > 0))
            raise InvalidProblem(
                "trajectory 'times', in whole nanoseconds, must increase strictly, but sample "
                f'{first + 1} is at {self.times[first + 1]:g} s after {self.times[first]:g} s'
            )
        if self.interpolation not in get_args(Interpolation):
            raise InvalidProblem(
                f"trajectory 'interpolation' = {self.interpolation!r} must be one of "
                + ', '.join(get_args(Interpolation))
            )

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def units(self) -> dict[str, str]:
        """Units of states and controls by name, as far as they are known."""
        return {
            **dict(zip(self.state_names, self.state_units, strict=False)),
            **dict(zip(self.control_names, self.control_units, strict=False)),
        }

    @cached_property
    def switches(self) -> Integers:
        """Return the samples (m,) at which a held control jumps; none of other controls."""
        if self.interpolation != 'zero_order_hold':
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero((np.diff(self.controls[:-1], axis=0) != 0).any(axis=1)) + 1

    @cached_property
    def control_pieces(self) -> PPoly:
        """The controls as polynomials, each as long as they run smoothly."""
        if self.interpolation == 'cubic' and self.times.size >= 4:
            return CubicSpline(self.times, self.controls)
        if self.interpolation != 'zero_order_hold':
            return lines(self.times, self.controls)
        pieces = [0, *self.switches, self.times.size - 1]
        return PPoly(self.controls[None, pieces[:-1]], self.times[pieces])

    @classmethod
    def of(
        cls,
        named: Named,
        times: Array,
        states: Array,
        controls: Array,
        interpolation: Interpolation = 'zero_order_hold',
    ) -> Trajectory:
        """Return a trajectory whose names and units are those of `named`, a plant or problem."""
        names = named.state_names, named.control_names
        units = named.state_units, named.control_units
        return cls(times, states, controls, *names, interpolation, *units)

    def with_rates(self, derivative: Callable[[Array, Array], Array]) -> Trajectory:
        """Return a copy whose `rates` follow from the plant's `derivative(state, control)`."""
        start = self.controls[:-1]
        end = start if self.interpolation == 'zero_order_hold' else self.controls[1:]
        rates = np.stack(
            [derivative(self.states[:-1], start), derivative(self.states[1:], end)], axis=1
        )
        return replace(self, rates=rates)

    def after(self, elapsed: float) -> Trajectory:
        """
        Return the rest of the motion from `elapsed` s after the first sample, times from zero.

        `elapsed` must be less than the duration. A cubic spline through fewer samples is another
        one, so that the controls of the rest may differ a little between samples.
        """
        first = self.times[0] + max(elapsed, 0.0)
        if not first < self.times[-1]:
            raise InvalidProblem(
                f'nothing is left of the trajectory after {elapsed:g} s: it lasts '
                f'{self.duration:g} s'
            )
        later = int(np.searchsorted(self.times, first + NANOSECOND, side='right'))
        now = self.sample(first)
        return replace(
            self,
            times=np.concatenate([[0.0], to_nanoseconds(self.times[later:] - first)]),
            states=np.concatenate([now.state[None], self.states[later:]]),
            controls=np.concatenate([now.control[None], self.controls[later:]]),
            rates=None,
        )

    def state(self, name: str) -> Array:
        """Return the samples of the state called `name`, (N,)."""
        return self.states[:, _place(name, 'state', self.state_names)]

    def control(self, name: str) -> Array:
        """Return the samples of the control called `name`, (N,)."""
        return self.controls[:, _place(name, 'control', self.control_names)]

    def sample(self, t: ArrayLike) -> Sample:
        """Read states and controls at time(s) `t` [s], held at the ends outside the samples."""
        at = self._inside(t)
        return Sample(self._state_at(at), self._control_at(at))

    def controls_at(self, t: ArrayLike) -> Array:
        """Read the controls alone at time(s) `t` [s], as `sample` does."""
        return self._control_at(self._inside(t))

    def control_integral(self, t: ArrayLike) -> Array:
        """
        Integrate the controls from the first sample to time(s) `t` [s], (nu,) or (n, nu).

        Exact for the `interpolation` they have; they are zero outside the samples.
        """
        return np.asarray(self._control_antiderivative(self._inside(t)))

    def _inside(self, t: ArrayLike) -> Array:
        at: Array = np.clip(np.asarray(t, dtype=float), self.times[0], self.times[-1])
        return at

    def _control_at(self, t: Array) -> Array:
        if self.interpolation == 'zero_order_hold':
            index = np.searchsorted(self.times, t, side='right') - 1
            return self.controls[np.clip(index, 0, self.times.size - 1)]
        if self.interpolation == 'linear' or self.times.size < 4:
            return _linear(t, self.times, self.controls)
        return np.asarray(self.control_pieces(t))

    def _state_at(self, t: Array) -> Array:
        if self.rates is None:
            return _linear(t, self.times, self.states)
        index = np.clip(np.searchsorted(self.times, t, side='right') - 1, 0, self.times.size - 2)
        start, end = self.times[index], self.times[index + 1]
        h = (end - start)[..., None]
        s = ((t - start) / (end - start))[..., None]
        x0, x1 = self.states[index], self.states[index + 1]
        v0, v1 = self.rates[index, 0] * h, self.rates[index, 1] * h
        value: Array = (
            x0 + s * v0 + s**2 * (3 * (x1 - x0) - 2 * v0 - v1) + s**3 * (2 * (x0 - x1) + v0 + v1)
        )
        return value

    @cached_property
    def _control_antiderivative(self) -> PPoly:
        return self.control_pieces.antiderivative()

    def to_dict(self) -> dict[str, Any]:
        """Return what the JSON file holds: samples, interpolation, units, rates."""
        rates = [] if self.rates is None else np.moveaxis(self.rates, -1, 0).tolist()
        return {
            'times': self.times.tolist(),
            'states': {n: self.state(n).tolist() for n in self.state_names},
            'controls': {n: self.control(n).tolist() for n in self.control_names},
            'interpolation': self.interpolation,
            'units': self.units,
            'rates': dict(zip(self.state_names, rates, strict=False)),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Trajectory:
        """
        Return what `to_dict` was of; the samples are the same to the last bit.

        Raises
        ------
        InvalidProblem
            If a key is missing or the samples do not fit together.

        """
        try:
            states, controls = dict(data['states']), dict(data['controls'])
            units = {str(name): str(unit) for name, unit in data.get('units', {}).items()}
            told = [data['rates'].get(name, ()) for name in states] if data.get('rates') else None
            rates = None if told is None else np.moveaxis(np.asarray(told, float), 0, -1)
            if rates is not None and not np.isfinite(rates).all():
                raise InvalidProblem("trajectory 'rates' holds a value that is not finite")
            return cls(
                times=np.asarray(data['times'], dtype=float),
                states=np.asarray(list(states.values()), dtype=float).T,
                controls=np.asarray(list(controls.values()), dtype=float).T,
                state_names=tuple(states),
                control_names=tuple(controls),
                interpolation=data['interpolation'],
                state_units=tuple(units.get(name, '') for name in states) if units else (),
                control_units=tuple(units.get(name, '') for name in controls) if units else (),
                rates=rates,
            )
        except KeyError as error:
            raise InvalidProblem(f'the trajectory has no {error}') from None
        except (AttributeError, TypeError, ValueError) as error:
            raise InvalidProblem(f'the trajectory cannot be read: {error}') from None


@dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """
    A trajectory in time: its first sample is at the instant `start` [s] of some clock.

    The clock's zero must be so near that a float keeps nanoseconds.
    """

    trajectory: Trajectory
    start: float

    @property
    def end(self) -> float:
        """Instant of the last sample [s]."""
        return self.start + self.trajectory.duration

    def elapsed(self, time: T) -> T:
        """How far the plan has come at instant(s) [s]: seconds of the plan since its start."""
        return time - self.start

    def sample(self, time: ArrayLike) -> Sample:
        """Read states and controls at instant(s) [s], held at the ends outside the samples."""
        return self.trajectory.sample(self.trajectory.times[0] + self.elapsed(np.asarray(time)))

    def reference(self, time: float) -> Array:
        """Planned state (nx,) at an instant [s]; the ends are held."""
        return self.sample(time).state


class ReplayedMotion(NamedTuple):
    """
    A motion as it was integrated, in steps between the instants `steps` (m,) [s].

    `states` takes instants (n,) [s] and returns the states (n, nx) there.
    """

    steps: Array
    states: Callable[[Array], Array]


def lines(times: Array, values: Array) -> PPoly:
    """Return the lines between `values` (n + 1, m) at `times` (n + 1,)."""
    slopes = np.diff(values, axis=0) / np.diff(times)[:, None]
    # Before SciPy 1.15 `antiderivative` takes no times that are read-only.
    return PPoly(np.stack([slopes, values[:-1]]), times.copy())


def _place(name: str, kind: str, names: tuple[str, ...]) -> int:
    if name not in names:
        hint = suggestion(name, names) or f'it has {", ".join(names)}'
        raise InvalidProblem(f"the trajectory has no {kind} '{name}': {hint}")
    return names.index(name)


def _linear(t: Array, times: Array, values: Array) -> Array:
    columns = [np.interp(t, times, column) for column in values.T]
    return np.stack(columns, axis=-1) if columns else np.zeros((*t.shape, 0))


def joined(trajectories: Mapping[str, Trajectory]) -> Trajectory:
    """
    Return the only trajectory; of several all, on common instants as ``name.state``.

    Controls of a vehicle that has arrived are zero. Unless all are held, a jump takes 1 ns.
    """
    if len(trajectories) == 1:
        return next(iter(trajectories.values()))
    parts, instants = trajectories.items(), [t.times for t in trajectories.values()]
    held = [t.interpolation == 'zero_order_hold' for t in trajectories.values()]
    if not all(held):
        for t, jumps in zip(trajectories.values(), held, strict=True):
            beside = t.times[[*t.switches, -1]] + (-NANOSECOND if jumps else NANOSECOND)
            instants.append(to_nanoseconds(beside))
    times = np.unique(np.concatenate(instants))
    times = times[times <= max(t.times[-1] for t in trajectories.values())]
    states, controls = zip(*(t.sample(times) for t in trajectories.values()), strict=True)
    for t, jumps, control in zip(trajectories.values(), held, controls, strict=True):
        control[times >= t.times[-1] if jumps else times > t.times[-1]] = 0.0
    return Trajectory(
        times=times,
        states=np.concatenate(states, axis=1),
        controls=np.concatenate(controls, axis=1),
        state_names=tuple(f'{name}.{s}' for name, t in parts for s in t.state_names),
        control_names=tuple(f'{name}.{c}' for name, t in parts for c in t.control_names),
        interpolation='zero_order_hold' if all(held) else 'linear',
    )
