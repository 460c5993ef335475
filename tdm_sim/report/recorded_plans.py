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

"""Plans of vehicles, out of the trajectory messages of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import (
    nanoseconds_of,
    PENDULUM_JOINTS,
    pendulum_trajectory,
    robot_motion,
    robot_trajectory,
)
from tdm_planner.trajectory import NANOSECOND, Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.mission import PlanInForce, Plant
from tdm_sim.report.plan_documents import PlannedVehicle
from tdm_sim.report.recorded_topics import (
    BODY_PLAN,
    JOINT_PLAN,
    Received,
    RecordedTopics,
    STATUSES,
)

Array = NDArray[np.float64]

_UNKNOWN = PlannedVehicle(None, {})
# Of action_msgs/GoalStatus: statuses of a plan that was begun, and those of one that is over.
_BEGUN = {2, 3, 4}  # EXECUTING, CANCELING, SUCCEEDED
_OVER = {5, 6}  # CANCELED, ABORTED


@dataclass(frozen=True, eq=False)
class TimedPlan:
    """A plan whose motion starts at the instant `start` [ns]."""

    start: int
    trajectory: Trajectory


def read_plans(
    topics: RecordedTopics,
    namespace: str,
    plant: Plant,
    said: Mapping[int, PlannedVehicle],
    notes: list[str],
) -> list[TimedPlan]:
    """
    Return the plans published in a vehicle's namespace, in the order of their starts.

    `said` is what summaries say of the vehicle, by the start of the motion [ns]. A plan that
    cannot be read is told in `notes`, and so are those that the tracker never began: it rejected
    them, or they were superseded while pending.
    """
    motions = _by_start(topics, f'{namespace}/trajectory')
    controls = _by_start(topics, f'{namespace}/controls')
    plans = []
    never_begun = _never_begun(topics, f'{namespace}/tracker_status') & set(motions)
    if never_begun:
        notes.append(
            f'{len(never_begun)} of the plans on {namespace}/trajectory were rejected by the '
            'tracker or superseded before they began.'
        )
    for start in sorted(set(motions) - never_begun):
        told = said.get(start, _UNKNOWN)
        try:
            trajectory = _read(plant, motions[start], controls.get(start), told)
        except (InvalidProblem, ValueError, IndexError) as error:
            reason = untrusted.text(str(error))
            notes.append(f'A plan on {namespace}/trajectory cannot be read: {reason}.')
            continue
        if plant != 'pendulum' and start not in controls:
            notes.append(
                f'{namespace}/controls of a plan is not in the recording: its planned controls '
                'are missing.'
            )
        plans.append(TimedPlan(start, trajectory))
    if controls and not motions:
        notes.append(
            f'{namespace}/trajectory is not in the recording: what was planned for this vehicle '
            'is missing.'
        )
    return plans


def in_force(
    plans: Sequence[TimedPlan], origin: int, plan_ids: Mapping[int, str]
) -> tuple[PlanInForce, ...]:
    """Return plans with times from `origin` [ns], each until the next one starts."""
    starts = [(plan.start - origin) * NANOSECOND for plan in plans]
    ends = [*starts[1:], None][: len(starts)]
    return tuple(
        PlanInForce(plan_ids.get(plan.start, ''), start, plan.trajectory, until)
        for plan, start, until in zip(plans, starts, ends, strict=True)
    )


def _never_begun(topics: RecordedTopics, topic: str) -> set[int]:
    """Return the starts [ns] of plans that ended before they began, by what a tracker told."""
    told: dict[int, set[int]] = {}
    if topics.types.get(topic) == STATUSES:
        for item in topics.messages.get(topic, ()):
            for status in item.message.status_list:
                start = nanoseconds_of(status.goal_info.stamp)
                told.setdefault(start, set()).add(int(status.status))
    return {start for start, seen in told.items() if seen & _OVER and not seen & _BEGUN}


def _by_start(topics: RecordedTopics, topic: str) -> dict[int, Any]:
    """Messages of a topic of trajectories by the start of their motion; the last one counts."""
    if topics.types.get(topic) not in (JOINT_PLAN, BODY_PLAN):
        return {}
    found: Sequence[Received] = topics.messages.get(topic, ())
    return {nanoseconds_of(item.message.header.stamp): item.message for item in found}


def _read(plant: Plant, motion: Any, controls: Any, told: PlannedVehicle) -> Trajectory:
    if plant == 'pendulum':
        return pendulum_trajectory(motion, told.interpolation)
    if plant == 'robot':
        if controls is None:
            return robot_motion(motion)
        return robot_trajectory(motion, controls, interpolation=told.interpolation)
    return _named_trajectory(motion, controls, told)


def _named_trajectory(motion: Any, controls: Any, told: PlannedVehicle) -> Trajectory:
    """Read a plan whose joints are the names of states (positions) and controls (effort)."""
    times = _instants(motion)
    if controls is None:
        efforts, names = np.zeros((times.size, 0)), []
    else:
        if not np.array_equal(times, _instants(controls)):
            raise InvalidProblem(
                "the samples of 'trajectory' and 'controls' differ in their times"
            )
        efforts = np.array([point.effort for point in controls.points], dtype=float)
        names = list(controls.joint_names)
    trajectory = Trajectory(
        times=times,
        states=np.array([point.positions for point in motion.points], dtype=float),
        controls=efforts,
        state_names=tuple(untrusted.text(name, 60) for name in motion.joint_names),
        control_names=tuple(untrusted.text(name, 60) for name in names),
        interpolation=told.interpolation or 'linear',
    )
    return replace(
        trajectory,
        state_units=tuple(told.units.get(name, '') for name in trajectory.state_names),
        control_units=tuple(told.units.get(name, '') for name in trajectory.control_names),
    )


def _instants(message: Any) -> Array:
    nanoseconds = [nanoseconds_of(point.time_from_start) for point in message.points]
    return np.array(nanoseconds, dtype=float) * NANOSECOND


def is_pendulum(message: Any) -> bool:
    """Whether a JointTrajectory moves the pendulum."""
    return set(PENDULUM_JOINTS) <= set(message.joint_names)
