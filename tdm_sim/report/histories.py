# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Charts: states and controls, planned and measured; margins, distances, tracking errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from tdm_sim.report.charts import Chart, Curve, Kind, Panel
from tdm_sim.report.comparison import Comparison
from tdm_sim.report.mission import FollowedPlan, Mission, Signals, Vehicle

Array = NDArray[np.float64]
Group = Literal['states', 'controls']

# Points of all curves together: a page stays below 8 MB however many vehicles there are.
MOST_POINTS = 200_000
FEWEST_PER_CURVE, MOST_PER_CURVE = 60, 3000
SHOWN_PAIRS = 6  # of vehicles
_OTHER_CURVES = 24  # distances, limits


def points_per_curve(mission: Mission) -> int:
    """Return how many points a curve may have."""
    curves = _OTHER_CURVES
    for vehicle in mission.vehicles:
        recorded = (vehicle.states, vehicle.commands, vehicle.applied, vehicle.states)
        curves += sum(len(signals.names) for signals in recorded if signals is not None)
        curves += 2 * len(_names(vehicle, 'states')) + 2 * len(_names(vehicle, 'controls'))
    return int(np.clip(MOST_POINTS // curves, FEWEST_PER_CURVE, MOST_PER_CURVE))


def state_chart(mission: Mission) -> Chart:
    """Every state, planned and measured."""
    return Chart('states', 'States', _panels(mission, 'states'))


def control_chart(mission: Mission) -> Chart:
    """Every control: planned, commanded by the tracker, carried out by the plant."""
    return Chart('controls', 'Controls', _panels(mission, 'controls'))


def series_of(mission: Mission, index: int) -> str:
    """Return the series of a vehicle's curves: its name where there are several vehicles."""
    return mission.vehicles[index].name if len(mission.vehicles) > 1 else ''


def colour_of(mission: Mission, index: int, kind: Kind) -> int:
    """Return a curve's colour: by vehicle where there are several, else by kind."""
    if len(mission.vehicles) > 1:
        return index
    return {'planned': 0, 'measured': 1, 'commanded': 2, 'error': 1}.get(kind, 0)


def description_of(mission: Mission, name: str) -> str:
    """Return a few words on a state, a control or a constraint; '' if none are known."""
    return mission.vehicles[0].view.labels.get(name, '')


def _panels(mission: Mission, group: Group) -> tuple[Panel, ...]:
    most = points_per_curve(mission)
    names = _ordered(_names(vehicle, group) for vehicle in mission.vehicles)
    return tuple(_panel(mission, group, name, most) for name in names)


def _panel(mission: Mission, group: Group, name: str, most: int) -> Panel:
    curves: list[Curve] = []
    limits: set[float] = set()
    switches: set[float] = set()
    unit = ''
    for k, vehicle in enumerate(mission.vehicles):
        limits.update(vehicle.view.bounds().get(name, ()))
        for kind, signals in _signals(vehicle, group).items():
            if signals is None or name not in signals:
                continue
            unit = unit or signals.unit(name)
            curves.append(_signal_curve(mission, k, signals, name, kind, most))
        planned = [plan for plan in vehicle.plans if name in _plan_names(plan, group)]
        if planned:
            unit = unit or _plan_unit(planned[0], group, name)
            curves.append(_planned_curve(mission, k, planned, group, name, most))
            switches.update(switch for plan in planned for switch in switching_instants(plan))
    return Panel(
        name,
        unit,
        tuple(curves),
        description_of(mission, name),
        tuple(sorted(limits)),
        tuple(sorted(switches)),
    )


def _signals(vehicle: Vehicle, group: Group) -> dict[Kind, Signals | None]:
    if group == 'states':
        return {'measured': vehicle.states}
    return {'measured': vehicle.applied, 'commanded': vehicle.commands}


def _plan_names(plan: FollowedPlan, group: Group) -> tuple[str, ...]:
    trajectory = plan.trajectory
    return trajectory.state_names if group == 'states' else trajectory.control_names


def _plan_unit(plan: FollowedPlan, group: Group, name: str) -> str:
    trajectory = plan.trajectory
    units = trajectory.state_units if group == 'states' else trajectory.control_units
    return units[_plan_names(plan, group).index(name)] if units else ''


def _names(vehicle: Vehicle, group: Group) -> tuple[str, ...]:
    found = [_plan_names(plan, group) for plan in vehicle.plans[:1]]
    found += [s.names for s in _signals(vehicle, group).values() if s is not None]
    return _ordered(found)


def _ordered(groups: Iterable[Sequence[str]]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for group in groups for name in group))


def _signal_curve(
    mission: Mission, index: int, signals: Signals, name: str, kind: Kind, most: int
) -> Curve:
    thin = signals.select(name).thinned(most)
    colour, series = colour_of(mission, index, kind), series_of(mission, index)
    return Curve(kind, thin.times, thin.values[:, 0], colour, series)


def switching_instants(plan: FollowedPlan) -> list[float]:
    """Return the instants at which a held control of the plan jumps while it is followed [s]."""
    instants = plan.start + plan.trajectory.times[plan.trajectory.switches]
    return [float(at) for at in instants[instants <= plan.carried_out_until]]


def _planned_curve(
    mission: Mission, index: int, plans: Sequence[FollowedPlan], group: Group, name: str, most: int
) -> Curve:
    """Every plan as long as it was followed, with gaps between them."""
    held = False
    times: list[Array] = []
    values: list[Array] = []
    for plan in plans:
        at, trajectory = plan_instants(plan, most // len(plans)), plan.trajectory
        column = _plan_names(plan, group).index(name)
        if group == 'controls':
            held = trajectory.interpolation == 'zero_order_hold'
            read = plan.sample(at).control[:, column]
        else:
            read = _states(plan, at)[:, column]
        times += [at, at[-1:]]
        values += [read, np.array([np.nan])]
    colour, series = colour_of(mission, index, 'planned'), series_of(mission, index)
    return Curve('planned', np.concatenate(times), np.concatenate(values), colour, series, held)


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
    end = plan.carried_out_until
    even = np.linspace(plan.start, end, min(max(most // 2, 2), 400))
    samples = plan.start + plan.trajectory.times
    if samples.size > most // 2:
        samples = np.array(switching_instants(plan))
    instants: Array = np.union1d(samples[samples < end], even)
    # an instant and its double, rounded differently, would make a needle in a held control
    apart: Array = instants[np.append(True, np.diff(instants) > 1e-9)]
    return apart


def margin_chart(mission: Mission, comparison: Comparison) -> Chart:
    """How far every constraint is from being violated."""
    sources: dict[Kind, Callable[[str], Signals | None]] = {
        'planned': lambda name: comparison.margins[name].planned,
        'measured': lambda name: comparison.margins[name].measured,
    }
    panels = _named_panels(mission, sources, limits=(0.0,))
    note = 'Distance from the limit: what is below zero is a violation.'
    return Chart('margins', 'Constraint margins', panels, note)


def error_chart(mission: Mission, comparison: Comparison) -> Chart:
    """How far the vehicles were from their plans."""
    sources: dict[Kind, Callable[[str], Signals | None]] = {
        'error': comparison.tracking_errors.get
    }
    panels = _named_panels(mission, sources)
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
    found = 0 if not curves else len(_pairs(history.planned) | _pairs(history.measured))
    note = f'The {len(names)} of {found} pairs that come closest.' if found > len(names) else ''
    return Chart('distances', 'Distances', (panel,), note)


def _named_panels(
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


def _pairs(signals: Signals | None) -> set[str]:
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
    closest = sorted(nearest, key=lambda name: nearest[name])[:SHOWN_PAIRS]
    return [name for name in nearest if name in closest]
