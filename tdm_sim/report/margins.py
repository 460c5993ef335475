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
How far plans and measured motions stay from their limits, over time.

The limits are those that the planner checks a plan against, for the parameters that it published.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import itertools

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import TdmError
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.formation_verification import robot_constraints
from tdm_planner.verification import Constraint
from tdm_sim.report.entries import ROUNDING
from tdm_sim.report.mission import Margin, Mission, Signals, Vehicle

Array = NDArray[np.float64]

MOST_PAIRS = 200
THRUST, LOWER_THRUST = 'thrust', 'thrust, lower bound'
_PLANNED_STEP = 0.01  # s, between instants at which planned distances are computed


@dataclass(frozen=True, eq=False)
class History:
    """Planned and measured histories of the same quantities; None: there is none."""

    planned: Signals | None = None
    measured: Signals | None = None


@dataclass(frozen=True)
class Limits:
    """
    What the parameters say a vehicle must keep; `formation` is None but for robots.

    `fault` says why nothing is known, '' otherwise.
    """

    by_plant: Mapping[str, Sequence[Constraint]] = field(default_factory=dict)
    formation: FormationTask | None = None
    fault: str = ''


def limits_of(mission: Mission) -> Limits:
    """Return the limits that the mission's parameters stand for."""
    if not mission.parameters:
        return Limits()
    try:
        if mission.problem == PendulumSwingUp.name:
            task = PendulumSwingUp.from_parameters(mission.parameters).task
            return Limits({'pendulum': task.constraints})
        if mission.problem == RobotFormation.name:
            formation = RobotFormation.from_parameters(mission.parameters).task
            return Limits({'robot': _robot_limits(formation)}, formation)
    except TdmError as error:
        return Limits(
            fault=f'Limits are not known: the recorded parameters are invalid ({error}).'
        )
    return Limits()


def _robot_limits(task: FormationTask) -> list[Constraint]:
    """
    Limits of one robot, those of its thrust apart.

    A robot that coasts is at the lower one all the time: together with it, the margin of the upper
    one would never be seen.
    """
    most = task.thrust * task.plant.mass
    found = []
    for constraint in robot_constraints(task):
        if constraint.name != THRUST:
            found.append(constraint)
            continue
        upper = replace(constraint, margin=lambda t, x, u: most - u[:, 0])
        lower = replace(constraint, name=LOWER_THRUST, margin=lambda t, x, u: u[:, 0])
        found += [upper, lower]
    return found


def margin_history(vehicle: Vehicle, limits: Limits) -> History:
    """
    Return the margin of every constraint over time; negative values are violations.

    Of the thrust it is that of the upper limit; the lower one is there only if it is violated.
    """
    constraints = limits.by_plant.get(vehicle.plant, ())
    if not constraints:
        return History()
    return History(_planned(vehicle, constraints), _measured(vehicle, constraints))


def _planned(vehicle: Vehicle, constraints: Sequence[Constraint]) -> Signals | None:
    parts = []
    for plan in vehicle.plans:
        motion = plan.trajectory
        if not motion.control_names:
            continue
        inside = motion.times + plan.start <= plan.carried_out_until
        if inside.any():
            times = motion.times[inside]
            states, controls = motion.states[inside], motion.controls[inside]
            parts.append((times + plan.start, _margins(constraints, times, states, controls)))
    if not parts:
        return None
    times = np.concatenate([part[0] for part in parts])
    return _signals(times, np.concatenate([part[1] for part in parts]), constraints)


def _measured(vehicle: Vehicle, constraints: Sequence[Constraint]) -> Signals | None:
    """Margins of what was measured, from the start of the first plan on."""
    if vehicle.states is None or not vehicle.plans:
        return None
    states = vehicle.states.between(vehicle.plans[0].start, np.inf)
    if not states.times.size:
        return None
    plan = vehicle.plans[-1].trajectory
    controls = np.full((states.times.size, len(plan.control_names)), np.nan)
    if vehicle.controls is not None:
        found = vehicle.controls.at(states.times)
        for k, name in enumerate(plan.control_names):
            if name in vehicle.controls:
                controls[:, k] = found[:, vehicle.controls.names.index(name)]
    if not plan.control_names:
        return None
    values = _margins(constraints, states.times, _named(states, plan.state_names), controls)
    return _signals(states.times, values, constraints)


