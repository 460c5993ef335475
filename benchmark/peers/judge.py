# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Whether a solution is one: its controls flown through the true dynamics, as every plan's are.

The replay takes nothing from a peer but its controls: whoever applies them ends where it ends. The
tolerances are wider than those that plans of this package must keep.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.verification import (
    gas_used,
    robot_constraints,
    separation_constraints,
)
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import check, Constraint, replay, verify

Array = NDArray[np.float64]

# rad, rad/s: from there a linear feedback holds the pendulum.
PENDULUM_TOLERANCE = np.array([0.05, 0.05, 0.5, 0.5])
DISK_SLACK = 0.01  # rad
# m, m/s, rad, rad/s; the thruster's angle is free.
ROBOT_TOLERANCE = np.array([0.02, 0.02, 0.01, 0.01, 0.05, 0.02, np.inf])
DISTANCE_SLACK = 0.01  # m
_RESOLUTION = 0.02  # s


def judge_pendulum(task: SwingUpTask, motion: Trajectory) -> tuple[str, ...]:
    """Reasons why a swing-up is none; empty if it lands and keeps the limits."""
    constraints = (
        Constraint(
            'torque', lambda t, x, u: task.torque_limit - np.abs(u[:, 0]), 1e-9 * task.torque_limit
        ),
        Constraint('disk_angle', lambda t, x, u: task.disk_angle - np.abs(x[:, 1]), DISK_SLACK),
    )
    anywhere = np.full(4, np.inf)
    return verify(
        task.plant,
        motion,
        task.goal_nearest(motion.states[-1]),
        PENDULUM_TOLERANCE,
        constraints,
        consistency=anywhere,
    ).reasons


def judge_formation(task: FormationTask, motions: Mapping[str, Trajectory]) -> tuple[str, ...]:
    """Reasons why a manoeuvre is none; empty if all robots land, keep limits and stay apart."""
    goal = np.concatenate([task.goal, np.zeros((task.n, 2)), task.goal_yaw[:, None]], axis=1)
    reasons: list[str] = []
    for i, name in enumerate(task.names):
        constraints = [
            Constraint(c.name, c.margin, DISTANCE_SLACK if c.unit == 'm' else c.tolerance, c.unit)
            for c in robot_constraints(task)
        ]
        reasons += verify(
            task.plant,
            motions[name],
            np.array([*goal[i], 0.0, 0.0]),
            ROBOT_TOLERANCE,
            constraints,
            consistency=np.full(7, np.inf),
        ).reasons
    apart = [
        Constraint(c.name, c.margin, DISTANCE_SLACK, c.unit) for c in separation_constraints(task)
    ]
    times, states = _together(task, motions)
    return (*reasons, *check(apart, times, states, np.zeros((times.size, 3 * task.n)))[2])


def _together(task: FormationTask, motions: Mapping[str, Trajectory]) -> tuple[Array, Array]:
    """Return common instants and the replayed states (n_times, n 7); who has arrived is parked."""
    last = max(motion.duration for motion in motions.values())
    times = np.linspace(0.0, last, int(np.ceil(last / _RESOLUTION)) + 1)
    states = []
    for name in task.names:
        own = np.union1d(times[times <= motions[name].duration], motions[name].times[-1])
        flown = replay(task.plant, motions[name], own)
        states.append(flown[np.minimum(np.searchsorted(own, times), own.size - 1)])
    return times, np.concatenate(states, axis=1)


def formation_cost(task: FormationTask, motions: Mapping[str, Trajectory]) -> float:
    """J of (28), from the arrival times and the thrust that is flown."""
    arrivals = np.array([motions[name].duration for name in task.names])
    gas = np.array([gas_used(task.plant, motions[name]) for name in task.names])
    return sum(task.cost_terms(arrivals, gas).values())
