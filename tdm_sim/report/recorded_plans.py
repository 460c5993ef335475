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
from tdm_planner.plant_kind import PlantKind
from tdm_planner.trajectory import Interpolation, NANOSECOND, Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.mission import FollowedPlan
from tdm_sim.report.recorded_topics import PLAN, Received, RecordedTopics, STATUSES

# Of action_msgs/GoalStatus: statuses of a plan that was begun, and those of one that is over.
_BEGUN = {2, 3, 4}  # EXECUTING, CANCELING, SUCCEEDED
_OVER = {5, 6}  # CANCELED, ABORTED


@dataclass(frozen=True, eq=False)
class RecordedPlan:
    """A plan whose motion starts at the instant `start` [ns]."""

    start: int
    trajectory: Trajectory


def read_plans(
    topics: RecordedTopics,
    namespace: str,
    kind: PlantKind,
    told: Mapping[int, Interpolation | None],
    notes: list[str],
) -> list[RecordedPlan]:
    """
    Return the plans published in a vehicle's namespace, in the order of their starts.

    `told` is what summaries say of the samples, by the start of the motion [ns]. A plan that
    cannot be read is told in `notes`, and so are those that the tracker never began: it rejected
    them, or they were superseded while pending.
    """
    motions = _by_start(topics, f'{namespace}/trajectory')
    never_begun = _never_begun(topics, f'{namespace}/tracker_status') & set(motions)
    if never_begun:
        notes.append(
            f'{len(never_begun)} of the plans on {namespace}/trajectory were rejected by the '
            'tracker or superseded before they began.'
        )
    plans = []
    for start in sorted(set(motions) - never_begun):
        try:
            trajectory = read_plan(kind, motions[start], told.get(start))
        except (InvalidProblem, ValueError, IndexError) as error:
            reason = untrusted.text(str(error))
            notes.append(f'A plan on {namespace}/trajectory cannot be read: {reason}.')
            continue
        plans.append(RecordedPlan(start, trajectory))
    return plans


def followed(
    plans: Sequence[RecordedPlan], origin: int, plan_ids: Mapping[int, str]
) -> tuple[FollowedPlan, ...]:
    """Return plans with times from `origin` [ns], each until the next one starts."""
    starts = [(plan.start - origin) * NANOSECOND for plan in plans]
    ends = [*starts[1:], None][: len(starts)]
    return tuple(
        FollowedPlan(plan.trajectory, start, plan_ids.get(plan.start, ''), until)
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
    if topics.types.get(topic) != PLAN:
        return {}
    found: Sequence[Received] = topics.messages.get(topic, ())
    return {nanoseconds_of(item.message.header.stamp): item.message for item in found}
