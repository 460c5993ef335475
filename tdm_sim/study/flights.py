# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Closed-loop runs without ROS: the trackers' own code on plants that differ from its model.

A run, here a *flight*, becomes a `Mission` like a recording, and gets a verdict in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem, NotFinite
from tdm_planner.parameters import LARGEST, NON_NEGATIVE, parameter, POSITIVE, Range, Validated
from tdm_planner.plant_views import PlantView, view_of
from tdm_planner.problems import DirectProblem, PendulumSwingUp, RobotFormation
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.tracking import (
    PendulumTracker,
    PendulumTrackerParameters,
    RobotTracker,
    RobotTrackerParameters,
    TrackerParameters,
    TrajectoryRejected,
    TrajectoryTracker,
)
from tdm_planner.tracking.stated_tracking import StatedTracker
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.margins import margin_history, separations, smallest
from tdm_sim.report.mission import FollowedPlan, Mission, Signals, Vehicle
from tdm_sim.report.verdict import arrival, goal_errors, HOLD_TIME, judge
from tdm_sim.simulation import mismatched, PlantSetup, robot_actuators, SimulatedPlant

Array = NDArray[np.float64]

FLOWN = 'flown.'  # before the name of a limit: what flights leave of it at worst
_AFTER = 0.1  # s that a flight lasts beyond what its judge asks for


@dataclass(frozen=True)
class ClosedLoop(Validated):
    """Closed-loop runs of a plan: how many, with which mismatch, sensor noise and rate."""

    seeds: int = parameter(
        1, 'flights of every plan, each on a plant of its own', allowed=Range(1, 1e6)
    )
    mismatch: float = parameter(
        0.0,
        'largest relative error of every physical constant and actuator gain, at random',
        allowed=Range(0.0, 1.0, upper_open=True),
    )
    rate: float = parameter(
        TrackerParameters.rate, 'rate of the commands', unit='Hz', allowed=POSITIVE
    )
    noise: float = parameter(
        1.0,
        'measurement noise, relative to what the estimator assumes of the sensors',
        allowed=NON_NEGATIVE,
    )


class TrackedPlant(NamedTuple):
    """A simulated plant, and the tracker that commands it."""

    tracker: TrajectoryTracker
    plant: SimulatedPlant


def fly(problem: Problem, solution: Solution, how: ClosedLoop, seed: int) -> Mission:
    """
    Return the flight of one seed along a plan, and beyond its end for as long as it is judged.

    Raises
    ------
    TrajectoryRejected
        If a tracker does not accept the plan.
    InvalidProblem
        If no tracker for plants of the problem is known.

    """
    count, vehicles = len(solution.trajectories), []
    view = view_of(problem, solution.trajectory)
    held = any(view.is_held(plan) for plan in solution.trajectories.values())
    after = view.settling + HOLD_TIME + _AFTER if held else 0.0
    ticks = math.ceil((solution.duration + after) * how.rate)
    for number, (name, plan) in enumerate(solution.trajectories.items()):
        tracker, differs = tracker_of(problem, rate=how.rate), (how.mismatch, how.noise)
        loop = tracked(tracker, plan.states[0], *differs, count * seed + number)
        vehicles.append(_vehicle(name if count > 1 else view.name, view, plan, loop, ticks))
    return Mission(problem.name, problem.name, tuple(vehicles))


def _vehicle(
    name: str, view: PlantView, plan: Trajectory, loop: TrackedPlant, ticks: int
) -> Vehicle:
    """Fly one plan for so many ticks."""
    tracker, plant = loop
    interval, nx = tracker.parameters.interval, len(plan.state_names)
    states, controls = [plant.state], []
    tracker.observe(plant.measure(), -interval)
    tracker.accept(plan, 0.0, -interval)
    for tick in range(ticks):
        now = tick * interval
        tracker.observe(plant.measure(), now)
        plant.command(tracker.command(now).control)
        controls.append(plant.control)
        plant.step(interval)
        states.append(plant.state)
    times: Array = np.asarray(interval * np.arange(ticks + 1), dtype=float)
    applied = np.array([*controls, plant.control])
    return Vehicle(
        name=name,
        view=view,
        plans=(FollowedPlan(plan, 0.0),),
        states=Signals(times, np.array(states)[:, :nx], plan.state_names, plan.state_units),
        applied=Signals(times, applied, plan.control_names, plan.control_units),
    )