def _named(states: Signals, names: Sequence[str]) -> Array:
    missing = np.full(states.times.size, np.nan)
    return np.stack([states.column(n) if n in states else missing for n in names], axis=1)


def _margins(
    constraints: Sequence[Constraint], times: Array, states: Array, controls: Array
) -> Array:
    columns = [np.asarray(c.margin(times, states, controls), dtype=float) for c in constraints]
    return np.stack(columns, axis=1)


def _signals(times: Array, values: Array, constraints: Sequence[Constraint]) -> Signals:
    shown = [
        k
        for k, constraint in enumerate(constraints)
        if constraint.name != LOWER_THRUST or (values[:, k] < -ROUNDING).any()
    ]
    names = tuple(constraints[k].name for k in shown)
    return Signals(times, values[:, shown], names, tuple(constraints[k].unit for k in shown))


def smallest(history: Signals | None) -> dict[str, Margin]:
    """Return the smallest value of every history and its instant; left out where there is none."""
    found: dict[str, Margin] = {}
    if history is None:
        return found
    for name, unit, column in zip(history.names, history.units, history.values.T, strict=True):
        if np.isfinite(column).any():
            k = int(np.nanargmin(column))
            found[name] = Margin(float(column[k]), float(history.times[k]), unit)
    return found


def separations(mission: Mission) -> History:
    """
    Return the distance of every pair of robots over time, called ``one - other``.

    Of more than `MOST_PAIRS` pairs those that come closest.
    """
    robots = [vehicle for vehicle in mission.vehicles if vehicle.plant == 'robot']
    if len(robots) < 2:
        return History()
    planned = [robot for robot in robots if robot.plans]
    seen = [robot for robot in robots if robot.states is not None]
    return History(_planned_distances(planned), _measured_distances(seen))


def _planned_distances(robots: Sequence[Vehicle]) -> Signals | None:
    if len(robots) < 2:
        return None
    start = min(robot.plans[0].start for robot in robots)
    end = max(robot.plans[-1].end for robot in robots)
    times = np.linspace(start, end, min(int((end - start) / _PLANNED_STEP) + 2, 20_000))
    return _distances({robot.name: planned_place(robot, times) for robot in robots}, times)


def planned_place(robot: Vehicle, times: Array) -> Array:
    """
    Return the planned x, y (n, 2) at instants since the mission's origin, of the plans in turn.

    Before the first plan starts it is where that starts; after the last one ends, where it ends.
    """
    place = robot.plans[0].states(times)[:, :2]
    for plan in robot.plans[1:]:
        later = times >= plan.start
        place[later] = plan.states(times[later])[:, :2]
    return place


def _measured_distances(robots: Sequence[Vehicle]) -> Signals | None:
    if len(robots) < 2:
        return None
    histories = [robot.states for robot in robots if robot.states is not None]
    times = max(histories, key=lambda states: states.times.size).times
    return _distances(
        {
            robot.name: states.select('x', 'y').at(times)
            for robot, states in zip(robots, histories, strict=True)
        },
        times,
    )


def _distances(places: Mapping[str, Array], times: Array) -> Signals:
    found: list[tuple[float, str, Array]] = []
    for one, other in itertools.combinations(places, 2):
        distance = np.hypot(*(places[one] - places[other]).T)
        nearest = float(np.nanmin(distance)) if np.isfinite(distance).any() else np.inf
        found.append((nearest, f'{one} - {other}', distance))
        if len(found) > 2 * MOST_PAIRS:
            found = _closest(found)
    found = _closest(found)
    names = tuple(name for _, name, _ in found)
    values = np.stack([distance for _, _, distance in found], axis=1)
    return Signals(times, values, names, ('m',) * len(names))


def _closest(found: list[tuple[float, str, Array]]) -> list[tuple[float, str, Array]]:
    if len(found) <= MOST_PAIRS:
        return found
    return sorted(found, key=lambda item: item[0])[:MOST_PAIRS]
