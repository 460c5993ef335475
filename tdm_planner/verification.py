# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Nothing leaves the planner unverified: replay through the true dynamics, then a dense check.

Plants replay: they integrate from the first state, under the controls read between samples as
`Trajectory.interpolation` says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array, Integers, largest_of_unit
from tdm_planner.plants.base import Named
from tdm_planner.trajectory import ReplayedMotion, Trajectory

MOST_INSTANTS = 200_000  # of a check, beside those of its replay
_PER_STEP = 5  # intervals of a check in a step of the integration, and between two samples
# Parts of an interval in which a limit has a kink or jump, and of those: a gate is passed at once.
_AT_BREAKS, _TURNS = 64, 2
_PARTS, _DIVISIONS = 4, 12  # into which, and how often, an interval that may hide more is divided
_BEND = 2.0  # times the last change of a margin's slope: how much it may change next
_USUAL = 1e-3, 1e-6  # of a state's range, and at least: what motions may differ by
_WIDEST = 30.0  # times as much, where the goal is that wide


@dataclass(frozen=True)
class Constraint:
    """A limit to be kept: `margin(times, states, controls)` -> (n,) must be >= -`tolerance`."""

    name: str
    margin: Callable[[Array, Array, Array], Array]
    tolerance: float = 0.0
    unit: str = ''


