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

"""What came of a plan: when the goal was reached for good, with which error, was it held."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.measured_robot import MeasuredRobot
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.margins import Limits
from tdm_sim.report.mission import Mission, Signals, Vehicle
from tdm_sim.verdict import (
    held_from,
    judge_pendulum,
    LONGEST_CATCH,
    MeasuredPendulum,
    UPRIGHT_TOLERANCE,
    Verdict,
)
from tdm_sim.verdict_formation import arrived_since, judge_formation, LONGEST_SETTLING

Array = NDArray[np.float64]

_TURN = 2 * math.pi
_ANGLES = ('yaw', 'alpha')


def arrival(vehicle: Vehicle) -> float | None:
    """
    Return the instant [s] from which the goal was held to the end; inf if it never was.

    None where that cannot be said: nothing measured, no plan, or a plant whose tolerances are not
    known here. The goal is upright for the pendulum, for a robot its place in the formation.
    """
    plan, states = vehicle.plan, _complete(vehicle)
    if plan is None or states is None:
        return None
    after = states.between(vehicle.plans[0].start, math.inf)
    if not after.times.size:
        return None
    if vehicle.plant == 'pendulum':
        theta = after.column('theta')
        error = theta - _TURN * np.round(theta[-1] / _TURN)
        return held_from(after.times, error, UPRIGHT_TOLERANCE)
    if vehicle.plant == 'robot':
        return arrived_since(_as_robot(after), goal_of(vehicle))
    return None


def could_arrive(vehicle: Vehicle) -> bool:
    """Whether the goal could still be reached in time when the recording ends."""
    longest = {'pendulum': LONGEST_CATCH, 'robot': LONGEST_SETTLING}.get(vehicle.plant, 0.0)
    states = _complete(vehicle)
    if states is None or vehicle.plan is None:
        return True
    return bool(states.times[-1] <= vehicle.plan.end + longest)


def goal_of(robot: Vehicle) -> Array:
    """Return the x, y, yaw (3,) of the last plan's end."""
    plan = robot.plan
    assert plan is not None
    motion = plan.trajectory
    return np.array([motion.state(name)[-1] for name in ('x', 'y', 'yaw')])


def landing_errors(vehicle: Vehicle) -> dict[str, float]:
    """Return measured minus planned at the planned end of the last plan, by state."""
    plan, states = vehicle.plan, vehicle.states
    if plan is None or states is None:
        return {}
    names = [name for name in plan.trajectory.state_names if name in states]
    measured = states.select(*names).at(np.array([plan.end]))[0]
    found = {}
    for name, value in zip(names, measured.tolist(), strict=True):
        error = value - float(plan.trajectory.state(name)[-1])
        if name in _ANGLES:
            error = math.remainder(error, _TURN)
        if math.isfinite(error):
            found[name] = error
    return found


def tracking_errors(vehicle: Vehicle) -> Signals | None:
    """
    Return measured minus planned while plans were carried out.

    What the tracker published or, where that was not recorded, the difference of states and plans.
    """
    if not vehicle.plans:
        return None
    start, end = vehicle.plans[0].start, vehicle.plans[-1].end
    if vehicle.tracking_error is not None:
        published = vehicle.tracking_error.between(start, end)
        return published if published.times.size else None
    return None if vehicle.states is None else _differences(vehicle, start, end)


def _differences(vehicle: Vehicle, start: float, end: float) -> Signals | None:
    assert vehicle.states is not None
    states = vehicle.states.between(start, end)
    names = [n for n in vehicle.plans[-1].trajectory.state_names if n in states]
    if not states.times.size or not names:
        return None
    states = states.select(*names)
    planned = np.full(states.values.shape, np.nan)
    for plan in vehicle.plans:
        during = states.times >= plan.start
        index = [plan.trajectory.state_names.index(n) for n in names]
        planned[during] = plan.states(states.times[during])[:, index]
    error = states.values - planned
    for k, name in enumerate(names):
        if name in _ANGLES:
            error[:, k] = np.angle(np.exp(1j * error[:, k]))
    return Signals(states.times, error, states.names, states.units)


