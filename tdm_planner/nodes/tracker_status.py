# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.
"""The status of every plan of a tracker, as of an action's goals, and the plan it follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from rclpy.node import Node
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.tracking import Phase, TrajectoryTracker
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory

TOPIC = 'tracker_status'

_ACTIVE: Mapping[Phase, int] = MappingProxyType(
    {
        Phase.WAITING: GoalStatus.STATUS_ACCEPTED,
        Phase.TRACKING: GoalStatus.STATUS_EXECUTING,
        Phase.HOLDING: GoalStatus.STATUS_SUCCEEDED,
    }
)
_OVER = (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED)


def goal_id(start: int) -> list[int]:
    """Return the id of the plan that starts at the instant [ns]: the bytes of that number."""
    return list(start.to_bytes(16, 'big', signed=True))


def goal_status(start: int, status: int) -> GoalStatus:
    """Return the status of the plan that starts at the instant [ns]."""
    info = GoalInfo(stamp=to_stamp(start))
    info.goal_id.uuid = goal_id(start)
    return GoalStatus(goal_info=info, status=status)


@dataclass(eq=False)
class _Plan:
    trajectory: Trajectory | None  # of a rejected plan: none
    start: int
    message: bytes = b''  # it came in
    status: int = GoalStatus.STATUS_UNKNOWN


class TrackerStatus:
    """
    Publishes the status of every plan on `tracker_status`, whenever one changes.

    Publishes on `active_trajectory` the active or pending plan as received; empty without one.
    Both topics are latched for late subscribers: viewers, planners that were restarted.

    ACCEPTED   to be executed from its start on
    EXECUTING  being tracked
    SUCCEEDED  its end was reached, and is held until another status or plan follows
    CANCELING  stopped; the plant is being brought to rest (`replan.on_deviation`)
    ABORTED    rejected, or stopped after a deviation: it is not executed any more
    CANCELED   superseded by a newer plan, or the tracker was deactivated

    A plan that is over is reported once, and afterwards only while no other plan is active.
    """

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(GoalStatusArray, TOPIC, LATCHED)
        self._followed = node.create_publisher(JointTrajectory, 'active_trajectory', LATCHED)
        self._announced: Trajectory | None = None
        self._plans: list[_Plan] = []
        self._changed = False

    def begin(self) -> None:
        """Forget all plans, and publish that: the tracker has become active."""
        self._plans = []
        self._publish()

    def accepted(self, trajectory: Trajectory, start: int, message: bytes) -> None:
        """Add an accepted plan that starts at the instant `start` [ns], with its message."""
        self._plans.append(_Plan(trajectory, start, message))

    def rejected(self, start: int, tracker: TrajectoryTracker) -> None:
        """Add a plan that the tracker has rejected."""
        if any(plan.start == start for plan in self._plans):
            return
        canceling = GoalStatus.STATUS_CANCELING
        begun = tracker.unquiet and all(plan.status != canceling for plan in self._plans)
        status = canceling if begun else GoalStatus.STATUS_ABORTED
        self._plans.append(_Plan(None, start, status=status))
        self._changed = True

    def update(self, tracker: TrajectoryTracker) -> None:
        """Publish what has changed since the last call."""
        self._announce(None if tracker.newest is None else tracker.newest.trajectory)
        active = {id(m.trajectory) for m in (tracker.current, tracker.following) if m is not None}
        newest = max(
            (i for i, p in enumerate(self._plans) if id(p.trajectory) in active), default=-1
        )
        for number, plan in enumerate(self._plans):
            status = self._status(plan, tracker, superseded=number < newest)
            self._changed |= status != plan.status
            plan.status = status
        if self._changed:
            self._publish()
            self._plans = [
                plan
                for plan in self._plans
                if plan.status not in _OVER
                or id(plan.trajectory) in active
                or (not active and plan is self._plans[-1])
            ]

    def cancel(self) -> None:
        """Publish that the tracker executes nothing any more."""
        self._announce(None)
        for plan in self._plans:
            plan.status = GoalStatus.STATUS_CANCELED
        self._publish()

    def _announce(self, followed: Trajectory | None) -> None:
        if followed is self._announced:
            return
        self._announced = followed
        told = [plan.message for plan in self._plans if plan.trajectory is followed]
        self._followed.publish(JointTrajectory() if followed is None else told[0])

    @staticmethod
    def _status(plan: _Plan, tracker: TrajectoryTracker, superseded: bool) -> int:
        for motion, status in (
            (tracker.following, GoalStatus.STATUS_ACCEPTED),
            (tracker.current, _ACTIVE.get(tracker.phase, GoalStatus.STATUS_UNKNOWN)),
        ):
            if motion is not None and motion.trajectory is plan.trajectory:
                return int(status)
        if plan.status in (GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED):
            return plan.status
        if superseded and plan.status != GoalStatus.STATUS_CANCELING:
            succeeded = plan.status == GoalStatus.STATUS_SUCCEEDED
            return plan.status if succeeded else int(GoalStatus.STATUS_CANCELED)
        gone = GoalStatus.STATUS_CANCELING if tracker.unquiet else GoalStatus.STATUS_ABORTED
        return int(gone)

    def _publish(self) -> None:
        self._changed = False
        told = [goal_status(plan.start, plan.status) for plan in self._plans]
        self._publisher.publish(GoalStatusArray(status_list=told))
