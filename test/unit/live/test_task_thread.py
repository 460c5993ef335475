# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The task thread: one task at a time, and of a kind only the newest."""

from __future__ import annotations

from collections.abc import Iterator
import threading

import pytest
from tdm_planner.exceptions import Infeasible
from tdm_sim.live.task_thread import LONGEST, SHORTEST, start_delay, TaskThread

PATIENCE = 30.0  # s


@pytest.fixture
def tasks() -> Iterator[TaskThread]:
    made = TaskThread()
    yield made
    made.close()


def test_a_newer_task_supersedes_one_that_waits(tasks: TaskThread) -> None:
    begun, go_on, done = threading.Event(), threading.Event(), threading.Event()
    outcomes: list[str] = []

    def first() -> str:
        begun.set()
        go_on.wait(PATIENCE)
        return 'first'

    tasks.submit('drag', first, outcomes.append)
    assert begun.wait(PATIENCE)
    for number in range(5):
        tasks.submit('drag', lambda number=number: f'drag {number}', outcomes.append)
    tasks.submit('push', lambda: 'push', outcomes.append)
    tasks.submit('last', lambda: '', lambda _: done.set())
    go_on.set()
    assert done.wait(PATIENCE)
    assert outcomes == ['first', 'drag 4', 'push']


@pytest.mark.parametrize(
    ('error', 'told'),
    [
        (Infeasible('the goal is outside the arena'), 'INFEASIBLE: the goal is outside the arena'),
        (KeyError('x'), "INTERNAL: KeyError: 'x'"),
    ],
)
def test_what_cannot_be_done_is_told_and_the_next_is_done(
    tasks: TaskThread, error: Exception, told: str
) -> None:
    texts: list[str] = []
    done = threading.Event()

    def fail() -> str:
        raise error

    tasks.submit('drag', fail, texts.append)
    tasks.submit('next', lambda: 'done', lambda text: (texts.append(text), done.set()))
    assert done.wait(PATIENCE)
    assert texts == [told, 'done']


def test_a_motion_starts_as_soon_as_solving_allows() -> None:
    delays = [start_delay(solve_time) for solve_time in (0.0, 0.02, 0.2, 0.4, 5.0)]
    assert delays == sorted(delays)
    assert (delays[0], delays[-1]) == (SHORTEST, LONGEST)
    assert delays[2] > 2 * 0.2
