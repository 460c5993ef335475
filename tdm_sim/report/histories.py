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

"""Time histories of every state and control of a mission, planned and measured, as charts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from tdm_sim.report.charts import Chart, Curve, Kind, Panel
from tdm_sim.report.mission import FollowedPlan, Mission, Signals, Vehicle

Array = NDArray[np.float64]
Group = Literal['states', 'controls']

# Points of all curves together: a page stays below 8 MB however many vehicles there are.
MOST_POINTS = 200_000
FEWEST_PER_CURVE, MOST_PER_CURVE = 60, 3000
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
    trajectory = plan.trajectory
    if trajectory.interpolation != 'zero_order_hold':
        return []
    jumps = (np.diff(trajectory.controls[:-1], axis=0) != 0).any(axis=1)
    instants = plan.start + trajectory.times[1:-1][jumps]
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
