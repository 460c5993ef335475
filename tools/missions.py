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

"""Demo missions, one after the other, with nodes that live on from mission to mission."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json
import time
from types import TracebackType
from typing import Any

import rclpy
from rclpy.context import Context
from std_srvs.srv import Trigger
from tdm_planner.exceptions import NoState
from tdm_planner.nodes.runtime import make_executor
from tdm_sim.demo_scene import Scene
from tdm_sim.processes import NodeProcesses
from tdm_sim.verdict import Verdict

UP_LIMIT = 60.0  # s for every node to be up and connected
ANSWER_LIMIT = 20.0  # s for a service to answer
RETRY = 0.2  # s between requests while states are on their way
QUIET = 0.5  # s after a reset, for the trackers to give up what they held


class MissionFailed(Exception):
    """A mission did not get as far as being judged; says why."""


@dataclass(frozen=True)
class Outcome:
    """One mission: `reasons` why its goal was missed, none if it was reached and held."""

    scene: str
    began: float
    ended: float
    reasons: tuple[str, ...]
    answer: dict[str, Any]
    verdict: Verdict | None = None

    @property
    def reached(self) -> bool:
        """Whether the goal was reached and held within all limits."""
        return not self.reasons

    def to_dict(self) -> dict[str, Any]:
        """Return what is kept of it."""
        return {
            'scene': self.scene,
            'began': self.began,
            'ended': self.ended,
            'reached': self.reached,
            'reasons': list(self.reasons),
            'solve_time': self.answer.get('solve_time'),
            'achieved': {name: figure for name, _, figure in self.verdict.rows if figure}
            if self.verdict
            else {},
        }


class MissionControl:
    """
    Resets plants, asks for plans and judges what follows. A context manager.

    `processes` are watched all along; `each_moment` is called some 20 times a second at least.
    """

    def __init__(
        self,
        scenes: dict[str, Scene],
        processes: NodeProcesses,
        each_moment: Callable[[], None] = lambda: None,
    ) -> None:
        self.scenes = scenes
        self._processes = processes
        self._each_moment = each_moment
        self._context = Context()
        rclpy.init(context=self._context)
        self._executor = make_executor(self._context)
        self._nodes, self._plan, self._reset = {}, {}, {}
        for name, scene in scenes.items():
            node = rclpy.create_node(
                'mission_control', namespace=scene.namespace, context=self._context
            )
            self._nodes[name] = node
            self._plan[name] = node.create_client(Trigger, 'plan')
            self._reset[name] = [
                node.create_client(Trigger, f'{plant}/reset') for plant in scene.plants
            ]
            scene.listen(node)
            self._executor.add_node(node)

    def wait(self, until: Callable[[], bool], limit: float) -> bool:
        """Serve messages until `until()` holds; False when `limit` s have passed."""
        end = time.monotonic() + limit
        next_look = 0.0
        while not until():
            now = time.monotonic()
            if now > end:
                return False
            if now > next_look:
                next_look = now + 0.05
                self._processes.check()
                self._each_moment()
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def wait_for_nodes(self) -> None:
        """
        Wait until everything is up and connected.

        Raises
        ------
        MissionFailed
            Naming what is not.

        """
        for name, scene in self.scenes.items():
            plan, resets = self._plan[name], self._reset[name]

            def up(scene: Scene = scene, plan: Any = plan, resets: Any = resets) -> bool:
                return not scene.missing(plan) and all(c.service_is_ready() for c in resets)

            if not self.wait(up, UP_LIMIT):
                missing = ', '.join(scene.missing(plan)) or 'a service'
                raise MissionFailed(f'not up after {UP_LIMIT:g} s: {missing}')

    def fly(self, name: str) -> Outcome:
        """Carry out one mission of a scene and judge it."""
        began = time.time()
        scene = self.scenes[name]
        verdict: Verdict | None = None
        scene.answer = {}
        try:
            self._put_back(name)
            scene.answered(self._ask(name))
            if not self.wait(lambda: scene.planned, ANSWER_LIMIT):
                raise MissionFailed('the planner answered, but no trajectory was published')
            self.wait(lambda: scene.over, scene.longest)
            verdict = scene.judge()
            reasons = (*verdict.reasons, *filter(None, [verdict.undecided]))
        except MissionFailed as error:
            reasons = (str(error),)
        return Outcome(name, began, time.time(), reasons, scene.answer, verdict)

    def call(self, client: Any) -> Any:
        """Call a service and return its response."""
        future = client.call_async(Trigger.Request())
        if not self.wait(future.done, ANSWER_LIMIT):
            raise MissionFailed(f'{client.srv_name} did not answer within {ANSWER_LIMIT:g} s')
        return future.result()

    def _put_back(self, name: str) -> None:
        for client in self._reset[name]:
            self.call(client)
        self.wait(lambda: False, QUIET)
        self.scenes[name].clear()

    def _ask(self, name: str) -> dict[str, Any]:
        """Request a plan; again where the planner has not heard of every plant yet."""
        end = time.monotonic() + ANSWER_LIMIT
        while True:
            response = self.call(self._plan[name])
            answer: dict[str, Any] = json.loads(response.message)
            if response.success:
                return answer
            if answer['code'] != NoState.code or time.monotonic() > end:
                raise MissionFailed(f'no plan: {answer["code"]}: {answer["reason"]}')
            self.wait(lambda: False, RETRY)

    def __enter__(self) -> MissionControl:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for node in self._nodes.values():
            self._executor.remove_node(node)
            node.destroy_node()
        rclpy.shutdown(context=self._context)
