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

"""A plant's measured state from the topics it comes on, put together by their stamps."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import nanoseconds_of
from tdm_planner.nodes.qos import NEWEST
from tdm_planner.nodes.reading import read_state
from tdm_planner.plant_kind import PlantKind
from tdm_planner.trajectory import NANOSECOND

Array = NDArray[np.float64]

TakeState = Callable[[Any, Callable[[], Array]], None]  # a stamp, and what reads the state


class StateTopics:
    """
    Hands every state to `take`: with `odom` where the plant has one, else with `joint_states`.

    A state of both is read from the newest joint states; reading raises InvalidProblem where they
    are more than `longest()` [s] apart.
    """

    def __init__(self, kind: PlantKind, longest: Callable[[], float], take: TakeState) -> None:
        self._kind, self._longest, self._take = kind, longest, take
        self._joints: JointState | None = None
        self._joints_came = 0.0  # instant on a steady clock [s]

    def subscribe(self, node: Node) -> None:
        """Begin to listen."""
        node.create_subscription(JointState, 'joint_states', self.on_joints, NEWEST)
        if self._kind.odometry:
            node.create_subscription(Odometry, 'odom', self.on_odometry, NEWEST)

    def on_joints(self, message: JointState) -> None:
        """Take joint states."""
        if self._kind.odometry:
            self._joints, self._joints_came = message, time.monotonic()
        else:
            self._take(message.header.stamp, lambda: read_state(self._kind, message))

    def on_odometry(self, message: Odometry) -> None:
        """Take an odometry; before the first joint states there is nothing to take."""
        joints, came = self._joints, self._joints_came
        if joints is not None:
            self._take(message.header.stamp, lambda: self._both(message, joints, came))

    def _both(self, odometry: Odometry, joints: JointState, came: float) -> Array:
        stamps = [nanoseconds_of(half.header.stamp) for half in (odometry, joints)]
        apart = (
            abs(stamps[0] - stamps[1]) * NANOSECOND
            if all(stamps)
            else time.monotonic() - came  # without stamps, by when it came
        )
        longest = self._longest()
        if apart > longest:
            raise InvalidProblem(
                f'odom and the newest joint_states are {apart:.3g} s apart, more than '
                f'state_timeout = {longest:g} s'
            )
        return read_state(self._kind, joints, odometry)
