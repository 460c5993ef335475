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

"""What a tracker is doing, read from the messages that it publishes anyway."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import joint_motion, nanoseconds_of
from tdm_planner.replanning import Mode

_SILENCE = 200_000_000  # ns without a command after which nothing is commanded
_MISSED = 50_000_000  # ns by which the newest tracking_error may lag behind the newest command


class CommandWatch:
    """
    Listens to `joint_command` and `tracking_error` in the namespace `prefix` ('' or 'robot1/').

    A tracker publishes its tracking error with every command that follows a plan, and only then.
    """

    def __init__(self, node: Node, prefix: str = '') -> None:
        self._node = node
        self._command: JointState | None = None
        self._error: JointState | None = None
        self._subscriptions = [
            node.create_subscription(
                JointState, f'{prefix}joint_command', self._on_command, qos_profile_sensor_data
            ),
            node.create_subscription(
                JointState, f'{prefix}tracking_error', self._on_error, qos_profile_sensor_data
            ),
        ]

    def close(self) -> None:
        """Cease to listen."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def mode(self, now: int) -> Mode:
        """
        Return what the tracker does at the instant `now` [ns].

        Where no tracker of this package has ever been heard, another controller is taken to follow
        the plan.
        """
        command = self._command
        if command is None:
            return Mode.FOLLOWING
        sent = nanoseconds_of(command.header.stamp)
        if now - sent > _SILENCE:
            return Mode.IDLE
        if self._error is not None and nanoseconds_of(self._error.header.stamp) > sent - _MISSED:
            return Mode.FOLLOWING
        acting = any(value != 0.0 for value in chain(command.effort, command.velocity))
        return Mode.RECOVERING if acting else Mode.IDLE

    def error(self, instant: int, names: Sequence[str]) -> NDArray[np.float64] | None:
        """
        Return what the tracker told of its deviation at about an instant [ns].

        Those of the positions called `names`, then of their rates; None if none was told.
        """
        error = self._error
        if error is None or abs(nanoseconds_of(error.header.stamp) - instant) > _MISSED:
            return None
        try:
            return joint_motion(error, names)
        except InvalidProblem:  # of another controller
            return None

    def _on_command(self, message: JointState) -> None:
        self._command = message

    def _on_error(self, message: JointState) -> None:
        self._error = message