def tracker_of(problem: Problem, **values: Any) -> TrajectoryTracker:
    """
    Return the tracker of a problem's plant; `values` are its parameters beside the constants.

    Raises
    ------
    InvalidProblem
        If no tracker for plants of the problem is known.

    """
    if isinstance(problem, DirectProblem):
        return StatedTracker(problem, TrackerParameters(**values))
    if isinstance(problem, PendulumSwingUp):
        rig = PendulumTrackerParameters(plant=problem.plant, limits=problem.limits, **values)
        return PendulumTracker(rig)
    if isinstance(problem, RobotFormation):
        robot = RobotTrackerParameters(plant=problem.plant, limits=problem.limits, **values)
        return RobotTracker(robot)
    raise InvalidProblem(f"problem '{problem.name}' cannot be flown: no tracker of it is known")


def tracked(
    tracker: TrajectoryTracker, initial: Array, mismatch: float, noise: float, seed: int
) -> TrackedPlant:
    """
    Return a tracker with a simulated plant in state `initial` (nx,), reproducible by its `seed`.

    The plant's constants and actuator gains differ from the tracker's by up to `mismatch`; `noise`
    is that of its sensors, relative to what the estimator assumes.
    """
    actuators: dict[str, Any] = {}
    plant: Any
    if isinstance(tracker, StatedTracker):
        plant = DirectPlant(mismatched(tracker.problem, mismatch, seed))
        lower, upper = np.clip(plant.control_range, -LARGEST, LARGEST)
        actuators = {'lower': lower, 'upper': upper}
    else:
        plant = mismatched(tracker.plant, mismatch, seed)
    if isinstance(tracker, PendulumTracker):
        torque = np.array([tracker.parameters.limits.torque])
        actuators = {'lower': -torque, 'upper': torque}
    elif isinstance(tracker, RobotTracker):
        actuators = robot_actuators(tracker.parameters.limits, mismatch, seed)
        actuators['largest_step'] = 5e-3
    sensors = noise * tracker.estimator.noise.measurement[: initial.size]
    setup = PlantSetup(plant, initial, noise=sensors, **actuators)
    return TrackedPlant(tracker, SimulatedPlant(setup, seed))


def measured(problem: Problem, solution: Solution, how: ClosedLoop) -> dict[str, Any]:
    """
    Return what all flights of a plan come to, as columns of a study's row.

    `caught` counts the flights that end at the goal, `held` those of them that were there in time
    and stayed, within all limits; `lost` says why the first of the others was not held.
    """
    caught, held, lost = 0, 0, ''
    least: dict[str, float] = {}
    for seed in range(how.seeds):
        try:
            mission = fly(problem, solution, how, seed)
        except (TrajectoryRejected, NotFinite) as reason:  # too quick a plant for steps of 1 ms
            lost = lost or str(reason)
            continue
        verdict = judge(mission)
        caught += all(map(_at_goal, mission.vehicles))
        if verdict is not None and verdict.reached:
            held += 1
        elif verdict is not None:
            lost = lost or next(iter(verdict.reasons), verdict.undecided)
        for name, margin in _margins(mission).items():
            least[name] = min(margin, least.get(name, math.inf))
    flown = {f'{FLOWN}{name}': value for name, value in least.items()}
    return {'flights': how.seeds, 'caught': caught, 'held': held, 'lost': lost, **flown}


def _at_goal(vehicle: Vehicle) -> bool:
    """Whether a flight ends at the goal; where that cannot be held, whether it comes there."""
    plan, states = vehicle.plan, vehicle.states
    assert plan is not None
    assert states is not None
    if vehicle.view.is_held(plan.trajectory):
        return (arrival(vehicle) or 0.0) < math.inf
    _, errors = goal_errors(vehicle.view, plan.trajectory, states)
    return not errors.size or bool(errors[-1] <= 1.0)


def _margins(mission: Mission) -> dict[str, float]:
    """Return the smallest margin of every limit on a flight, by the limit's name in the plan."""
    several = len(mission.vehicles) > 1
    found = {
        f'{vehicle.name}.{name}' if several else name: margin.worst
        for vehicle in mission.vehicles
        for name, margin in smallest(margin_history(vehicle).measured).items()
    }
    apart = mission.vehicles[0].view.separation or 0.0
    for pair, distance in smallest(separations(mission).measured).items():
        found[pair] = distance.worst - apart
    return found
