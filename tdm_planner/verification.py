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
Nothing leaves the planner unverified: replay through the true dynamics, then a dense check.

The replay integrates the plant with DOP853 (scipy), independently of the solver's own integration,
from the first state, under the controls read between samples as `Trajectory.interpolation` says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import itertools
import math
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tdm_planner.exceptions import NotFinite
from tdm_planner.plants.base import Plant
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

MOST_EVALUATIONS = 500_000  # of the equations of motion in a replay, some seconds' worth
MOST_INSTANTS = 200_000  # of a check: 200 s at intervals of 1 ms


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


@runtime_checkable
class SelfReplaying(Protocol):
    """A plant whose motion under given controls is a matter of quadrature."""

    def replay(self, trajectory: Trajectory, times: Array) -> Array | None:
        """States at `times` (n,) from the first state of `trajectory`, (n, nx); None: cannot."""


def replay(plant: Plant, trajectory: Trajectory, times: Array) -> Array:
    """
    Integrate the plant along the trajectory's controls; states at `times`, (n, nx).

    The integration restarts wherever a held control jumps, so that no step spans a switch; where
    it cannot go on, the remaining states are NaN, which no check passes. A plant
    that can integrate itself exactly, by quadrature, does so (`SelfReplaying`).
    """
    if isinstance(plant, SelfReplaying):
        exact = plant.replay(trajectory, times)
        if exact is not None:
            return exact
    edges = _smooth_pieces(trajectory)
    states = np.full((times.size, trajectory.states.shape[1]), np.nan)
    left = itertools.repeat(None, MOST_EVALUATIONS)
    current = trajectory.states[0]
    for first, last in itertools.pairwise(edges):
        start, end = trajectory.times[first], trajectory.times[last]
        inside = (times >= start) & (times <= end)
        result = solve_ivp(
            _limited(_right_hand_side(plant, trajectory, first), left),
            (start, end),
            current,
            method='DOP853',
            rtol=1e-9,
            atol=1e-11,
            dense_output=True,
        )
        if not result.success:
            break
        if inside.any():
            assert result.sol is not None
            states[inside] = result.sol(times[inside]).T
        current = result.y[:, -1]
    return states


def _smooth_pieces(trajectory: Trajectory) -> list[int]:
    last = trajectory.times.size - 1
    if trajectory.interpolation == 'cubic':
        return [0, last]
    if trajectory.interpolation == 'linear':
        return list(range(last + 1))
    jumps = np.flatnonzero((np.diff(trajectory.controls[:-1], axis=0) != 0).any(axis=1)) + 1
    return [0, *jumps.tolist(), last]


def _right_hand_side(
    plant: Plant, trajectory: Trajectory, first: int
) -> Callable[[float, Array], Array]:
    held = trajectory.controls[first] if trajectory.interpolation == 'zero_order_hold' else None

    def rate(t: float, x: Array) -> Array:
        try:
            return plant.derivative(x, trajectory.sample(t).control if held is None else held)
        except NotFinite as error:
            raise NotFinite(f'{error} at t = {t:.3g} s of the replay') from error

    return rate


def _limited(
    right_hand_side: Callable[[float, Array], Array], left: Iterator[None]
) -> Callable[[float, Array], Array]:
    def evaluated(t: float, x: Array) -> Array:
        if next(left, 0) is not None:
            raise FloatingPointError('the motion is too fast to be replayed')
        return right_hand_side(t, x)

    return evaluated


def dense_times(trajectory: Trajectory, resolution: float) -> Array:
    """Every sample instant and instants between them, see `evenly_spaced`."""
    grid = evenly_spaced(trajectory.times[0], trajectory.times[-1], resolution)
    return np.union1d(grid, trajectory.times)


def evenly_spaced(first: float, last: float, resolution: float) -> Array:
    """
    Instants from `first` to `last`, `resolution` s apart or less, at most MOST_INSTANTS.

    A check must end in the time allowed, however long the motion.
    """
    count = math.ceil(min((last - first) / resolution, MOST_INSTANTS)) + 1
    return np.linspace(first, last, count)


def verify(
    plant: Plant,
    trajectory: Trajectory,
    goal: Array,
    tolerance: Array,
    constraints: Sequence[Constraint],
    *,
    resolution: float = 1e-3,
    consistency: Array | None = None,
    start: Array | None = None,
) -> Verification:
    """
    Replay and check a trajectory.

    `goal` and `tolerance` (nx,): the replayed final state must be within `tolerance` of `goal`
    (infinite where a state is free). The constraints are checked on the replayed states at
    instants at most `resolution` s apart. The states written in the trajectory must agree with the
    replayed ones within `consistency` (nx,), by default `tolerance`, and the first of them with
    `start` (nx,), where that is given; NaN where a state is free.
    """
    times = dense_times(trajectory, resolution)
    states = replay(plant, trajectory, times)
    return judge(
        plant,
        trajectory,
        times,
        states,
        goal,
        tolerance,
        constraints,
        consistency=consistency,
        start=start,
    )


def judge(
    plant: Plant,
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
    reasons = [
        f'{name} ends {abs(e):.3g} {unit} from the goal (allowed {tol:.3g})'
        for name, unit, e, tol in zip(
            plant.state_names, plant.state_units, error, tolerance, strict=True
        )
        if not abs(e) <= tol
    ]
    allowed = tolerance if consistency is None else consistency
    written = np.searchsorted(times, trajectory.times)
    drift = np.abs(states[written] - trajectory.states).max(axis=0)
    reasons += [
        f'{name} as written differs by {d:.3g} from the replay (allowed {a:.3g})'
        for name, d, a in zip(plant.state_names, drift, allowed, strict=True)
        if not d <= a
    ]
    if start is not None:
        away = np.nan_to_num(np.abs(trajectory.states[0] - start))
        reasons += [
            f'{name} begins {d:.3g} {unit} from the start (allowed {a:.3g})'
            for name, unit, d, a in zip(
                plant.state_names, plant.state_units, away, allowed, strict=True
            )
            if not d <= a
        ]
    worst, worst_times, violated = check(constraints, times, states, controls)
    reasons += violated
    return Verification(
        ok=not reasons,
        terminal_error=error,
        worst=worst,
        worst_times=worst_times,
        reasons=tuple(reasons),
        state_names=plant.state_names,
        units={constraint.name: constraint.unit for constraint in constraints},
    )


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