@dataclass(frozen=True)
class Verification:
    """
    The result of a check.

    `terminal_error` (nx,) is the signed difference of the replayed final state from the goal;
    `worst` holds the smallest margin of every constraint by name (negative: violated),
    `worst_times` its instant [s] and `units` its unit; `reasons` says in words what failed, empty
    when `ok`.
    """

    ok: bool
    terminal_error: Array
    worst: Mapping[str, float] = field(default_factory=dict)
    worst_times: Mapping[str, float] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    state_names: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the check as JSON writes it."""
        names = self.state_names or tuple(str(i) for i in range(len(self.terminal_error)))
        return {
            'ok': self.ok,
            'terminal_error': dict(zip(names, map(float, self.terminal_error), strict=True)),
            'worst': {name: float(value) for name, value in self.worst.items()},
            'worst_times': {name: float(value) for name, value in self.worst_times.items()},
            'units': dict(self.units),
            'reasons': list(self.reasons),
        }


def even_times(first: float, last: float, resolution: float) -> Array:
    """Return instants from `first` to `last` [s], `resolution` s apart or less, not many."""
    return np.linspace(first, last, math.ceil(min((last - first) / resolution, MOST_INSTANTS)) + 1)


def verify(
    plant: Named,
    trajectory: Trajectory,
    replayed: ReplayedMotion,
    goal: Array,
    tolerance: Array,
    constraints: Sequence[Constraint],
    *,
    consistency: Array | None = None,
    start: Array | None = None,
    breaks: Callable[[Array, Array, Array], Array] | None = None,
) -> Verification:
    """
    Check a trajectory with its replay by the plant.

    `goal` and `tolerance` (nx,): the replayed final state must be within `tolerance` of `goal`
    (infinite where a state is free). The constraints are checked on the replayed states, as finely
    as the motion asks, see `resolved`. The states written in the trajectory must agree with the
    replayed ones within `consistency` (nx,): by default the smaller of `tolerance` and 30 times
    `usual_tolerance`; where a state is free, `usual_tolerance`. The first of them must agree with
    `start` (nx,), where that is given; NaN where a state is free. What `breaks`, as margins,
    return (n, k) changes its sign where a margin has a kink or jumps.
    """
    given = *resolved(replayed, trajectory, constraints, breaks), goal, tolerance, constraints
    return judge(plant, trajectory, *given, consistency=consistency, start=start)


def resolved(
    replayed: ReplayedMotion,
    trajectory: Trajectory,
    constraints: Sequence[Constraint],
    breaks: Callable[[Array, Array, Array], Array] | None = None,
) -> tuple[Array, Array]:
    """
    Instants (n,) and states (n, nx) at which a violation of the constraints shows.

    They divide the intervals between the samples of the trajectory, which carry its controls, and
    between the steps of the integration, which follow the motion however fast it is. Intervals in
    which a margin has a kink or jumps, or may dip below what is allowed, are divided further.
    """
    knots = np.union1d(trajectory.times, replayed.steps)
    times = np.union1d(_divided(knots, _PER_STEP), knots)
    states, most = replayed.states(times), times.size + MOST_INSTANTS
    if breaks is not None:
        for _ in range(_TURNS):
            found = crossed(breaks(times, states, trajectory.controls_at(times)))
            times, states = _denser(replayed, times, found, _AT_BREAKS)
    for _ in range(_DIVISIONS):
        hidden = _hidden(constraints, times, states, trajectory.controls_at(times))
        if not hidden.size or times.size > most:
            break
        times, states = _denser(replayed, times, hidden, _PARTS)
    return times, states


def crossed(breaks: Array) -> Integers:
    """Return the intervals in which one of the values (n, k) changes its sign."""
    positive = breaks > 0.0
    return np.flatnonzero((positive[1:] != positive[:-1]).any(axis=1))


def _denser(
    replayed: ReplayedMotion, times: Array, intervals: Integers, parts: int
) -> tuple[Array, Array]:
    """Return instants, and states, some of whose intervals are divided into so many parts."""
    begins, steps = times[intervals, None], np.diff(times)[intervals, None]
    times = np.union1d(times, begins + steps * np.arange(parts) / parts)
    return times, replayed.states(times)


def _divided(edges: Array, parts: int) -> Array:
    """Instants (n, ) that divide every interval between `edges` into so many parts."""
    shares = np.arange(parts) / parts
    return np.asarray((edges[:-1, None] + np.diff(edges)[:, None] * shares).ravel())


def _hidden(
    constraints: Sequence[Constraint], times: Array, states: Array, controls: Array
) -> Integers:
    """
    Return the intervals (n,) whose interior may violate a limit although both ends satisfy it.

    The least margin in an interval is estimated: lines from both neighbouring intervals, steeper
    by `_BEND` of the last change of slope, meet there. Where the margin jumps, it may fall from
    either end as steeply as it changes nearby, and more, likewise. Return none if a sample already
    violates a limit: the plan has failed.
    """
    found = np.zeros(times.size - 1, dtype=bool)
    for constraint in constraints:
        margin = np.asarray(constraint.margin(times, states, controls))
        if not (margin >= -constraint.tolerance).all():
            return np.zeros(0, dtype=np.intp)
        found |= _least_between(times, margin) < -constraint.tolerance
    return np.flatnonzero(found)


def _least_between(times: Array, margin: Array) -> Array:
    """Least values (n - 1,) that a margin (n,) may have between its instants, see `_hidden`."""
    step, slope = np.diff(times), np.diff(margin) / np.diff(times)
    change = np.abs(np.diff(slope))
    # Steepest fall from the beginning of an interval, and rise to its end; unknown at the ends.
    fall, rise = np.full(step.size, -np.inf), np.full(step.size, np.inf)
    fall[2:] = slope[1:-1] - _BEND * change[:-1]
    rise[:-2] = slope[1:-1] + _BEND * change[1:]
    begin, end = margin[:-1], margin[1:]
    least = np.minimum(begin, end)
    with np.errstate(all='ignore'):
        lowest = begin + fall * (begin - end + rise * step) / (rise - fall)
        lowest = np.where(np.isinf(fall), end - rise * step, lowest)
        lowest = np.where(np.isinf(rise), begin + fall * step, lowest)
    dips = (fall < 0.0) & (rise > 0.0) & np.isfinite(lowest)
    least = np.where(dips, np.minimum(lowest, least), least)
    slopes = np.lib.stride_tricks.sliding_window_view(np.pad(slope, 2, mode='edge'), 5)
    earlier, before, _, after, later = slopes.T
    smooth = np.abs(after - before) + _BEND * (np.abs(before - earlier) + np.abs(later - after))
    jumps = np.abs(slope - 0.5 * (before + after)) > _BEND * smooth
    steepest = np.abs([earlier, before, after, later]).max(axis=0)
    steepest += _BEND * np.maximum(np.abs(before - earlier), np.abs(later - after))
    return np.where(jumps, least - steepest * step, least)


def usual_tolerance(states: Array, units: Sequence[str]) -> Array:
    """Return 1e-3 of the largest range that a state (N, nx) of the same unit runs through."""
    share, least = _USUAL
    return share * largest_of_unit(np.ptp(states, axis=0), units) + least


def judge(
    plant: Named,
    trajectory: Trajectory,
    times: Array,
    states: Array,
    goal: Array,
    tolerance: Array,
    constraints: Sequence[Constraint],
    *,
    consistency: Array | None = None,
    start: Array | None = None,
) -> Verification:
    """
    Check a trajectory replayed at `times` (n,): states (n, nx); see `verify`.

    Every sample of the trajectory is among the `times`.
    """
    controls = trajectory.controls_at(times)
    error = np.where(np.isfinite(tolerance), states[-1] - goal, 0.0)
    reasons = _beyond(plant, error, tolerance, '{0} ends {2} from the goal')
    allowed = consistency
    if allowed is None:
        usual = usual_tolerance(trajectory.states, plant.state_units)
        # A wide goal allows no motion that is written far off the one that is flown.
        wide = np.minimum(tolerance, _WIDEST * usual)
        allowed = np.where(np.isfinite(tolerance), wide, usual)
    written = np.searchsorted(times, trajectory.times)
    drift = np.abs(states[written] - trajectory.states).max(axis=0)
    reasons += _beyond(plant, drift, allowed, '{0} as written differs by {1:.3g} from the replay')
    if start is not None:
        away = np.nan_to_num(trajectory.states[0] - start)
        reasons += _beyond(plant, away, allowed, '{0} begins {2} from the start')
    worst, worst_times, violated = check(constraints, times, states, controls)
    reasons += violated
    if not np.isfinite(states).all():
        reasons = ['its motion is too fast to be replayed']
    return Verification(
        ok=not reasons,
        terminal_error=error,
        worst=worst,
        worst_times=worst_times,
        reasons=tuple(reasons),
        state_names=plant.state_names,
        units={constraint.name: constraint.unit for constraint in constraints},
    )


def _beyond(plant: Named, errors: Array, allowed: Array, text: str) -> list[str]:
    """Say which errors are larger than allowed; `text` takes name, error, error with its unit."""
    given = zip(plant.state_names, plant.state_units, np.abs(errors), allowed, strict=True)
    return [
        text.format(name, error, f'{error:.3g} {unit}'.rstrip()) + f' (allowed {most:.3g})'
        for name, unit, error, most in given
        if not error <= most
    ]


def check(
    constraints: Sequence[Constraint], times: Array, states: Array, controls: Array
) -> tuple[dict[str, float], dict[str, float], list[str]]:
    """Worst margin and its instant for every constraint, and a sentence for each violated one."""
    worst: dict[str, float] = {}
    worst_times: dict[str, float] = {}
    violated: list[str] = []
    for constraint in constraints:
        margin = np.asarray(constraint.margin(times, states, controls))
        finite = bool(np.isfinite(margin).all())
        index = int(np.argmin(margin)) if finite else int(np.argmin(np.isfinite(margin)))
        worst[constraint.name] = float(margin[index])
        worst_times[constraint.name] = float(times[index])
        if not (finite and margin[index] >= -constraint.tolerance):
            violated.append(
                f'{constraint.name} is violated by {-margin[index]:.3g} {constraint.unit}'.rstrip()
                + f' at t = {times[index]:.3f} s'
            )
    return worst, worst_times, violated
