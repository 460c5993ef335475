# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Charts of a mission: states, controls, margins, distances, errors; planned and measured."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping
import itertools
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from tdm_planner.arrays import Array
from tdm_planner.drawing import COLOURS
from tdm_sim.report.mission import FollowedPlan, Mission, RecordedVehicle
from tdm_sim.report.signals import History, Signals, smallest

Kind = Literal['planned', 'measured', 'commanded', 'error', 'limit', 'switching']
Sources = Mapping[Kind, Signals]  # of a vehicle, by the kind of their curves

# Points of all curves together: a page stays below 8 MB however many vehicles there are.
MOST_POINTS = 200_000
FEWEST_PER_CURVE, MOST_PER_CURVE = 60, 3000
SHOWN_PAIRS = 6  # of vehicles
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

    def decimated(self, most: int) -> Curve:
        """
        Return at most about `most` points, for drawing.

        In every bin of samples the first, the last, the smallest and the largest stay, so that
        peaks and gaps are drawn where they were measured.
        """
        n = self.times.size
        if n <= most:
            return self
        edges = np.linspace(0, n, max(1, most // 4) + 1).astype(int)
        rows = [*edges[:-1], *(edges[1:] - 1)]
        unknown = np.isnan(self.values)
        low, high = (np.where(unknown, end, self.values) for end in (np.inf, -np.inf))
        for start, end in itertools.pairwise(edges):
            rows += [start + low[start:end].argmin(), start + high[start:end].argmax()]
        kept = np.unique(rows)
        return self._replace(times=self.times[kept], values=self.values[kept])


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


def mission_charts(mission: Mission) -> list[Chart]:
    """Return the charts that have anything to show, with all their points."""

    def states(vehicle: RecordedVehicle) -> Sources:
        return {'planned': vehicle.followed[1], 'measured': vehicle.states}

    def controls(vehicle: RecordedVehicle) -> Sources:
        seen: Sources = {'measured': vehicle.applied, 'commanded': vehicle.commands}
        return {'planned': vehicle.followed[2], **seen}

    margins = _panels(mission, lambda vehicle: _both(vehicle.margins))
    kept = tuple(panel._replace(limits=(0.0,)) for panel in margins)
    errors = _panels(mission, lambda vehicle: {'error': vehicle.tracking_errors})
    note = 'Distance from the limit: what is below zero is a violation.'
    found = [
        Chart('states', 'States', _histories(mission, states)),
        Chart('controls', 'Controls', _histories(mission, controls, held=True)),
        _distances(mission),
        Chart('margins', 'Constraint margins', kept, note),
        Chart('errors', 'Tracking errors', errors, 'Measured less planned.'),
    ]
    return [chart for chart in found if any(panel.curves for panel in chart.panels)]


def _both(history: History) -> Sources:
    return {'planned': history.planned, 'measured': history.measured}


def points_per_curve(charts: Iterable[Chart]) -> int:
    """Return how many points a curve may have, for a page of all charts to stay small."""
    curves = sum(len(panel.curves) for chart in charts for panel in chart.panels)
    return int(np.clip(MOST_POINTS // max(curves, 1), FEWEST_PER_CURVE, MOST_PER_CURVE))


def _distances(mission: Mission) -> Chart:
    """Distances of pairs of vehicles, of many pairs those that come closest."""
    nearest: dict[str, float] = {}
    both = _both(mission.separations)
    for signals in both.values():
        for name, distance in smallest(signals).items():
            nearest[name] = min(nearest.get(name, np.inf), distance.worst)
    closest = sorted(nearest, key=lambda name: nearest[name])[:SHOWN_PAIRS]
    names = [name for name in nearest if name in closest]
    curves = [
        _curve(kind, signals, name, (k, name) if len(names) > 1 else None)
        for kind, signals in both.items()
        for k, name in enumerate(names)
        if name in signals.columns
    ]
    least = mission.vehicles[0].view.separation if mission.vehicles else None
    limits = () if least is None else (least,)
    panel = Panel('distance', 'm', tuple(curves), 'between centres', limits)
    note = f'The {len(names)} of {len(nearest)} pairs that come closest.'
    return Chart('distances', 'Distances', (panel,), note if len(nearest) > len(names) else '')


def _curve(
    kind: Kind, signals: Signals, name: str, owner: tuple[int, str] | None, held: bool = False
) -> Curve:
    """Return a curve; `owner` is the number and name of one of several."""
    colour, series = owner or (_COLOURS[kind], '')
    return Curve(kind, signals.times, signals.columns[name], colour, series, held)


def _histories(
    mission: Mission, sources: Callable[[RecordedVehicle], Sources], held: bool = False
) -> tuple[Panel, ...]:
    """Return panels of states or controls with their limits, and the switches of the plans."""
    several = len(mission.vehicles) > 1  # whose switches would hide the curves
    plans = () if several else mission.plans
    switches = tuple(sorted({at for plan in plans for at in _switches(plan).tolist()}))
    return tuple(
        panel._replace(
            limits=mission.vehicles[0].view.bounds.get(panel.title, ()), switches=switches
        )
        for panel in _panels(mission, sources, held)
    )


def _panels(
    mission: Mission, sources: Callable[[RecordedVehicle], Sources], held: bool = False
) -> tuple[Panel, ...]:
    """Return a panel for every name; a plan's controls that are `held` make steps."""
    curves: dict[str, list[Curve]] = {}
    units: dict[str, str] = {}
    for k, vehicle in enumerate(mission.vehicles):
        owner = (k, vehicle.name) if len(mission.vehicles) > 1 else None
        steps = any(p.trajectory.interpolation == 'zero_order_hold' for p in vehicle.plans)
        for kind, signals in sources(vehicle).items():
            for name in signals.columns:
                curve = _curve(kind, signals, name, owner, held and kind == 'planned' and steps)
                curves.setdefault(name, []).append(curve)
                units[name] = units.get(name, '') or signals.units.get(name, '')
    words = mission.vehicles[0].view.labels if mission.vehicles else {}
    return tuple(
        Panel(name, units[name], tuple(found), words.get(name, ''))
        for name, found in curves.items()
    )


def _switches(plan: FollowedPlan) -> Array:
    """Return the instants at which a held control of the plan jumps while it is followed [s]."""
    motion = plan.trajectory
    instants: Array = plan.start + motion.times[motion.switches]
    return instants[instants <= plan.followed_until]


def chart_json(
    chart: Chart, span: tuple[float, float], most: int = MOST_PER_CURVE
) -> dict[str, Any]:
    """Return the chart as the page's script takes it, curves of `most` points at most."""
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
            thin = curve.decimated(most)
            traces.append(_trace(axis, curve.kind, thin.times, thin.values, curve.series, **how))
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
