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

"""Charts of what a plan must keep: margins of constraints, distances, tracking errors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from tdm_sim.report.charts import Chart, Curve, Kind, Panel
from tdm_sim.report.comparison import Comparison
from tdm_sim.report.histories import colour_of, description_of, points_per_curve, series_of
from tdm_sim.report.mission import Mission, Signals

MOST_PAIRS = 6


def margin_chart(mission: Mission, comparison: Comparison) -> Chart:
    """How far every constraint is from being violated."""
    sources: dict[Kind, Callable[[str], Signals | None]] = {
        'planned': lambda name: comparison.margins[name].planned,
        'measured': lambda name: comparison.margins[name].measured,
    }
    panels = _panels(mission, sources, limits=(0.0,))
    note = 'Distance from the limit: what is below zero is a violation.'
    return Chart('margins', 'Constraint margins', panels, note)


def error_chart(mission: Mission, comparison: Comparison) -> Chart:
    """How far the vehicles were from their plans."""
    sources: dict[Kind, Callable[[str], Signals | None]] = {
        'error': comparison.tracking_errors.get
    }
    panels = _panels(mission, sources)
    return Chart('errors', 'Tracking errors', panels, 'Measured less planned.')


def distance_chart(mission: Mission, comparison: Comparison) -> Chart:
    """Distances of pairs of robots, of many pairs those that come closest."""
    history = comparison.separations
    names = _closest_pairs(history.planned, history.measured)
    most = points_per_curve(mission)
    curves = []
    for kind, signals in {'planned': history.planned, 'measured': history.measured}.items():
        for k, name in enumerate(names):
            if signals is not None and name in signals:
                thin = signals.select(name).thinned(most)
                colour = k if len(names) > 1 else (0 if kind == 'planned' else 1)
                series = name if len(names) > 1 else ''
                known: Kind = 'planned' if kind == 'planned' else 'measured'
                curves.append(Curve(known, thin.times, thin.values[:, 0], colour, series))
    minimum = mission.vehicles[0].view.separation if mission.vehicles else None
    limits = () if minimum is None else (minimum,)
    panel = Panel('distance', 'm', tuple(curves), 'between centres', limits)
    found = 0 if not curves else len(_names(history.planned) | _names(history.measured))
    note = f'The {len(names)} of {found} pairs that come closest.' if found > len(names) else ''
    return Chart('distances', 'Distances', (panel,), note)


def _panels(
    mission: Mission,
    sources: dict[Kind, Callable[[str], Signals | None]],
    limits: tuple[float, ...] = (),
) -> tuple[Panel, ...]:
    """One panel for every name; `sources` give a vehicle's signals for each kind of curve."""
    most = points_per_curve(mission)
    curves: dict[str, list[Curve]] = {}
    units: dict[str, str] = {}
    for k, vehicle in enumerate(mission.vehicles):
        for kind, source in sources.items():
            signals = source(vehicle.name)
            for name in () if signals is None else signals.names:
                assert signals is not None
                thin = signals.select(name).thinned(most)
                colour, series = colour_of(mission, k, kind), series_of(mission, k)
                curve = Curve(kind, thin.times, thin.values[:, 0], colour, series)
                curves.setdefault(name, []).append(curve)
                units[name] = units.get(name, '') or signals.unit(name)
    return tuple(
        Panel(name, units[name], tuple(found), description_of(mission, name), limits)
        for name, found in curves.items()
    )


def _names(signals: Signals | None) -> set[str]:
    return set() if signals is None else set(signals.names)


def _closest_pairs(*histories: Signals | None) -> list[str]:
    nearest: dict[str, float] = {}
    for signals in histories:
        for name in () if signals is None else signals.names:
            assert signals is not None
            column = signals.column(name)
            known = column[np.isfinite(column)]
            if known.size:
                nearest[name] = min(nearest.get(name, np.inf), float(known.min()))
    closest = sorted(nearest, key=lambda name: nearest[name])[:MOST_PAIRS]
    return [name for name in nearest if name in closest]
