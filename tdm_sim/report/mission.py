# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A mission: what was planned, commanded and measured, from any kind of recording.

All instants are seconds since the mission's origin: the start of the first plan's motion or, where
there is no plan, the first measurement. What came before has negative instants.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
import itertools
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.nodes.reading import Level
from tdm_planner.plant_kind import PlantKind
from tdm_planner.plant_views import PlantView
from tdm_planner.trajectory import Sample, TimedTrajectory
from tdm_sim.report.signals import History, margins_of, Signals

_INSTANTS = 1001  # of a plan, beside its own
_STEP = 0.01  # s, between instants at which planned distances are computed
_APART = 1e-9  # s


@dataclass(frozen=True, eq=False)
class FollowedPlan(TimedTrajectory):
    """
    One published plan of one vehicle; its motion starts `start` s after the mission's origin.

    It is followed `until` the next plan starts (None: to the end).
    """

    until: float | None = None

    @property
    def followed_until(self) -> float:
        """Instant until which the plan was to be followed: its end, or the next plan's start."""
        return self.end if self.until is None else min(self.end, self.until)


@dataclass(frozen=True, eq=False)
class RecordedVehicle:
    """
    One plant: its plans, its commands, its measured motion.

    `name` is the robot's, or the plant's where there is one only; `plans` stand in the order of
    their starts. `states` and `applied` are measured: the states, and the controls that the plant
    applied; `commands` are the tracker's. All bear the names of the plan's states and controls.
    """

    name: str
    view: PlantView
    plans: tuple[FollowedPlan, ...] = ()
    states: Signals = Signals()
    commands: Signals = Signals()
    applied: Signals = Signals()

    @property
    def plan(self) -> FollowedPlan | None:
        """Return the last plan, whose goal counts."""
        return self.plans[-1] if self.plans else None

    @property
    def controls(self) -> Signals:
        """Return the controls as applied or, if that was not recorded, as commanded."""
        return self.applied or self.commands

    def planned(self, times: Array) -> tuple[Signals, Signals]:
        """Return planned states and controls at instants (n,), of the plans in turn."""
        read = self.plans[0].sample(times)
        for plan in self.plans[1:]:
            during = times >= plan.start
            read.state[during], read.control[during] = plan.sample(times[during])
        return Signals.both(self.plans[0].trajectory, times, read)

    @cached_property
    def followed(self) -> tuple[Array, Signals, Signals]:
        """
        Return what was planned while plans were followed, behind each of them NaN as a gap.

        These are times (n,) since the plans' starts, states and controls, at the plans' own
        instants and evenly spread ones.
        """
        if not self.plans:
            return np.zeros(0), Signals(), Signals()
        parts = []
        for plan in self.plans:
            motion, end = plan.trajectory, plan.followed_until - plan.start
            at = np.union1d(np.linspace(0.0, motion.duration, _INSTANTS), motion.times)
            # an instant and its double, rounded differently, would make a needle in a held control
            at = at[(at < end - _APART) & np.append(np.diff(at) > _APART, True)]
            at = np.append(at, end)
            gapped = (
                np.pad(v, ((0, 1), (0, 0)), constant_values=np.nan) for v in motion.sample(at)
            )
            parts.append((plan.start + np.append(at, end), np.append(at, end), *gapped))
        instants, times, *read = map(np.concatenate, zip(*parts, strict=True))
        return times, *Signals.both(self.plans[0].trajectory, instants, Sample(*read))

    @cached_property
    def margins(self) -> History:
        """
        Margin of every constraint, of what was measured from the start of the first plan on.

        Negative values are violations. The limits are those of the planner's verification, for
        the parameters that it published.
        """
        plan = self.plan
        constraints = () if plan is None else self.view.constraints(plan.trajectory)
        if plan is None or not constraints:
            return History()
        times, *read = self.followed
        tables = (signals.table(signals.columns) for signals in read)
        planned = margins_of(constraints, read[0].times, times, *tables)
        seen = self.states.between(self.plans[0].start, np.inf)
        if not seen.times.size:
            return History(planned)
        states = seen.table(plan.trajectory.state_names)
        controls = self.controls.at(seen.times).table(plan.trajectory.control_names)
        times = seen.times - plan.start
        return History(planned, margins_of(constraints, seen.times, times, states, controls))

    @cached_property
    def tracking_errors(self) -> Signals:
        """Return measured minus planned while plans were followed."""
        if not self.plans:
            return Signals()
        found = self.states.between(self.plans[0].start, self.plans[-1].end)
        if not found.times.size:
            return Signals()
        planned, _ = self.planned(found.times)
        errors = {
            name: self.view.away(name, found.columns[name] - column)
            for name, column in planned.columns.items()
            if name in found.columns
        }
        return Signals(found.times, errors, found.units)


