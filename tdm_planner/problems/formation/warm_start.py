# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The rest of an earlier plan: initial guess of the next one, or kept unchanged.

An error across the thrust is corrected by turning the thruster away and back; where there is no
time left for that the rest of the plan is as good as any other, and the feedback about it takes
such errors away. So robots about to arrive keep their motions, and the others plan round them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation.reference_motion import ReferenceMotion
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.verification import start_state
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

LATE: Final = 3.0  # half-turns of the thruster before the arrival: away, thrusting, and back
_SAME = np.full(7, 1e-6)  # difference of a start from the plan's that is rounding
_MISSED = np.array([2e-3, 2e-3, 2e-3, 2e-3, 5e-3, 5e-3])  # by which the rest may miss the goal
_INSTANTS = 400
_LEAST = 1e-3  # s that is left of a motion that has ended
_ENDED = 0.02  # of the longest motion that is left: robots with less have arrived


def turning_time(thruster_rate: float) -> float:
    """Time that half a turn of the thruster takes [s]."""
    return math.pi / thruster_rate


def rest_of(task: FormationTask, previous: Solution) -> dict[str, Trajectory]:
    """
    Return what is left of a plan by name; nothing of one for other robots.

    How far the plan has been followed is read from the robots' states: the instant at which, all
    robots together, the plan is nearest to where they are. A plan on which one of them is just
    beginning has not been followed.
    """
    if set(previous.trajectories) != set(task.names):
        return {}
    plans = {name: previous.trajectories[name] for name in task.names}
    begun = [
        (np.abs(plan.states[0, :6] - start_state(task, i)[:6]) < _SAME[:6]).all()
        for i, plan in enumerate(plans.values())
    ]
    if any(begun):
        return plans
    now = _elapsed_on(list(plans.values()), np.concatenate([task.start, task.velocity], axis=1))
    if now == 0.0:
        return plans
    left = {name: max(plan.duration - _LEAST, 0.0) for name, plan in plans.items()}
    return {name: plan.after(min(now, left[name])) for name, plan in plans.items()}


def _elapsed_on(plans: list[Trajectory], now: Array) -> float:
    """Instant of the plans nearest to positions and velocities `now` (n, 4)."""
    last = max(plan.duration for plan in plans)
    times = np.linspace(0.0, last, _INSTANTS)
    distance = np.zeros(times.size)
    for plan, state in zip(plans, now, strict=True):
        planned = plan.sample(times).state[:, :4]
        scale = np.array([1.0, 1.0, last / 4, last / 4])
        distance += np.square((planned - state) * scale).sum(axis=1)
    return float(times[np.argmin(distance)])


def warm_parameters(model: ReferenceMotion, usual: Array, rest: Mapping[str, Trajectory]) -> Array:
    """
    Varied parameters (n, P) that bend as the `rest` of a plan does.

    Robots whose motion has ended take the `usual` durations (n,) s, and go straight.
    """
    plans = [rest[name] for name in model.task.names]
    durations = np.array([plan.duration for plan in plans])
    ended = durations < _ENDED * durations.max()
    durations[ended] = usual[ended]

    def bend(s: Array) -> Array:
        found = np.zeros((len(plans), 2, s.size))
        for i, plan in enumerate(plans):
            state, control = plan.sample(plan.times[0] + plan.duration * s)
            heading = state[:, 4] + state[:, 6]
            push = control[:, 0] / model.task.plant.mass * durations[i] ** 2
            found[i] = push * np.stack([np.cos(heading), np.sin(heading)])
        return found

    x = model.fit(np.repeat(durations[:, None], model.nb, axis=1), bend)
    x[ended[:, None] & (np.arange(model.size) >= model.nb)] = 0.0
    return x


def kept_motions(
    task: FormationTask, plans: Mapping[str, Trajectory], half_turns: float
) -> dict[str, Trajectory]:
    """
    Motions of the robots that are to keep what is left of `plans`, by name.

    They start on their plans, end at their goals, and have less time before them than so many
    `half_turns` of the thruster take.
    """
    leg = half_turns * turning_time(task.thruster_rate)
    found = {}
    for i, name in enumerate(task.names):
        if task.staying[i] or name not in plans or not plans[name].duration < leg:
            continue
        rest = _flown_from(task, i, plans[name])
        if rest is not None:
            found[name] = rest
    return found


def _flown_from(task: FormationTask, robot: int, plan: Trajectory) -> Trajectory | None:
    """Return the plan as flown from the robot's start; None if they differ, or the goals do."""
    start = start_state(task, robot)
    if not (np.abs(plan.states[0] - start) < _SAME).all():
        return None
    begun = replace(plan, states=np.concatenate([start[None], plan.states[1:]]))
    states = task.plant.replay(begun, plan.times)
    if states is None:
        return None
    goal = np.array([*task.goal[robot], 0.0, 0.0, task.goal_yaw[robot], 0.0])
    if not (np.abs(states[-1, :6] - goal) < _MISSED).all():
        return None
    return replace(plan, states=states)
