# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plants that are not their trackers' models, each with its tracker, stepped together."""

from __future__ import annotations

from collections.abc import Mapping
import itertools
from typing import Any

from benchmark.receding import RecedingHorizon, Vehicle
from benchmark.scenarios import crossing
import numpy as np
from numpy.typing import NDArray
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.pendulum.task import VEHICLE
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning import ActivePlan, Replanner
from tdm_planner.tracking import (
    PendulumTracker,
    PendulumTrackerParameters,
    RobotTracker,
    RobotTrackerParameters,
)
from tdm_sim.simulation import mismatched, mismatched_gains, PlantSetup, SimulatedPlant

Array = NDArray[np.float64]

MISMATCH = 0.05
HELD_ANGLE, DISK_ANGLE = 0.05, 2.0  # rad
ARRIVED = 0.02  # m
PENDULUM_NOISE = np.array([0.0015, 0.0015, 0.1, 0.1])
ROBOT_NOISE = np.array([0.002, 0.002, 0.002, 0.002, 0.005, 0.005, 0.0])
RIGS = {
    'quick robots': {'limits.thrust': 1.05, 'limits.thruster_rate': 2.0, 'limits.torque': 0.02},
    'air bearing': {
        'limits.thrust': 0.315, 'limits.thruster_rate': 0.5, 'limits.torque': 0.00189,
    },
}  # fmt: skip


def pendulum_loop(
    problem: PendulumSwingUp,
    solution: Solution,
    interval: float,
    seed: int,
    replanner: Replanner,
) -> RecedingHorizon:
    """Return a pendulum about to execute a plan, commanded every `interval` s."""
    parameters = tracker_parameters(problem, interval)
    limit = np.array([problem.limits.torque])
    setup = PlantSetup(
        plant=mismatched(problem.plant, MISMATCH, seed),
        initial=solution.trajectory.states[0],
        lower=-limit,
        upper=limit,
        noise=PENDULUM_NOISE,
    )
    vehicle = Vehicle(PendulumTracker(parameters), SimulatedPlant(setup, seed))
    return _begun({VEHICLE: vehicle}, problem, solution, interval, replanner)


def tracker_parameters(problem: PendulumSwingUp, interval: float) -> PendulumTrackerParameters:
    """Return the parameters of the tracker that follows the plans of a problem."""
    values = {
        'rate': 1.0 / interval,
        'limits.torque': problem.limits.torque,
        'replan.on_deviation': True,
    }
    return build(PendulumTrackerParameters, values)


def crossing_of(rig: str, seed: int, **changes: Any) -> RobotFormation:
    """Return the crossing of a seed by three robots of one of the `RIGS`."""
    return RobotFormation.from_parameters(crossing(seed).parameters(**RIGS[rig], **changes))


def formation_loop(
    problem: RobotFormation,
    solution: Solution,
    interval: float,
    seed: int,
    replanner: Replanner,
) -> RecedingHorizon:
    """Return robots about to execute their plans, commanded every `interval` s."""
    limits = problem.limits
    upper = np.array([limits.thrust, limits.thruster_rate, limits.torque])
    values = {
        'rate': 1.0 / interval,
        'limits.thrust': limits.thrust,
        'limits.thruster_rate': limits.thruster_rate,
        'limits.torque': limits.torque,
        'replan.on_deviation': True,
    }
    parameters = build(RobotTrackerParameters, values)
    vehicles = {}
    for number, (name, plan) in enumerate(solution.trajectories.items(), 100 * seed):
        gains = mismatched_gains(3, MISMATCH, number)
        gains[1] = 1.0  # the thruster turns by a servo
        setup = PlantSetup(
            plant=mismatched(parameters.plant, MISMATCH, number),
            initial=plan.states[0],
            lower=upper * [0.0, -1.0, -1.0],
            upper=upper,
            noise=ROBOT_NOISE,
            gains=gains,
            largest_step=0.5 * interval,
        )
        vehicles[name] = Vehicle(RobotTracker(parameters), SimulatedPlant(setup, number))
    return _begun(vehicles, problem, solution, interval, replanner)


def _begun(
    vehicles: Mapping[str, Vehicle],
    problem: Problem,
    solution: Solution,
    interval: float,
    replanner: Replanner,
) -> RecedingHorizon:
    loop = RecedingHorizon(vehicles, problem, interval, replanner)
    loop.begin(ActivePlan(problem, solution, 0.0))
    return loop


def ticked(loop: RecedingHorizon) -> Array:
    """Step once; return the true states of all vehicles then, (n, nx)."""
    loop.tick()
    return np.array([vehicle.plant.state for vehicle in loop.vehicles.values()])


def nearest(places: Array) -> Array:
    """Return the smallest distance of every pair along ways (n_times, n, 2) [m]."""
    pairs = itertools.combinations(range(places.shape[1]), 2)
    apart = [np.linalg.norm(places[:, i] - places[:, j], axis=1).min() for i, j in pairs]
    return np.array(apart)