@dataclass(frozen=True)
class PlanFigures:
    """
    The planner's figures of a plan; None or empty where they are not known.

    `late` says whether it was published after the start of its motion; `terminal_error` is the
    replayed final state's difference from the goal, by state (of several vehicles
    ``vehicle.state``); `parameters` are the problem's, by dotted name; `vehicles` are by name;
    `document` is what all this was read from.
    """

    cost: float | None = None
    cost_terms: Mapping[str, float] = field(default_factory=dict)
    solve_time: float | None = None
    late: bool = False
    summary: str = ''
    terminal_error: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, object] = field(default_factory=dict)
    problem: str = ''
    vehicles: Mapping[str, PlantKind] = field(default_factory=dict)
    document: Mapping[str, Any] = field(default_factory=dict)


class Event(NamedTuple):
    """Something a node reported: a rejected plan, a new one, a missed deadline, an error."""

    time: float
    level: Level
    source: str
    text: str


@dataclass(frozen=True, eq=False)
class Mission:
    """
    Everything that a report shows.

    `figures` has an entry for every plan, in the order of their starts; `missing` says in
    sentences what is not there and what follows from it; `source` is the file or folder it was
    read from; `recorded_at` is the origin's wall-clock time [s since the epoch], None for a plan
    without a recorded motion.
    """

    title: str
    vehicles: tuple[RecordedVehicle, ...]
    figures: tuple[PlanFigures, ...] = ()
    events: tuple[Event, ...] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    source: str = ''
    recorded_at: float | None = None

    @property
    def was_executed(self) -> bool:
        """Whether anything was measured."""
        return any(vehicle.states for vehicle in self.vehicles)

    @property
    def plans(self) -> list[FollowedPlan]:
        """Return the plans of all vehicles."""
        return [plan for vehicle in self.vehicles for plan in vehicle.plans]

    @cached_property
    def span(self) -> tuple[float, float]:
        """First and last instant [s] of everything planned and measured."""
        instants = [0.0, *(at for plan in self.plans for at in (plan.start, plan.end))]
        for vehicle in self.vehicles:
            for signals in (vehicle.states, vehicle.commands, vehicle.applied):
                if signals.times.size:
                    instants += [float(signals.times[0]), float(signals.times[-1])]
        return min(instants), max(instants)

    @cached_property
    def separations(self) -> History:
        """
        Return the distance of every pair of vehicles, called ``one - other``.

        What was measured counts from the start of the first plan on, if there is one.
        """
        moving = [v for v in self.vehicles if v.view.place]
        planned = [v for v in moving if v.plans]
        start = min((v.plans[0].start for v in planned), default=-np.inf)
        seen = {v.name: v.states.between(start, np.inf) for v in moving if v.states}
        found = History()
        if len(planned) > 1:
            end = max(v.plans[-1].end for v in planned)
            times = np.linspace(start, end, min(int((end - start) / _STEP) + 2, 20_000))
            states = {v.name: v.planned(times)[0] for v in planned}
            found = History(planned=_distances(states, times, moving[0].view.place))
        if len(seen) > 1:
            times = max(seen.values(), key=lambda states: states.times.size).times
            found = History(found.planned, _distances(seen, times, moving[0].view.place))
        return found

    def is_early(self, event: Event) -> bool:
        """Whether an event came before the motion: while the nodes were starting."""
        return event.time < 0.0 and bool(self.plans)

    @property
    def deadline(self) -> float | None:
        """Return the time [s] that the planner had for a plan, if the parameters tell."""
        value = self.parameters.get('solver.deadline')
        return float(value) if isinstance(value, (int, float)) else None


def _distances(states: Mapping[str, Signals], times: Array, place: tuple[str, ...]) -> Signals:
    places = {name: known.at(times).table(place) for name, known in states.items()}
    apart = {
        f'{one} - {other}': np.hypot(*(places[one] - places[other]).T)
        for one, other in itertools.combinations(places, 2)
    }
    return Signals(times, apart, dict.fromkeys(apart, 'm'))
