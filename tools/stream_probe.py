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

"""
Write down when messages were stamped and when they came; a node in a process of its own.

    python -m tools.stream_probe [--all] FILE TOPIC=TYPE...

TYPE is JointState or Odometry. On SIGINT, FILE (.npz) gets, by topic, the stamps [s] with the
instants of arrival [s], (n, 2), and for JointState the positions, under `TOPIC positions`. With
--all every message sent is waited for; without it, those are missed that the nodes would miss.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
import signal
import sys
import time
from types import FrameType
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import seconds_of
from tdm_planner.nodes.qos import NEWEST
from tdm_planner.nodes.runtime import make_executor

_EVERYTHING = 1000  # messages that may wait, reliable
TYPES = {'JointState': JointState, 'Odometry': Odometry}


class StreamProbe:
    """Listens to topics with a quality of service."""

    def __init__(self, topics: dict[str, Any], quality: QoSProfile | int) -> None:
        self._heard: dict[str, list[tuple[float, float]]] = {name: [] for name in topics}
        self._positions: dict[str, list[list[float]]] = {name: [] for name in topics}
        self.node = rclpy.create_node('stream_probe')
        for name, message_type in topics.items():
            self.node.create_subscription(message_type, name, partial(self._hear, name), quality)

    def _hear(self, name: str, message: Any) -> None:
        self._heard[name].append((seconds_of(message.header.stamp), time.time()))
        if isinstance(message, JointState):
            self._positions[name].append(list(message.position))

    def save(self, path: Path) -> None:
        """Write everything heard."""
        arrays: dict[str, Any] = {
            name: np.array(rows).reshape(-1, 2) for name, rows in self._heard.items()
        }
        for name, rows in self._positions.items():
            if rows and rows[0]:
                arrays[f'{name} positions'] = np.array(rows)
        np.savez(path, **arrays)


def main() -> int:
    """Listen until SIGINT, then write."""
    words = [word for word in sys.argv[1:] if word != '--all']
    path = Path(words[0])
    topics = {name: TYPES[kind] for name, _, kind in (a.partition('=') for a in words[1:])}
    ended = False

    def end(_: int, __: FrameType | None) -> None:
        nonlocal ended
        ended = True

    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    probe = StreamProbe(topics, _EVERYTHING if '--all' in sys.argv else NEWEST)
    executor = make_executor()
    executor.add_node(probe.node)
    while not ended:
        executor.spin_once(timeout_sec=0.1)
    probe.save(path)
    return 0


if __name__ == '__main__':
    sys.exit(main())
