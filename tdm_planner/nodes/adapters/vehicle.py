# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One plant of a planner: its measured state, its tracker, its plans, its picture."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.adapters.active_plans import ActivePlans
from tdm_planner.nodes.adapters.tracker_watch import TrackerWatch
from tdm_planner.nodes.markers import MARKER_DEPTH, Picture
from tdm_planner.nodes.measured_state import MeasuredState
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import nanoseconds_of, read_joints, read_plan
from tdm_planner.plant_kind import PlantKind
from tdm_planner.replanning import Mode
from tdm_planner.tracking.tracker_parameters import TrackerParameters
from tdm_planner.trajectory import NANOSECOND, Trajectory
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

MARKER_RATE = 20.0  # Hz
OLDEST_SHOWN = 0.5  # s; a state older than that is not drawn any more


class Vehicle:
    """
    The topics of a plant in the namespace `prefix` ('' or 'robot1/') of a planner.

    Where its tracker has parameters of a known class, `tracker` is what it does.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        prefix: str,
        kind: PlantKind,
        tracker: type[TrackerParameters] | None,
        picture: Picture | None = None,
    ) -> None:
        self._node = node
        self.name, self.prefix, self.kind = name, prefix, kind
        self.angles = np.array([state in kind.angles for state in kind.state_names])
        self.plans = ActivePlans()
        self.trajectory = node.create_publisher(JointTrajectory, f'{prefix}trajectory', LATCHED)
        self.tracker = None if tracker is None else TrackerWatch(node, prefix, tracker)
        self.measured = MeasuredState(node, kind, prefix, self._observe)
        self._picture = picture
        if picture is not None:
            self.markers = node.create_publisher(
                MarkerArray, f'{prefix}plant_markers', MARKER_DEPTH
            )
            node.create_timer(1.0 / MARKER_RATE, self._show)

    @property
    def label(self) -> str:
        """Begin of a sentence about one of several plants."""
        return f"robot '{self.name}': " if self.prefix else ''

    def mode(self, now: int) -> Mode:
        """Return what the tracker does at the instant `now` [ns]; an unknown one follows."""
        return Mode.FOLLOWING if self.tracker is None else self.tracker.mode(now)

    def parameter(self, state: str) -> str:
        """Return the name of the parameter with which a state begins."""
        return f'{self.name}.start.{state}' if self.prefix else f'start.{state}'

    def listen(self, found: Callable[[Trajectory | None, int], None]) -> None:
        """Begin to listen to what the tracker says it follows, and since when [ns]."""

        def on_message(message: Any) -> None:
            trajectory = None
            with suppress(InvalidProblem):
                trajectory = read_plan(self.kind, message)
            found(trajectory, nanoseconds_of(message.header.stamp))

        topic = f'{self.prefix}active_trajectory'
        self._node.create_subscription(JointTrajectory, topic, on_message, LATCHED)

    def _observe(self, state: Array, instant: int) -> None:
        if self._picture is not None:
            self._picture.add(instant, state)

    def _show(self) -> None:
        """Draw a plant that does not draw itself, as simulated ones do, while somebody looks."""
        newest, markers = self.measured.newest, self.markers
        now = self._node.get_clock().now()
        if newest is None or markers.get_subscription_count() == 0:
            return
        stale = (now.nanoseconds - newest[1]) * NANOSECOND > OLDEST_SHOWN
        if stale or self._node.count_publishers(markers.topic_name) > 1:
            return
        assert self._picture is not None
        markers.publish(self._picture.draw(now.to_msg(), newest[0], self._applied()))

    def _applied(self) -> Array:
        """Efforts (nu,) that the plant's driver tells; 0 where it does not."""
        told: dict[str, float] = {}
        joints = self.measured.joints.newest
        for joint in self.kind.actuated:
            with suppress(InvalidProblem):
                if joints is not None:
                    told |= read_joints([joint], joints.message, [joint.effort])
        return np.array([told.get(name, 0.0) for name in self.kind.control_names])
