# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Histories of named quantities, the margins of limits among them, and their smallest values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.trajectory import Sample, Trajectory
from tdm_planner.verification import Constraint

ROUNDING = 1e-6  # of a margin, in its unit


@dataclass(frozen=True, eq=False)
class Signals:
    """
    Named time histories on common instants.

    `times` (n,) s since the mission's origin, not decreasing; `columns` (n,) by name, NaN where
    nothing was measured; `units` by name, as far as there are any. By default there are no
    histories, and it is false.
    """

    times: Array = field(default_factory=lambda: np.zeros(0))
    columns: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Whether there are any histories."""
        return bool(self.columns)

    @classmethod
    def both(cls, motion: Trajectory, times: Array, sample: Sample) -> tuple[Signals, Signals]:
        """Return states and controls as they were read at `times` (n,) from a trajectory."""
        states = dict(zip(motion.state_names, sample.state.T, strict=True))
        controls = dict(zip(motion.control_names, sample.control.T, strict=True))
        return cls(times, states, motion.units), cls(times, controls, motion.units)

    def table(self, names: Iterable[str]) -> Array:
        """Return the histories called `names`, (n, m); NaN where there is none."""
        columns = [*self.select(names).columns.values()]
        return np.stack(columns, axis=1) if columns else np.zeros((self.times.size, 0))

    def select(self, names: Iterable[str]) -> Signals:
        """Return the histories called `names`, in this order; NaN where there is none."""
        unknown = np.full(self.times.size, np.nan)
        return replace(self, columns={name: self.columns.get(name, unknown) for name in names})

    def between(self, start: float, end: float) -> Signals:
        """Return what lies in [start, end] s."""
        inside = (self.times >= start) & (self.times <= end)
        found = {name: column[inside] for name, column in self.columns.items()}
        return Signals(self.times[inside], found, self.units)

    def at(self, times: Array) -> Signals:
        """Return the histories at `times` (k,) by linear interpolation; NaN outside."""
        if not self.times.size:
            return Signals(times, {}, self.units).select(self.columns)
        found = {
            name: np.interp(times, self.times, column, left=np.nan, right=np.nan)
            for name, column in self.columns.items()
        }
        return Signals(times, found, self.units)


class History(NamedTuple):
    """Planned and measured histories of the same quantities."""

    planned: Signals = Signals()
    measured: Signals = Signals()


class Margin(NamedTuple):
    """Smallest value of a history, for a limit negative where violated, and its instant [s]."""

    worst: float
    instant: float
    unit: str


def margins_of(
    constraints: Sequence[Constraint],
    instants: Array,
    times: Array,
    states: Array,
    controls: Array,
) -> Signals:
    """Return margins at `instants`, which are `times` of the plan; all arrays begin with (n,)."""
    with np.errstate(all='ignore'):
        found = {
            c.name: np.broadcast_to(c.margin(times, states, controls), instants.shape)
            for c in constraints
        }
    return Signals(instants, found, {c.name: c.unit for c in constraints})


def smallest(history: Signals) -> dict[str, Margin]:
    """Return the smallest value of every history and its instant, without empty histories."""
    found: dict[str, Margin] = {}
    for name, column in history.columns.items():
        if np.isfinite(column).any():
            k, unit = int(np.nanargmin(column)), history.units.get(name, '')
            found[name] = Margin(float(column[k]), float(history.times[k]), unit)
    return found
