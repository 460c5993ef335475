# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The verdict on demos and recordings: the goal must be reached and held within all limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.plant_views import PlantView
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.mission import FollowedPlan, Mission, RecordedVehicle
from tdm_sim.report.signals import Signals, smallest

HOLD_TIME = 5.0  # s
_FIRST = 0.05  # s after the start, until when the command before it may act
_LAST = 0.1  # s by which a recording may end before the planned end


@dataclass(frozen=True)
class Verdict:
    """
    The verdict: `reasons` why the goal was missed.

    `undecided` says why there is no verdict: the measurements end too early, without a violation;
    '' if there is one. `held` tells whether the plans' ends can be held.
    """

    reasons: tuple[str, ...]
    undecided: str = ''
    held: bool = True

    @property
    def title(self) -> str:
        """Return the verdict in a few words."""
        if self.reached:
            return 'Goal reached and held' if self.held else 'Goal reached in passing'
        return 'Goal missed' if self.reasons else 'Not known'

    @property
    def reached(self) -> bool:
        """Whether the goal was reached and held within all limits."""
        return not self.reasons and not self.undecided


def judge(mission: Mission) -> Verdict | None:
    """
    Judge a mission; None if it lacks what that requires.

    After replans the plan active at the end of the recording counts: its goal, its planned end.
    Limits count from the start of the first plan on.
    """
    vehicles = tuple(_with_begun_plans(vehicle) for vehicle in mission.vehicles)
    if not vehicles or not all(_can_be_judged(vehicle) for vehicle in vehicles):
        return None
    reasons: list[str] = []
    ends: list[float] = []
    for vehicle in vehicles:
        found, end = _reached(vehicle)
        reasons += found
        ends += [] if end is None else [end]
        reasons += _violated(vehicle)
    reasons += _too_close(replace(mission, vehicles=vehicles))
    undecided = ''
    if ends and not reasons:
        undecided = (
            f'the recording ends at {min(ends):.1f} s, before the goal could be reached and held '
            f'for {HOLD_TIME:g} s'
        )
    held = all(vehicle.view.is_held(vehicle.plans[-1].trajectory) for vehicle in vehicles)
    return Verdict(tuple(reasons), undecided, held)


def judged_until(vehicle: RecordedVehicle) -> float:
    """Return until when limits count [s]: to the planned end where nothing holds the plant."""
    if vehicle.plan is None or vehicle.view.is_held(vehicle.plans[-1].trajectory):
        return math.inf
    return vehicle.plans[-1].end


def held_from(times: Array, shares: Array) -> float:
    """Return the earliest instant [s] from which `shares` (n,) stay below 1; inf if none."""
    outside = np.flatnonzero(~(shares < 1.0))
    first = outside[-1] + 1 if outside.size else 0
    return float(times[first]) if first < times.size else math.inf


def goal_errors(view: PlantView, plan: Trajectory, states: Signals) -> tuple[Array, Array]:
    """Return instants [s] and how far states are from a plan's goal then, as shares allowed."""
    needed = [name for names, _ in view.goal(plan)[1] for name in names]
    if not needed:
        return np.zeros(0), np.zeros(0)
    columns = states.select(needed).columns
    known = np.isfinite([*columns.values()]).all(axis=0)
    missed = view.missed_by(plan, {name: column[known] for name, column in columns.items()})
    return states.times[known], np.max([away / allowed for (_, allowed), away in missed], axis=0)


def arrival(vehicle: RecordedVehicle) -> float | None:
    """Return from when on the last goal was held [s]; inf if never, None if not known."""
    after = vehicle.states.between(vehicle.plans[0].start, math.inf)
    times, errors = goal_errors(vehicle.view, vehicle.plans[-1].trajectory, after)
    return held_from(times, errors) if times.size else None


