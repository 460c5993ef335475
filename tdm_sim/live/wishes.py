# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Wishes of those who look at the page, carried out one at a time: the newest of a kind counts."""

from __future__ import annotations

from collections.abc import Callable
import threading

from tdm_planner.exceptions import TdmError

Act = Callable[[], str]
Told = Callable[[str], None]


class Wishes:
    """
    Carries out what is wished in a thread of its own.

    A wish waits while another is being carried out; a newer one of its kind takes its place. So
    whoever drags has as many plans as solving allows, and the last of them is of where he let go.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[Act, Told]] = {}
        self._news = threading.Condition()
        self._ended = False
        self._busy = False
        self._thread = threading.Thread(target=self._run, name='wishes', daemon=True)
        self._thread.start()

    def wish(self, kind: str, act: Act, told: Told) -> None:
        """
        Have `act()` done, then `told(text)` with what it returns, or with why it could not be.

        A wish that is superseded by a newer one of its kind before its turn is told nothing.
        """
        with self._news:
            self._waiting[kind] = act, told
            self._news.notify()

    @property
    def idle(self) -> bool:
        """Whether everything wished has been done."""
        with self._news:
            return not self._waiting and not self._busy

    def close(self) -> None:
        """Drop what waits; what is being done ends by itself."""
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
