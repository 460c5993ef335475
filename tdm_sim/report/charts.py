# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Charts of a mission: states, controls, margins, distances, errors; planned and measured."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from tdm_planner.arrays import Array
from tdm_planner.drawing import COLOURS
from tdm_planner.trajectory import Sample
from tdm_sim.report.comparison import Comparison
from tdm_sim.report.margins import History, smallest
from tdm_sim.report.mission import FollowedPlan, Mission, RecordedVehicle, Signals

Kind = Literal['planned', 'measured', 'commanded', 'error', 'limit', 'switching']
Sources = Mapping[Kind, Sequence[Signals | None]]  # of every vehicle, by the kind of their curves

# Points of all curves together: a page stays below 8 MB however many vehicles there are.
MOST_POINTS = 200_000
FEWEST_PER_CURVE, MOST_PER_CURVE = 60, 3000
SHOWN_PAIRS = 6  # of vehicles
_OTHER_CURVES = 24  # distances, limits
_COLOURS = {'planned': 0, 'measured': 1, 'commanded': 2, 'error': 1}  # of a single vehicle
_PADDING = 0.08
_FROM_BELOW = ('measured', 'commanded', 'planned', 'error')


class Curve(NamedTuple):
    """
    One line: `times` and `values` (n,), NaN a gap; `colour` is the number of its colour.

    The legend switches curves by their kind and by their `series`, the vehicle or pair of vehicles
    they belong to ('' where there is only one), in all charts. `held`: the value stays until the
    next sample.
    """

    kind: Kind
    times: Array
    values: Array
    colour: int
    series: str = ''
    held: bool = False


class Panel(NamedTuple):
    """One quantity over time, with its limits and the instants at which a control switches."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    description: str = ''
    limits: tuple[float, ...] = ()
    switches: tuple[float, ...] = ()


class Chart(NamedTuple):
    """Panels on one time axis; `key` names it in the page, `note` explains it in a line."""

    key: str
    title: str
    panels: tuple[Panel, ...]
    note: str = ''


def mission_charts(mission: Mission, comparison: Comparison) -> list[Chart]:
    """Return the charts that have anything to show."""
    vehicles = mission.vehicles
    plans = [_planned(mission, vehicle) for vehicle in vehicles]
    states: Sources = {
        'planned': [state for state, _ in plans],
        'measured': [vehicle.states for vehicle in vehicles],
    }
    controls: Sources = {
        'planned': [control for _, control in plans],
        'measured': [vehicle.applied for vehicle in vehicles],
        'commanded': [vehicle.commands for vehicle in vehicles],
    }
    margins = [comparison.margins[vehicle.name] for vehicle in vehicles]
    left: Sources = {
        'planned': [margin.planned for margin in margins],
        'measured': [margin.measured for margin in margins],
    }
    errors = [comparison.tracking_errors.get(vehicle.name) for vehicle in vehicles]
    kept = tuple(panel._replace(limits=(0.0,)) for panel in _panels(mission, left))
    note = 'Distance from the limit: what is below zero is a violation.'
    found = [
        Chart('states', 'States', _histories(mission, states)),
        Chart('controls', 'Controls', _histories(mission, controls, held=True)),
        _distances(mission, comparison.separations),
        Chart('margins', 'Constraint margins', kept, note),
        Chart(
            'errors',
            'Tracking errors',
            _panels(mission, {'error': errors}),
            'Measured less planned.',
        ),
    ]
    return [chart for chart in found if any(panel.curves for panel in chart.panels)]


def points_per_curve(mission: Mission) -> int:
    """Return how many points a curve may have."""
    curves = _OTHER_CURVES
    for vehicle in mission.vehicles:
        recorded = (vehicle.states, vehicle.commands, vehicle.applied, vehicle.states)
        curves += sum(len(signals.names) for signals in recorded if signals is not None)
        kind = vehicle.view.kind
        curves += 2 * (len(kind.state_names) + len(kind.control_names))
    return int(np.clip(MOST_POINTS // curves, FEWEST_PER_CURVE, MOST_PER_CURVE))


def _distances(mission: Mission, history: History) -> Chart:
    """Distances of pairs of vehicles, of many pairs those that come closest."""
    nearest: dict[str, float] = {}
    both: dict[Kind, Signals | None] = {'planned': history.planned, 'measured': history.measured}
    for signals in both.values():
        for name, distance in smallest(signals).items():
            nearest[name] = min(nearest.get(name, np.inf), distance.worst)
    closest = sorted(nearest, key=lambda name: nearest[name])[:SHOWN_PAIRS]
    names = [name for name in nearest if name in closest]
    most, several = points_per_curve(mission), len(names) > 1
    curves = []
    for kind, signals in both.items():
        for k, name in enumerate(names):
            if signals is not None and name in signals:
                thin = signals.select(name).thinned(most)
                colour, series = (k, name) if several else (_COLOURS[kind], '')
                curves.append(Curve(kind, thin.times, thin.values[:, 0], colour, series))
    least = mission.vehicles[0].view.separation if mission.vehicles else None
    limits = () if least is None else (least,)
    panel = Panel('distance', 'm', tuple(curves), 'between centres', limits)
    note = f'The {len(names)} of {len(nearest)} pairs that come closest.'
    return Chart('distances', 'Distances', (panel,), note if len(nearest) > len(names) else '')


def _histories(mission: Mission, sources: Sources, held: bool = False) -> tuple[Panel, ...]:
    """Return panels of states or controls with their limits, and the switches of the plans."""
    limits: dict[str, set[float]] = {}
    switches: set[float] = set()
    for vehicle in mission.vehicles:
        for name, levels in vehicle.view.bounds.items():
            limits.setdefault(name, set()).update(levels)
        switches.update(at for plan in vehicle.plans for at in _switches(plan).tolist())
    return tuple(
        panel._replace(
            limits=tuple(sorted(limits.get(panel.title, ()))), switches=tuple(sorted(switches))
        )
        for panel in _panels(mission, sources, held)
    )


def _panels(mission: Mission, sources: Sources, held: bool = False) -> tuple[Panel, ...]:
    """Return a panel for every name; a plan's controls that are `held` make steps."""
    most, several = points_per_curve(mission), len(mission.vehicles) > 1
    curves: dict[str, list[Curve]] = {}
    units: dict[str, str] = {}
    for k, vehicle in enumerate(mission.vehicles):
        steps = any(p.trajectory.interpolation == 'zero_order_hold' for p in vehicle.plans)
        for kind, histories in sources.items():
            signals = histories[k]
            if signals is None:
                continue
            colour, series = (k, vehicle.name) if several else (_COLOURS[kind], '')
            for name in signals.names:
                thin = signals.select(name).thinned(most)
                stays = held and kind == 'planned' and steps
                curve = Curve(kind, thin.times, thin.values[:, 0], colour, series, stays)
                curves.setdefault(name, []).append(curve)
                units[name] = units.get(name, '') or thin.units[0]
    words = mission.vehicles[0].view.labels if mission.vehicles else {}
    return tuple(
        Panel(name, units[name], tuple(found), words.get(name, ''))
        for name, found in curves.items()
    )


