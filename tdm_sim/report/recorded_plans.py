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
from dataclasses import dataclass
from typing import Any

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.plant_kind import BUILT_IN, PENDULUM, PlantKind
from tdm_planner.trajectory import NANOSECOND, Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.mission import PlanInForce, Plant
from tdm_sim.report.plan_documents import PlannedVehicle
from tdm_sim.report.recorded_topics import JOINT_PLAN, Received, RecordedTopics, STATUSES

_UNKNOWN = PlannedVehicle(None, {})
# Of action_msgs/GoalStatus: statuses of a plan that was begun, and those of one that is over.
_BEGUN = {2, 3, 4}  # EXECUTING, CANCELING, SUCCEEDED
_OVER = {5, 6}  # CANCELED, ABORTED


@dataclass(frozen=True, eq=False)
class TimedPlan:
    """A plan whose motion starts at the instant `start` [ns], and the plant that it moves."""

    start: int
    trajectory: Trajectory
    kind: PlantKind


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
            kind = BUILT_IN.get(plant) or _named(told)
            trajectory = read_plan(kind, motions[start], told.interpolation)
        except (InvalidProblem, ValueError, IndexError) as error:
            reason = untrusted.text(str(error))
            notes.append(f'A plan on {namespace}/trajectory cannot be read: {reason}.')
            continue
        plans.append(TimedPlan(start, trajectory, kind))
    return plans


def in_force(
    plans: Sequence[TimedPlan], origin: int, plan_ids: Mapping[int, str]
) -> tuple[PlanInForce, ...]:
    """Return plans with times from `origin` [ns], each until the next one starts."""
    starts = [(plan.start - origin) * NANOSECOND for plan in plans]
    ends = [*starts[1:], None][: len(starts)]
    return tuple(
        PlanInForce(plan_ids.get(plan.start, ''), start, plan.trajectory, until, plan.kind)
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
    if topics.types.get(topic) != JOINT_PLAN:
        return {}
    found: Sequence[Received] = topics.messages.get(topic, ())
    return {nanoseconds_of(item.message.header.stamp): item.message for item in found}


def _named(told: PlannedVehicle) -> PlantKind:
    """Return the plant of a summary's joints: states are positions and velocities."""
    if not told.joints:
        raise InvalidProblem('no summary says which states its joints have')
    states = [name for joint in told.joints for name in (joint.position, joint.velocity) if name]
    controls = [joint.effort for joint in told.joints if joint.effort]
    ordered = [name for name in told.units if name in states]
    ordered += [name for name in states if name not in ordered]
    return PlantKind(
        state_names=tuple(ordered),
        control_names=tuple(controls),
        joints=told.joints,
        state_units=tuple(told.units.get(name, '') for name in ordered),
        control_units=tuple(told.units.get(name, '') for name in controls),
        interpolation='linear',
    )


def is_pendulum(message: Any) -> bool:
    """Whether a JointTrajectory moves the pendulum."""
    return {joint.name for joint in PENDULUM.joints} <= set(message.joint_names)
