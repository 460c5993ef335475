# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Closed-loop runs without ROS: the trackers' own code on plants that differ from its model.

A run, here a *flight*, becomes a `Mission` like a recording, and gets a verdict in the same way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem, NotFinite
from tdm_planner.parameters import parameter, positive, Range, Validated
from tdm_planner.plant_views import view_of
from tdm_planner.problems import DirectProblem, PendulumSwingUp, RobotFormation
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.tracking.motion import TrackerParameters, TrajectoryRejected
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker, RobotTrackerParameters
from tdm_planner.tracking.stated_tracking import StatedTracker, StatedTrackerParameters
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.trajectory import Sample
from tdm_sim.report.mission import FollowedPlan, Mission, RecordedVehicle
from tdm_sim.report.signals import Signals, smallest
from tdm_sim.report.verdict import goal_errors, HOLD_TIME, judge
from tdm_sim.simulation import mismatched, PlantSetup, robot_actuators, SimulatedPlant

MARGIN = 'margin.'  # before the name of a limit: what the plan leaves of it at worst
FLOWN = 'flown.'  # before the name of a limit: what flights leave of it at worst
_AFTER = 0.1  # s that a flight lasts beyond what its judge asks for


@dataclass(frozen=True)
class ClosedLoop(Validated):
    """Closed-loop runs of a plan: how many, with which mismatch and rate."""

    seeds: int = parameter(
        1, 'flights of every plan, each on a plant of its own', allowed=Range(1, 1e6)
    )
    mismatch: float = parameter(
        0.0,
        'largest relative error of every physical constant and actuator gain, at random',
        allowed=Range(0.0, 1.0, upper_open=True),
    )
    rate: float = positive(TrackerParameters.rate, 'rate of the commands', 'Hz')


def fly(problem: Problem, solution: Solution, how: ClosedLoop, seed: int) -> Mission:
    """
    Return the flight of one seed along a plan, and beyond its end for as long as it is judged.

    Raise TrajectoryRejected if a tracker rejects its plan, InvalidProblem if none is known.
    """
    plans, vehicles = solution.trajectories, []
    view = view_of(problem, solution.trajectory)
    held = any(map(view.is_held, plans.values()))
    after = view.settling(solution.duration) + HOLD_TIME + _AFTER if held else 0.0
    ticks = math.ceil((solution.duration + after) * how.rate)
    for number, (name, plan) in enumerate(plans.items()):
        tracker, own_seed = tracker_of(problem, rate=how.rate), len(plans) * seed + number
        plant = plant_of(tracker, plan.states[0], how.mismatch, 1.0, own_seed)
        interval = tracker.parameters.interval
        times: Array = np.asarray(interval * np.arange(ticks + 1), dtype=float)
        states, controls = [plant.state], []
        tracker.observe(plant.measure(), -interval)
        tracker.accept(plan, 0.0, -interval)
        for now in times[:-1].tolist():
            tracker.observe(plant.measure(), now)
            plant.command(tracker.command(now).control)
            controls.append(plant.control)
            plant.step(interval)
            states.append(plant.state)
        controls.append(plant.control)
        moved = np.array(states)[:, : len(plan.state_names)]
        seen, applied = Signals.both(plan, times, Sample(moved, np.array(controls)))
        own, followed = name if len(plans) > 1 else view.name, (FollowedPlan(plan, 0.0),)
        vehicles.append(RecordedVehicle(own, view, followed, states=seen, applied=applied))
    return Mission(problem.name, tuple(vehicles))


def tracker_of(problem: Problem, **values: Any) -> TrajectoryTracker:
    """
    Return the tracker of a problem's plant; `values` are its parameters beside the constants.

    Raise InvalidProblem if no tracker for plants of the problem is known.
    """
    if isinstance(problem, DirectProblem):
        return StatedTracker(problem, StatedTrackerParameters(**values))
    if isinstance(problem, (PendulumSwingUp, RobotFormation)):
        values |= {'plant': problem.plant, 'limits': problem.limits}
        if isinstance(problem, PendulumSwingUp):
            return PendulumTracker(PendulumTrackerParameters(**values))
        return RobotTracker(RobotTrackerParameters(**values))
    raise InvalidProblem(f"problem '{problem.name}' cannot be flown: no tracker of it is known")


def plant_of(
    tracker: TrajectoryTracker, initial: Array, mismatch: float, noise: float, seed: int
) -> SimulatedPlant:
    """
    Return the simulated plant of a tracker in state `initial` (nx,), reproducible by its `seed`.

    The plant's constants and actuator gains differ from the tracker's by up to `mismatch`; `noise`
    is that of its sensors, relative to what the estimator assumes.
    """
    actuators: dict[str, Any] = {}
    if isinstance(tracker, StatedTracker):
        plant: Any = DirectPlant(mismatched(tracker.problem, mismatch, seed))
        actuators['limits'] = plant.control_range
    else:
        plant = mismatched(tracker.plant, mismatch, seed)
    if isinstance(tracker, PendulumTracker):
        actuators['limits'] = tracker.parameters.limits.torque * np.array([[-1.0], [1.0]])
    elif isinstance(tracker, RobotTracker):
        actuators |= robot_actuators(tracker.parameters.limits, mismatch, seed)
        actuators['largest_step'] = 5e-3
    sensors = noise * tracker.estimator.noise.measurement[: initial.size]
    setup = PlantSetup(plant, initial, noise=sensors, **actuators)
    return SimulatedPlant(setup, seed)


def measured(problem: Problem, solution: Solution, how: ClosedLoop) -> dict[str, Any]:
    """
    Return what all flights of a plan come to, as columns of a study's row.

    `caught` counts the flights that end at the goal, `held` those of them that were there in time
    and stayed, within all limits; `lost` says why the first of the others was not held.
    """
    caught, held, lost = 0, 0, ''
    margins: dict[str, list[float]] = {}
    for seed in range(how.seeds):
        try:
            mission = fly(problem, solution, how, seed)
        except (TrajectoryRejected, NotFinite) as reason:  # too quick a plant for steps of 1 ms
            lost = lost or str(reason)
            continue
        verdict = judge(mission)
        if verdict is None:
            lost = lost or 'the flight cannot be judged: its states are not finite'
            continue
        caught += all(map(_at_goal, mission.vehicles))
        held += verdict.reached
        lost = lost or next(iter(verdict.reasons), verdict.undecided)
        for name, margin in _margins(mission):
            margins.setdefault(f'{FLOWN}{name}', []).append(margin)
    least = {name: min(values) for name, values in margins.items()}
    return {'flights': how.seeds, 'caught': caught, 'held': held, 'lost': lost, **least}


def _at_goal(vehicle: RecordedVehicle) -> bool:
    _, errors = goal_errors(vehicle.view, vehicle.plans[0].trajectory, vehicle.states)
    return not errors.size or bool(errors[-1] < 1.0)


def _margins(mission: Mission) -> Iterator[tuple[str, float]]:
    """Yield the limits by their names in the plan, and the smallest margin of each on a flight."""
    for vehicle in mission.vehicles:
        of = f'{vehicle.name}.' if len(mission.vehicles) > 1 else ''
        for name, margin in smallest(vehicle.margins.measured).items():
            yield f'{of}{name}', margin.worst
    for pair, distance in smallest(mission.separations.measured).items():
        yield pair, distance.worst - (mission.vehicles[0].view.separation or 0.0)
