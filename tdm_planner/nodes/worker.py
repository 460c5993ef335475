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

"""Long computations beside the executor: one at a time, the outcome delivered in its thread."""

from __future__ import annotations

from collections.abc import Callable
import threading
import time
from typing import Any

from rclpy.node import Node

_EXECUTOR_POLL = 0.01  # s, while the node is not served yet


class Worker:
    """
    Runs `job()` in a daemon thread and hands what it returns to `done` in the node's executor.

    A job must not raise. A daemon, because a computation under way must not keep the process
    from ending. The compiled kernels release the interpreter's lock, so the executor goes on.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._busy = False

    @property
    def busy(self) -> bool:
        """Whether a job runs whose outcome has not been delivered."""
        return self._busy

    def submit(self, job: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Start a job; there must be none under way. To be called in the executor's thread."""
        assert not self._busy
        self._busy = True
        threading.Thread(
            target=self._run, args=(job, done), name='tdm_planner worker', daemon=True
        ).start()

    def _run(self, job: Callable[[], Any], done: Callable[[Any], None]) -> None:
        outcome = job()
        # A job of the node's constructor may end before the node has an executor.
        while (executor := self._node.executor) is None:
            time.sleep(_EXECUTOR_POLL)
        executor.create_task(self._deliver, done, outcome)

    def _deliver(self, done: Callable[[Any], None], outcome: Any) -> None:
        self._busy = False
        done(outcome)
