# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Margins of plans and measured motions over time.

The limits are those of the planner's verification, for the parameters that it published.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import itertools
from typing import NamedTuple

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.verification import Constraint
from tdm_sim.report.mission import Mission, RecordedVehicle, Signals

ROUNDING = 1e-6  # of a margin, in its unit
_STEP = 0.01  # s, between instants at which planned distances are computed


class History(NamedTuple):
    """Planned and measured histories of the same quantities."""

    planned: Signals = Signals()
    measured: Signals = Signals()


class Margin(NamedTuple):
    """Smallest value of a history, for a limit negative where violated, and its instant [s]."""

    worst: float
    instant: float
    unit: str


def margin_history(vehicle: RecordedVehicle) -> History:
    """Return the margin of every constraint over time; negative values are violations."""
    plan = vehicle.plan
    constraints = () if plan is None else vehicle.view.constraints(plan.trajectory)
    if not constraints:
        return History()
    times, states, controls = vehicle.followed()
    tables = (signals.table([*signals.columns]) for signals in (states, controls))
    planned = margins_of(constraints, states.times, times, *tables)
    return History(planned, _measured(vehicle, constraints))


def _measured(vehicle: RecordedVehicle, constraints: Sequence[Constraint]) -> Signals:
    """Margins of what was measured, from the start of the first plan on."""
    states = vehicle.states.between(vehicle.plans[0].start, np.inf)
    if not states.times.size:
        return Signals()
    plan = vehicle.plans[-1]
    own, names = states.table(plan.trajectory.state_names), plan.trajectory.control_names
    controls = vehicle.controls.at(states.times).table(names)
    return margins_of(constraints, states.times, states.times - plan.start, own, controls)


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


def separations(mission: Mission) -> History:
    """Return the distance of every pair of vehicles over time, called ``one - other``."""
    moving = [v for v in mission.vehicles if v.view.place]
    planned = [v for v in moving if v.plans]
    seen = {v.name: v.states for v in moving if v.states}
    found = History()
    if len(planned) > 1:
        start, end = min(v.plans[0].start for v in planned), max(v.plans[-1].end for v in planned)
        times = np.linspace(start, end, min(int((end - start) / _STEP) + 2, 20_000))
        states = {v.name: v.planned(times)[0] for v in planned}
        found = History(planned=_distances(states, times, moving[0].view.place))
    if len(seen) > 1:
        times = max(seen.values(), key=lambda states: states.times.size).times
        found = History(found.planned, _distances(seen, times, moving[0].view.place))
    return found


def _distances(states: Mapping[str, Signals], times: Array, place: tuple[str, ...]) -> Signals:
    places = {name: known.at(times).table(place) for name, known in states.items()}
    apart = {
        f'{one} - {other}': np.hypot(*(places[one] - places[other]).T)
        for one, other in itertools.combinations(places, 2)
    }
    return Signals(times, apart, dict.fromkeys(apart, 'm'))