def _with_begun_plans(vehicle: RecordedVehicle) -> RecordedVehicle:
    """Return the vehicle without the plans still pending at the end of what was measured."""
    end = max(vehicle.states.times[-1:], default=-math.inf)  # they are in order
    begun = tuple(plan for plan in vehicle.plans if plan.start < end)
    # The vehicle itself remembers its margins.
    return vehicle if begun == vehicle.plans else replace(vehicle, plans=begun)


def _can_be_judged(vehicle: RecordedVehicle) -> bool:
    if vehicle.plan is None or vehicle.view.problem is None or not vehicle.controls:
        return False
    return not vehicle.view.goal(vehicle.plan.trajectory)[1] or arrival(vehicle) is not None


def _reached(vehicle: RecordedVehicle) -> tuple[list[str], float | None]:
    """Return why a goal was missed; or when measurements end, if that is too early to tell."""
    view, plan, states = vehicle.view, vehicle.plans[-1], vehicle.states
    end = float(states.times[-1])
    late = f'{vehicle.name} was not at its goal'
    if not view.is_held(plan.trajectory):
        if end < plan.end - _LAST:
            return [], end
        at = states.at(np.array([min(plan.end, end)]))
        _, missed = goal_errors(view, plan.trajectory, at)
        found = _conditions(vehicle, plan, at)
        if (missed > 1.0).any():
            found.insert(0, f'{late} at the planned end{_worst(vehicle, plan, at)}')
        return found, None
    since = arrival(vehicle)
    since = plan.end if since is None else since
    settling = view.settling(plan.trajectory.duration)
    if since > plan.end + settling:
        if end <= plan.end + settling:
            return [], end
        when = f' within {settling:.3g} s of the planned end'
        return [f'{late}{when}{_worst(vehicle, plan, states.at(np.array([end])))}'], None
    if end - max(since, vehicle.plans[0].start) < HOLD_TIME:
        return [], end
    return _conditions(vehicle, plan, states.at(np.array([end]))), None


def _worst(vehicle: RecordedVehicle, plan: FollowedPlan, at: Signals) -> str:
    """Return the largest errors at an instant, in the states that the goal gives."""
    view = vehicle.view
    parts = [
        f'{", ".join(names)} by {away[0]:.3g} {view.kind.units.get(names[0], "")}'.rstrip()
        for (names, allowed), away in view.missed_by(plan.trajectory, at.columns)
        if not away[0] < allowed
    ]
    return f': off in {"; ".join(parts)}' if parts else ''


def _conditions(vehicle: RecordedVehicle, plan: FollowedPlan, at: Signals) -> list[str]:
    names = plan.trajectory.state_names
    if not set(names) <= set(at.columns):
        return []
    found = vehicle.view.end_conditions(plan.trajectory.duration, at.table(names)[0])
    return [
        f'{vehicle.name}: end condition {index} is {abs(value):.3g} times what is allowed'
        for index, value in enumerate(found.tolist())
        if not abs(value) < 1.0
    ]


def _violated(vehicle: RecordedVehicle) -> list[str]:
    """Return the limits that were violated from the start on, as long as they count."""
    # What a limit may be violated by: of the last plan little may be left.
    view, motions = vehicle.view, [one.trajectory for one in vehicle.plans]
    begun, until = vehicle.plans[0].start + _FIRST, judged_until(vehicle)
    judged = vehicle.margins.measured.between(begun, until)
    return [
        f"{vehicle.name} violated the limit '{name}' by {-margin.worst:.4g} {margin.unit}".rstrip()
        + f' after {margin.instant:.2f} s'
        for name, margin in smallest(judged).items()
        if not (margin.worst >= 0.0 or name in view.enforced)
        and not margin.worst >= -max(view.allowed(name, motion) for motion in motions)
    ]


def _too_close(mission: Mission) -> list[str]:
    least = mission.vehicles[0].view.separation
    if least is None:
        return []
    return [
        f'{pair} came within {margin.worst:.3f} m of each other, {least:g} m must be kept'
        for pair, margin in smallest(mission.separations.measured).items()
        if not margin.worst >= least
    ]
