# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Tasks from the page, run one at a time; a newer task supersedes a waiting one of its kind."""

from __future__ import annotations

from collections.abc import Callable
import threading

from tdm_planner.exceptions import TdmError

Act = Callable[[], str]
Told = Callable[[str], None]


class TaskThread:
    """
    Runs tasks in its own thread, one at a time.

    A waiting task is superseded by a newer one of its kind. A drag so yields as many plans as
    solving allows, and the last one is for the place where the drag ended.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[Act, Told]] = {}
        self._news = threading.Condition()
        self._ended = False
        self._busy = False
        self._thread = threading.Thread(target=self._run, name='live tasks', daemon=True)
        self._thread.start()

    def submit(self, kind: str, act: Act, told: Told) -> None:
        """
        Run `act()`, then call `told(text)` with its result or the reason for its failure.

        `told` is not called for a task that is superseded before its turn.
        """
        with self._news:
            self._waiting[kind] = act, told
            self._news.notify()

    @property
    def idle(self) -> bool:
        """Whether every task has ended."""
        with self._news:
            return not self._waiting and not self._busy

    def close(self) -> None:
        """Drop the waiting tasks; the running one ends by itself."""
        with self._news:
            self._ended = True
            self._waiting.clear()
            self._news.notify()

    def _run(self) -> None:
        while True:
            with self._news:
                self._busy = False
                self._news.wait_for(lambda: self._ended or bool(self._waiting))
                if self._ended:
                    return
                kind = next(iter(self._waiting))
                act, told = self._waiting.pop(kind)
                self._busy = True
            told(_outcome(act))


def _outcome(act: Act) -> str:
    try:
        return act()
    except TdmError as error:
        return f'{error.code}: {error}'
    except Exception as error:  # noqa: B902
        # The page goes on, and shows it.
        return f'INTERNAL: {type(error).__name__}: {error}'


SHORTEST, LONGEST = 0.2, 1.0  # s from a request to the start of the motion


def start_delay(solve_time: float) -> float:
    """
    Return `start.delay` [s] of the next request; the last one took `solve_time` s to solve.

    As short as solving allows: until a plan's motion has begun, the next one is not made.
    """
    return min(max(2.0 * solve_time + 0.1, SHORTEST), LONGEST)