def verdict(mission: Mission, limits: Limits) -> Verdict | None:
    """
    Judge the mission as a demo is judged; None where not all that takes was recorded.

    After replans the plan active at the end of the recording counts: its goal, its planned end.
    """
    vehicles = [_with_begun_plans(vehicle) for vehicle in mission.vehicles]
    if not all(vehicle.plans for vehicle in vehicles):
        return None
    origin = min((vehicle.plans[0].start for vehicle in vehicles), default=0.0)
    plans = {vehicle.name: _followed(vehicle, origin) for vehicle in vehicles}
    states = {vehicle.name: _judged(vehicle, origin) for vehicle in vehicles}
    solve_time = mission.figures[0].solve_time if mission.figures else None
    time = math.nan if solve_time is None else solve_time
    if limits.formation is not None:
        goals = {vehicle.name: goal_of(vehicle) for vehicle in vehicles}
        measured = {name: _as_robot(found) for name, found in states.items()}
        return judge_formation(limits.formation, plans, goals, measured, time)
    torque, angle = mission.number('limits.torque'), mission.number('limits.disk_angle')
    if len(vehicles) != 1 or torque is None or angle is None:
        return None
    (vehicle,) = vehicles
    pendulum = _as_pendulum(vehicle, states[vehicle.name], origin)
    if pendulum is None:
        return None
    return judge_pendulum(plans[vehicle.name], pendulum, torque, angle, time)


def _with_begun_plans(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without the plans still pending at the end of what was measured."""
    states = _complete(vehicle)
    end = -math.inf if states is None else float(states.times[-1])
    return replace(vehicle, plans=tuple(plan for plan in vehicle.plans if plan.start < end))


def _followed(vehicle: Vehicle, origin: float) -> Trajectory:
    """Join the plans, each active until the next one starts; times from `origin` [s] on."""
    first, *others = vehicle.plans
    last = vehicle.plans[-1]
    samples = [plan.start + plan.trajectory.times for plan in vehicle.plans]
    times = np.unique(np.concatenate([[origin], *samples]))
    times = times[times <= last.end]
    states, controls = first.states(times), first.controls(times)
    for plan in others:
        during = times >= plan.start
        states[during] = plan.states(times[during])
        controls[during] = plan.controls(times[during])
    return replace(
        last.trajectory, times=times - origin, states=states, controls=controls, rates=None
    )


def _judged(vehicle: Vehicle, origin: float) -> Signals:
    """Complete samples from half a second before `origin` [s] on; times from there."""
    states = _complete(vehicle)
    assert states is not None
    during = states.between(origin - 0.5, math.inf)
    return replace(during, times=during.times - origin)


def _as_pendulum(vehicle: Vehicle, states: Signals, origin: float) -> MeasuredPendulum | None:
    if vehicle.plant != 'pendulum' or vehicle.controls is None:
        return None
    return MeasuredPendulum(
        times=states.times,
        theta=states.column('theta'),
        psi=states.column('psi'),
        theta_dot=states.column('theta_dot'),
        psi_dot=states.column('psi_dot'),
        torque=vehicle.controls.at(states.times + origin)[:, 0],
    )


def _complete(vehicle: Vehicle) -> Signals | None:
    """Return the samples in which every state was measured, the thruster's angle aside."""
    if vehicle.states is None:
        return None
    states = vehicle.states
    needed = [k for k, name in enumerate(states.names) if name != 'alpha']
    whole = np.isfinite(states.values[:, needed]).all(axis=1)
    if not whole.any():
        return None
    return Signals(states.times[whole], states.values[whole], states.names, states.units)


def _as_robot(states: Signals) -> MeasuredRobot:
    return MeasuredRobot(states.times, {name: states.column(name) for name in states.names})
