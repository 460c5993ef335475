# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Charts: states and controls, planned and measured; margins, distances, tracking errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from tdm_sim.report.charts import Chart, Curve, Kind, Panel
from tdm_sim.report.comparison import Comparison
from tdm_sim.report.margins import smallest
from tdm_sim.report.mission import FollowedPlan, Mission, Signals, Vehicle

Array = NDArray[np.float64]
Group = Literal['states', 'controls']
Sources = Mapping[Kind, Callable[[Vehicle], Signals | None]]  # by the kind of their curves

# Points of all curves together: a page stays below 8 MB however many vehicles there are.
MOST_POINTS = 200_000
FEWEST_PER_CURVE, MOST_PER_CURVE = 60, 3000
SHOWN_PAIRS = 6  # of vehicles
_OTHER_CURVES = 24  # distances, limits
_COLOURS = {'planned': 0, 'measured': 1, 'commanded': 2, 'error': 1}  # of a single vehicle


def points_per_curve(mission: Mission) -> int:
    """Return how many points a curve may have."""
    curves = _OTHER_CURVES
    for vehicle in mission.vehicles:
        recorded = (vehicle.states, vehicle.commands, vehicle.applied, vehicle.states)
        curves += sum(len(signals.names) for signals in recorded if signals is not None)
        kind = vehicle.view.kind
        curves += 2 * (len(kind.state_names) + len(kind.control_names))
    return int(np.clip(MOST_POINTS // curves, FEWEST_PER_CURVE, MOST_PER_CURVE))


def state_chart(mission: Mission) -> Chart:
    """Every state, planned and measured."""
    sources: Sources = {
        'planned': lambda vehicle: _planned(mission, vehicle, 'states'),
        'measured': lambda vehicle: vehicle.states,
    }
    return Chart('states', 'States', _history(mission, sources))


def control_chart(mission: Mission) -> Chart:
    """Every control: planned, commanded by the tracker, applied by the plant."""
    sources: Sources = {
        'planned': lambda vehicle: _planned(mission, vehicle, 'controls'),
        'measured': lambda vehicle: vehicle.applied,
        'commanded': lambda vehicle: vehicle.commands,
    }
    return Chart('controls', 'Controls', _history(mission, sources, held=True))


def margin_chart(mission: Mission, comparison: Comparison) -> Chart:
    """How far every constraint is from being violated."""
    sources: Sources = {
        'planned': lambda vehicle: comparison.margins[vehicle.name].planned,
        'measured': lambda vehicle: comparison.margins[vehicle.name].measured,
    }
    panels = tuple(replace(panel, limits=(0.0,)) for panel in _panels(mission, sources))
    note = 'Distance from the limit: what is below zero is a violation.'
    return Chart('margins', 'Constraint margins', panels, note)


def error_chart(mission: Mission, comparison: Comparison) -> Chart:
    """How far the vehicles were from their plans."""
    sources: Sources = {'error': lambda vehicle: comparison.tracking_errors.get(vehicle.name)}
    panels = _panels(mission, sources)
    return Chart('errors', 'Tracking errors', panels, 'Measured less planned.')


def distance_chart(mission: Mission, comparison: Comparison) -> Chart:
    """Distances of pairs of robots, of many pairs those that come closest."""
    history = comparison.separations
    nearest: dict[str, float] = {}
    for name, distance in [
        *smallest(history.planned).items(),
        *smallest(history.measured).items(),
    ]:
        nearest[name] = min(nearest.get(name, np.inf), distance.worst)
    closest = sorted(nearest, key=lambda name: nearest[name])[:SHOWN_PAIRS]
    names = [name for name in nearest if name in closest]
    most = points_per_curve(mission)
    curves = []
    both: dict[Kind, Signals | None] = {'planned': history.planned, 'measured': history.measured}
    for kind, signals in both.items():
        for k, name in enumerate(names):
            if signals is not None and name in signals:
                thin = signals.select(name).thinned(most)
                colour = k if len(names) > 1 else (0 if kind == 'planned' else 1)
                series = name if len(names) > 1 else ''
                curves.append(Curve(kind, thin.times, thin.values[:, 0], colour, series))
    minimum = mission.vehicles[0].view.separation if mission.vehicles else None
    limits = () if minimum is None else (minimum,)
    panel = Panel('distance', 'm', tuple(curves), 'between centres', limits)
    note = f'The {len(names)} of {len(nearest)} pairs that come closest.'
    return Chart('distances', 'Distances', (panel,), note if len(nearest) > len(names) else '')


def _history(mission: Mission, sources: Sources, held: bool = False) -> tuple[Panel, ...]:
    """Return panels of states or controls with their limits, and the switches of the plans."""
    limits: dict[str, set[float]] = {}
    for vehicle in mission.vehicles:
        for name, levels in vehicle.view.bounds().items():
            limits.setdefault(name, set()).update(levels)
    plans = [plan for vehicle in mission.vehicles for plan in vehicle.plans]
    switches = tuple(sorted({at for plan in plans for at in _switches(plan).tolist()}))
    return tuple(
        replace(panel, limits=tuple(sorted(limits.get(panel.title, ()))), switches=switches)
        for panel in _panels(mission, sources, held)
    )


def _panels(mission: Mission, sources: Sources, held: bool = False) -> tuple[Panel, ...]:
    """Return a panel for every name; a plan's controls that are `held` make steps."""
    most, several = points_per_curve(mission), len(mission.vehicles) > 1
    curves: dict[str, list[Curve]] = {}
    units: dict[str, str] = {}
    for k, vehicle in enumerate(mission.vehicles):
        for kind, source in sources.items():
            signals = source(vehicle)
            colour = k if several else _COLOURS[kind]
            steps = held and kind == 'planned'
            steps &= any(p.trajectory.interpolation == 'zero_order_hold' for p in vehicle.plans)
            for name in () if signals is None else signals.names:
                assert signals is not None
                thin = signals.select(name).thinned(most)
                series = vehicle.name if several else ''
                curve = Curve(kind, thin.times, thin.values[:, 0], colour, series, steps)
                curves.setdefault(name, []).append(curve)
                units[name] = units.get(name, '') or thin.units[0]
    words = mission.vehicles[0].view.labels if mission.vehicles else {}
    return tuple(
        Panel(name, units[name], tuple(found), words.get(name, ''))
        for name, found in curves.items()
    )


def _planned(mission: Mission, vehicle: Vehicle, group: Group) -> Signals | None:
    """Return every plan as long as it was followed, with gaps between them."""
    if not vehicle.plans:
        return None
    most = points_per_curve(mission) // len(vehicle.plans) - 3
    times: list[Array] = []
    values: list[Array] = []
    for plan in vehicle.plans:
        at = plan_instants(plan, most)
        read = _states(plan, at) if group == 'states' else plan.sample(at).control
        times += [at, at[-1:]]
        values += [read, np.full((1, read.shape[1]), np.nan)]
    motion = vehicle.plans[0].trajectory
    names = motion.state_names if group == 'states' else motion.control_names
    return Signals.of(motion, np.concatenate(times), np.concatenate(values), names)


def _switches(plan: FollowedPlan) -> Array:
    """Return the instants at which a held control of the plan jumps while it is followed [s]."""
    motion = plan.trajectory
    instants: Array = plan.start + motion.times[motion.switches]
    return instants[instants <= plan.followed_until]


def _states(plan: FollowedPlan, at: Array) -> Array:
    """Read states of a plan; smoothly where only its samples are known but it is smooth."""
    motion = plan.trajectory
    if motion.interpolation != 'cubic' or motion.rates is not None or motion.times.size < 4:
        return plan.sample(at).state
    return np.asarray(CubicSpline(motion.times, motion.states)(at - plan.start))


def plan_instants(plan: FollowedPlan, most: int = MOST_PER_CURVE) -> Array:
    """
    Return about `most` instants at which a plan is drawn while it is followed.

    Its samples as far as they are few, its switches in any case, and instants between them.
    """
    end = plan.followed_until
    even = np.linspace(plan.start, end, min(max(most // 2, 2), 400))
    samples = plan.start + plan.trajectory.times
    if samples.size > most // 2:
        samples = _switches(plan)
    instants: Array = np.union1d(samples[samples < end], even)
    # an instant and its double, rounded differently, would make a needle in a held control
    apart: Array = instants[np.append(True, np.diff(instants) > 1e-9)]
    return apart
