# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The plans of a tracker: when each is examined, and its status, as of an action's goal.

A tracker tells of its plans by `TrackerStatus`. From there the planner knows what it does, by
`TrackerWatch`, and, after a restart, which plan is active, by `Recovery`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
import math
import time
from typing import Any

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.clocks import MotionClock, steady_timer
from tdm_planner.nodes.messages import LATCHED, to_stamp
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.parameters import build, specifications
from tdm_planner.plant_kind import PlantKind
from tdm_planner.tracking.motion import next_step, ObservedPhase, Steps, TrackerParameters
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.trajectory import SECOND, Trajectory
from trajectory_msgs.msg import JointTrajectory

TOPIC = 'tracker_status'
FOLLOWED = 'active_trajectory'
WINDOW = 10.0  # s after the planner's start in which a followed plan is its predecessor's

_EXECUTED: Mapping[bool | None, int] = {  # by whether the goal was reached
    None: GoalStatus.STATUS_EXECUTING,
    True: GoalStatus.STATUS_SUCCEEDED,
    False: GoalStatus.STATUS_ABORTED,
}
_LAST = 2**31 * SECOND - 1  # ns; a later instant is no stamp
_OVER = (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED)
_PERIOD = 0.2  # s between attempts to ask for the parameters
_ANSWER_WAIT = 2.0  # s that an answer may take: its client may have been met only just now
_FOLLOWED = (GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_SUCCEEDED)
_UNDER_WAY = (GoalStatus.STATUS_ACCEPTED, *_FOLLOWED)


class PlanIntake:
    """
    Has the newest plan received, the one `waiting`, examined by `look_at`, in steps.

    Between two ticks it takes `most` s of work, and what the step at that time takes. A plan is
    the stamp and the serialised form of its message: deserialising costs milliseconds. One that is
    superseded before the examination of the last has ended is not deserialised.
    """

    def __init__(self, look_at: Callable[[Any, bytes], Steps[bool]], most: float) -> None:
        self._look_at, self._most, self._left = look_at, most, most
        self._steps: Steps[bool] | None = None
        self._examined: tuple[Any, bytes] | None = None
        self._spent = 0.0  # s on the plan that is examined
        self.waiting: tuple[Any, bytes] | None = None
        self.took = 0.0  # s of work on the last plan that was accepted

    def tick(self) -> None:
        """Go on; there is as much time as before."""
        self._left = self._most
        self.go_on()

    def go_on(self) -> None:
        """Go on with the examination, or begin the next, while there is time until the tick."""
        while self._left > 0.0:
            began = time.perf_counter()
            if self._steps is None and self.waiting is not None:
                self._examined, self.waiting, self._spent = self.waiting, None, 0.0
                self._steps = self._look_at(*self._examined)
            if self._steps is None:
                return
            accepted = False
            try:
                next_step(self._steps)
            except StopIteration as end:
                self._steps, accepted = None, end.value
            took = time.perf_counter() - began
            self._left, self._spent = self._left - took, self._spent + took
            if accepted:
                self.took = self._spent

    def begin_anew(self) -> None:
        """Examine the plan under examination from its beginning: by another tracker."""
        if self._steps is not None:
            self._steps, self.waiting = None, self.waiting or self._examined


