# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plants that are not their trackers' models, each with its tracker, stepped together."""

from __future__ import annotations

import itertools
from typing import Any

from benchmark.receding import RecedingHorizon
from benchmark.scenarios import crossing
import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning import ActivePlan, Replanner
from tdm_planner.tracking.tracker_parameters import ReplanOnDeviation
from tdm_sim.study.flights import tracked, tracker_of

Array = NDArray[np.float64]

MISMATCH = 0.05
HELD_ANGLE, DISK_ANGLE = 0.05, 2.0  # rad
ARRIVED = 0.02  # m
RIGS = {
    'quick robots': {'limits.thrust': 1.05, 'limits.thruster_rate': 2.0, 'limits.torque': 0.02},
    'air bearing': {
        'limits.thrust': 0.315, 'limits.thruster_rate': 0.5, 'limits.torque': 0.00189,
    },
}  # fmt: skip


def crossing_of(rig: str, seed: int, **changes: Any) -> RobotFormation:
    """Return the crossing of a seed by three robots of one of the `RIGS`."""
    return RobotFormation.from_parameters(crossing(seed).parameters(**RIGS[rig], **changes))


def loop_of(
    problem: Problem, solution: Solution, interval: float, seed: int, replanner: Replanner
) -> RecedingHorizon:
    """Return vehicles about to execute their plans, commanded every `interval` s."""
    recovers = ReplanOnDeviation(on_deviation=True)
    plans = solution.trajectories.items()
    vehicles = {
        name: tracked(
            tracker_of(problem, rate=1.0 / interval, replan=recovers),
            plan.states[0],
            MISMATCH,
            1.0,
            len(plans) * seed + number,
        )
        for number, (name, plan) in enumerate(plans)
    }
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