def _planned(mission: Mission, vehicle: RecordedVehicle) -> tuple[Signals | None, Signals | None]:
    """Return states and controls of every plan as long as it was followed, gaps between them."""
    if not vehicle.plans:
        return None, None
    most = points_per_curve(mission) // len(vehicle.plans) - 3
    parts = []
    for plan in vehicle.plans:
        at = plan_instants(plan, most)
        gapped = (np.pad(v, ((0, 1), (0, 0)), constant_values=np.nan) for v in plan.sample(at))
        parts.append((np.append(at, at[-1]), *gapped))
    times, *read = map(np.concatenate, zip(*parts, strict=True))
    return Signals.both(vehicle.plans[0].trajectory, times, Sample(*read))


def _switches(plan: FollowedPlan) -> Array:
    """Return the instants at which a held control of the plan jumps while it is followed [s]."""
    motion = plan.trajectory
    instants: Array = plan.start + motion.times[motion.switches]
    return instants[instants <= plan.followed_until]


def plan_instants(plan: FollowedPlan, most: int = MOST_PER_CURVE) -> Array:
    """Return about `most` instants at which a plan is drawn while it is followed."""
    end = plan.followed_until
    even = np.linspace(plan.start, end, min(max(most // 2, 2), 400))
    samples = plan.start + plan.trajectory.times
    if samples.size > most // 2:
        samples = _switches(plan)
    instants: Array = np.union1d(samples[samples < end], even)
    # an instant and its double, rounded differently, would make a needle in a held control
    apart: Array = instants[np.append(True, np.diff(instants) > 1e-9)]
    return apart


def chart_json(chart: Chart, span: tuple[float, float]) -> dict[str, Any]:
    """Return the chart as the page's script takes it, its numbers in single precision."""
    traces, panels = [], []
    for k, panel in enumerate(chart.panels):
        low, high = _value_range(panel)
        about = {'title': panel.title, 'description': panel.description, 'unit': panel.unit}
        panels.append({**about, 'range': (low, high)})
        axis = f'y{k + 1}' if k else 'y'
        if panel.switches:
            instants = np.repeat(panel.switches, 3)
            edges = np.tile([low, high, np.nan], len(panel.switches))
            traces.append(_trace(axis, 'switching', instants, edges))
        # measured curves lie broad and pale below planned ones
        for curve in sorted(panel.curves, key=lambda curve: _FROM_BELOW.index(curve.kind)):
            how = {'colour': curve.colour % len(COLOURS), 'held': curve.held}
            traces.append(_trace(axis, curve.kind, curve.times, curve.values, curve.series, **how))
        if panel.limits:
            ends = np.tile([*span, np.nan], len(panel.limits))
            traces.append(_trace(axis, 'limit', ends, np.repeat(panel.limits, 3)))
    return {'key': chart.key, 'data': traces, 'panels': panels}


def _value_range(panel: Panel) -> tuple[float, float]:
    seen = [curve.values[np.isfinite(curve.values)] for curve in panel.curves]
    values = np.concatenate([*seen, np.array(panel.limits)])
    if not values.size:
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    room = _PADDING * (high - low) or max(1e-3, 0.1 * abs(high))
    return low - room, high + room


def _trace(
    axis: str, kind: Kind, x: ArrayLike, y: ArrayLike, series: str = '', **how: Any
) -> dict[str, Any]:
    meta = {'kind': kind, 'series': series, **how}
    return {'x': packed(x), 'y': packed(y), 'meta': meta, 'yaxis': axis}


def packed(values: ArrayLike) -> dict[str, str]:
    """Return numbers (n,) in single precision as plotly.js reads them; NaN is a gap."""
    data = np.ascontiguousarray(values, dtype='<f4').tobytes()
    return {'dtype': 'f4', 'bdata': base64.b64encode(data).decode('ascii')}