def goal_status(start: int, status: int) -> GoalStatus:
    """Return the status of the plan that starts at the instant [ns]: its id is that number."""
    info = GoalInfo(stamp=to_stamp(min(start, _LAST)))
    info.goal_id.uuid = list(start.to_bytes(16, 'big', signed=True))
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
    EXECUTING  being tracked, or held but not at the goal yet
    SUCCEEDED  the plant was measured at its goal, which is held until another status or plan
    CANCELING  stopped; the plant is being brought to rest (`replan.on_deviation`)
    ABORTED    rejected, stopped after a deviation, or not at the goal in time: its end is held on
    CANCELED   superseded by a newer plan, or the tracker was deactivated

    A plan that is over is reported once, and afterwards only while no other plan is active.
    """

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(GoalStatusArray, TOPIC, LATCHED)
        self._followed = node.create_publisher(JointTrajectory, FOLLOWED, LATCHED)
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

    def follows(self, trajectory: Trajectory, start: int, tracker: TrajectoryTracker) -> bool:
        """Whether the very plan that starts at the instant `start` [ns] is active already."""
        # Not by when its motion began: the time of day may have been set since.
        motions = (m for m in (tracker.current, tracker.pending) if m and m.is_of(trajectory))
        active = {id(motion.trajectory) for motion in motions}
        return any(plan.start == start and id(plan.trajectory) in active for plan in self._plans)

    def rejected(self, start: int, tracker: TrajectoryTracker) -> None:
        """Add a plan that the tracker has rejected."""
        if any(plan.start == start for plan in self._plans):
            return
        canceling = GoalStatus.STATUS_CANCELING
        begun = tracker.braking and all(plan.status != canceling for plan in self._plans)
        status = canceling if begun else GoalStatus.STATUS_ABORTED
        self._plans.append(_Plan(None, start, status=status))
        self._changed = True

    def update(self, tracker: TrajectoryTracker) -> None:
        """Publish what has changed since the last call."""
        self._announce(None if tracker.newest is None else tracker.newest.trajectory)
        active: dict[int, int] = {}  # status by a trajectory's identity
        if tracker.current is not None:
            active[id(tracker.current.trajectory)] = _EXECUTED[tracker.current.reached]
        if tracker.pending is not None:
            active[id(tracker.pending.trajectory)] = GoalStatus.STATUS_ACCEPTED
        gone = GoalStatus.STATUS_CANCELING if tracker.braking else GoalStatus.STATUS_ABORTED
        superseded = False
        for plan in reversed(self._plans):
            before = plan.status
            if id(plan.trajectory) in active:
                plan.status, superseded = active[id(plan.trajectory)], True
            elif before in (GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED):
                continue
            elif not superseded or before == GoalStatus.STATUS_CANCELING:
                plan.status = gone
            elif before != GoalStatus.STATUS_SUCCEEDED:
                plan.status = GoalStatus.STATUS_CANCELED
            self._changed |= plan.status != before
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

    def _publish(self) -> None:
        self._changed = False
        told = [goal_status(plan.start, plan.status) for plan in self._plans]
        self._publisher.publish(GoalStatusArray(status_list=told))


class TrackerWatch:
    """
    Listens to the tracker in the namespace `prefix` ('' or 'robot1/') of a planner.

    `parameters` are the tracker's, of `parameter_class`; None until they are known. They are read
    when a tracker becomes active, and whenever one of them has changed. Of a tracker without
    `parameter_class` nothing is known but what it publishes. Instants are those of `clock` [s].
    Safe in any thread.
    """

    def __init__(
        self,
        node: Node,
        clock: MotionClock,
        prefix: str,
        parameter_class: type[TrackerParameters] | None,
    ) -> None:
        self._node, self._clock, self._class, self.prefix = node, clock, parameter_class, prefix
        # Status by start [ns], and that start's instant when it was first told; None: none heard.
        self._plans: dict[int, tuple[int, float]] | None = None
        self.parameters: TrackerParameters | None = None
        self._names = [] if parameter_class is None else list(specifications(parameter_class))
        self._due = math.inf  # when to ask for the parameters [s]
        self._asked: Future | None = None
        self._topic = node.create_subscription(
            GoalStatusArray, f'{prefix}{TOPIC}', self._on_status, LATCHED
        ).topic_name
        self._client = node.create_client(GetParameters, f'{prefix}tracker/get_parameters')
        self._name = self._client.service_name.removesuffix('/get_parameters')
        node.create_subscription(
            ParameterEvent, '/parameter_events', self._on_event, qos_profile_parameter_events
        )
        steady_timer(node, _PERIOD, self._ask)

    @property
    def inactive(self) -> bool:
        """Whether the tracker is not active yet, not any more, or gone after it was heard."""
        if self._plans is None:  # its node may be there; it tells nothing until it is active
            return self._class is not None and bool(self._client.service_is_ready())
        canceled = all(s == GoalStatus.STATUS_CANCELED for s, _ in self._plans.values())
        return canceled or self._node.count_publishers(self._topic) == 0

    @property
    def has_plan(self) -> bool | None:
        """Whether it has a plan, active or pending; None: it publishes, but was not heard yet."""
        if self._plans is None:
            return None if self._node.count_publishers(self._topic) else False
        return any(status in _UNDER_WAY for status, _ in self._plans.values())

    def followed(self, now: float) -> float | None:
        """Return the start of the plan followed at the instant `now`, None for none."""
        begun = [
            begin
            for status, begin in (self._plans or {}).values()
            if status in _FOLLOWED or (status == GoalStatus.STATUS_ACCEPTED and begin <= now)
        ]
        return max(begun, default=None)

    def phase(self, now: float) -> ObservedPhase:
        """
        Return what the tracker does at the instant `now`.

        If none was heard, another controller is assumed to follow the plan.
        """
        plans = self._plans
        if plans is None or self.followed(now) is not None:
            return ObservedPhase.FOLLOWING
        recovers = any(status == GoalStatus.STATUS_CANCELING for status, _ in plans.values())
        return ObservedPhase.RECOVERING if recovers else ObservedPhase.IDLE

    def rejects(self, start: int) -> bool:
        """Whether the tracker neither follows nor awaits the plan of instant `start` [ns]."""
        unknown = GoalStatus.STATUS_UNKNOWN, 0.0
        return self._plans is not None and self._plans.get(start, unknown)[0] not in _UNDER_WAY

    def forget_plans(self) -> None:
        """Forget the plans told so far."""
        self._plans = None if self._plans is None else {}

    def _on_status(self, message: GoalStatusArray) -> None:
        told = {nanoseconds_of(item.goal_info.stamp): item.status for item in message.status_list}
        known, instant = self._plans or {}, self._clock.instant
        self._plans = {k: (told[k], known[k][1] if k in known else instant(k)) for k in told}
        if self.parameters is None or not told:
            self._due = 0.0
            self._ask()

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node == self._name:
            self._due = 0.0

    def _ask(self) -> None:
        """Ask for the parameters when that is due, and again where no answer comes."""
        now, ready = time.monotonic(), self._plans is not None and self._client.service_is_ready()
        if now < self._due or self._class is None or not ready:
            return
        self._due = now + _ANSWER_WAIT
        if self._asked is not None:  # it would be kept for ever
            self._client.remove_pending_request(self._asked)
        self._asked = self._client.call_async(GetParameters.Request(names=self._names))
        self._asked.add_done_callback(self._on_answer)

    def _on_answer(self, answer: Future) -> None:
        response: Any = answer.result()
        if answer is not self._asked or self._class is None:
            return
        if self._due > 0.0:  # else a parameter has changed meanwhile
            self._due = math.inf
        values = [parameter_value_to_python(value) for value in response.values]
        try:
            found = build(self._class, dict(zip(self._names, values, strict=True)))
        except (InvalidProblem, ValueError) as error:
            self._node.get_logger().warning(f'parameters of {self._name} cannot be read: {error}')
        else:
            self.parameters = found


class Recovery:
    """
    Finds the plan that the trackers follow when the planner starts; to be looked at repeatedly.

    `trackers` are by vehicle. Where they tell of different starts, their trajectories are not
    parts of one plan.
    """

    def __init__(self, node: Node, kind: PlantKind, trackers: Mapping[str, TrackerWatch]) -> None:
        self._kind, self._trackers = kind, trackers
        self._until = self._window = time.monotonic() + WINDOW
        self._by_vehicle: dict[str, JointTrajectory] = {}  # empty: it follows none
        self._waits = False  # for the planner to be ready
        for name, tracker in trackers.items():
            take = partial(self._by_vehicle.__setitem__, name)
            node.create_subscription(JointTrajectory, f'{tracker.prefix}{FOLLOWED}', take, LATCHED)

    @property
    def due(self) -> bool:
        """Whether a tracker has yet to say what it follows, or that it does. Any thread."""
        now, told = time.monotonic(), self._by_vehicle.copy()
        silent = (t.has_plan is not False for n, t in self._trackers.items() if n not in told)
        unsaid = (self._trackers[n].has_plan is None for n, plan in told.items() if plan.points)
        return (now < self._until and any(silent)) or (now < self._window and any(unsaid))

    def end(self) -> None:
        """Look for no plan any more: the planner has one."""
        self._waits, self._until = False, -math.inf

    def look(self, ready: bool) -> tuple[dict[str, Trajectory], int] | None:
        """Return trajectories by vehicle and their start [ns], once there are any and `ready`."""
        told = self._by_vehicle
        starts = {nanoseconds_of(p.header.stamp) if p.points else 0 for p in told.values()}
        start = starts.pop() if len(told) == len(self._trackers) and len(starts) == 1 else 0
        self._waits |= bool(start) and time.monotonic() < self._until
        if self._waits and ready:
            self.end()
            if start:
                with suppress(InvalidProblem):
                    return {n: read_plan(self._kind, told[n]) for n in self._trackers}, start
        return None
