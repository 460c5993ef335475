# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""One plant of a planner: its topics, its measured state, its tracker, its markers, its goal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
import math
import textwrap

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from tdm_planner.exceptions import Failure, InvalidProblem
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.markers import MARKER_DEPTH, Pen, Picture
from tdm_planner.nodes.measured_state import MeasuredState
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import check_frame, read_joints, yaw_of
from tdm_planner.nodes.services import Request
from tdm_planner.nodes.tracker_plans import TrackerWatch
from tdm_planner.problems.formation.parameters import place_in_arena, place_in_formation
from tdm_planner.replanning import ActivePlan, Mode, Observation
from tdm_planner.replanning.planned_plants import PlannedPlant, Values
from tdm_planner.trajectory import TimedTrajectory
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]

_MARKER_RATE = 20.0  # Hz
_OLDEST_SHOWN = 0.5  # s; a state older than that is not drawn any more
_NOTICE_TIME = 8.0  # s that the notice of a rejected goal stays visible
_LETTERS = 0.1  # m
_LINE = 44  # letters


class Vehicle:
    """
    A plant of a planner and its topics; of several plants each has its `prefix`, 'robot1/'.

    A pose on `<robot>/goal_pose`, from RViz or Foxglove, asks for a plan with the robot's place in
    the formation moved there (`formation.<robot>`, which is set if there is a plan). Instants are
    those of `clock` [s].
    """

    def __init__(
        self,
        node: Node,
        clock: MotionClock,
        name: str,
        plant: PlannedPlant,
        values: Values,
        request: Callable[[Request], None],
    ) -> None:
        self._node, self._clock, self._plant, self._request = node, clock, plant, request
        self.name, self.kind = name, plant.kind
        self.prefix = prefix = f'{name}/' if plant.several else ''
        self._angles = np.array([state in self.kind.angles for state in self.kind.state_names])
        self.trajectory = node.create_publisher(JointTrajectory, f'{prefix}trajectory', LATCHED)
        self.path = (
            node.create_publisher(Path, f'{prefix}path', LATCHED) if self.kind.odometry else None
        )
        self.tracker = TrackerWatch(node, clock, prefix, plant.tracker)
        self._picture: Picture | None = None
        self.measured = MeasuredState(node, clock, self.kind, prefix, self._observe)
        self._markers = node.create_publisher(MarkerArray, f'{prefix}plant_markers', MARKER_DEPTH)
        node.create_timer(1.0 / _MARKER_RATE, self._show)
        if f'formation.{name}' in values:
            node.create_subscription(PoseStamped, f'{prefix}goal_pose', self._on_goal, 10)

    def values_changed(self, values: Values) -> None:
        """Draw the plant as the parameters have it, unless they contradict each other."""
        self._values = values
        with suppress(InvalidProblem):
            drawn, name = self._plant.drawn(values), self.name if self.prefix else ''
            if drawn is None:
                return
            if self._picture is None:
                self._picture = Picture(drawn, self._plant.trail, name)
            else:
                self._picture.set_up(drawn, self._plant.trail)

    @property
    def label(self) -> str:
        """Begin of a sentence about one of several plants."""
        return f"robot '{self.name}': " if self.prefix else ''

    def seen(self, now: float, max_age: float) -> Observation:
        """Return the newest state and what the tracker does; NoState as of `fresh`."""
        state, stamp = self.measured.fresh(now, max_age)
        return Observation(state, stamp, self.tracker.mode(now), self.tracker.followed(now))

    def follows(self, plan: ActivePlan, now: float) -> TimedTrajectory | None:
        """Return the motion of the plant by an active plan; None unless it is followed."""
        motion = plan.motion(self.name)
        known = motion.trajectory.state_names == self.kind.state_names
        return motion if known and self.tracker.mode(now) is Mode.FOLLOWING else None

    def predicted(
        self, values: Values, now: float, start: float, plan: ActivePlan | None
    ) -> Array:
        """
        Return the state (nx,) at the instant `start`, measured not long before `now`.

        A plant that follows the active `plan`, within the tracking tolerance, is predicted along
        it, plus the rest of its deviation. Any other plant is predicted without control.

        Raise InvalidProblem or NoState naming what is missing or too old, or why it cannot be
        predicted.
        """
        state, measured = self.measured.fresh(now, values['start.max_age'])
        motion, wait = None if plan is None else self.follows(plan, now), start - measured
        if motion is not None:
            away = state - motion.reference(measured)
            away[self._angles] = np.angle(np.exp(1j * away[self._angles]))
            if (np.abs(away) <= self._plant.tracking_tolerance(motion.trajectory, values)).all():
                return np.asarray(
                    motion.reference(start) + self._plant.remaining_deviation(away, wait)
                )
        return self._plant.coasted(state, wait, values)

    def _observe(self, state: Array, at: float) -> None:
        if self._picture is not None:
            self._picture.add(at, state)

    def _show(self) -> None:
        """Draw a real plant while a viewer subscribes; simulated plants draw themselves."""
        markers, newest = self._markers, self.measured.newest
        if self._picture is None or newest is None or markers.get_subscription_count() == 0:
            return
        old = self._clock.now() - newest[1] > _OLDEST_SHOWN
        if old or self._node.count_publishers(markers.topic_name) > 1:
            return
        now = self._node.get_clock().now().to_msg()
        markers.publish(self._picture.draw(now, newest[0], self._applied()))

    def _applied(self) -> Array:
        """Efforts (nu,) that the plant's driver reports; 0 where it does not."""
        told: dict[str, float] = {}
        for joint in self.kind.actuated:
            with suppress(InvalidProblem):
                told |= read_joints([joint], self.measured.joints, [joint.effort])
        return np.array([told.get(name, 0.0) for name in self.kind.control_names])

    # The goal.

    def _on_goal(self, message: PoseStamped) -> None:
        parameter, anchor = f'formation.{self.name}', self._values['formation.anchor']
        title, at = f"goal_pose of '{self.name}' rejected", message.pose.position
        try:
            check_frame(self.kind, message, 'goal_pose')
            if not (math.isfinite(at.x) and math.isfinite(at.y)):
                raise InvalidProblem(
                    f"the pose's position is ({at.x:g}, {at.y:g}) m: must be finite numbers"
                )
            pose = at.x, at.y, yaw_of(message.pose.orientation)
        except InvalidProblem as error:
            failure = Failure.of(error)
            self._node.get_logger().warning(f'{title}: {failure}')
            place = self._values.get(parameter) or (0.0, 0.0, 0.0)
            self._tell(place_in_arena(anchor, place), failure)
            return
        changes = {parameter: place_in_formation(anchor, pose)}
        self._request(Request(lambda outcome: self._tell(pose, outcome), changes, True, title))

    def _tell(self, pose: Sequence[float], outcome: str | Failure) -> None:
        """Show for some seconds why there is no plan, or remove the text shown before."""
        pen = Pen(self.kind.frame, lifetime=_NOTICE_TIME)
        if isinstance(outcome, Failure):
            text = textwrap.fill(f'{self.name}: {outcome.code}: {outcome.reason}', _LINE)
            marker = pen.text('rejected', text, (pose[0], pose[1], 0.3), _LETTERS)
        else:
            marker = pen.marker('rejected', action=Marker.DELETE)
        self._markers.publish(MarkerArray(markers=[marker]))
