# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Wishes: one at a time, and of a kind only the newest."""

from __future__ import annotations

from collections.abc import Iterator
import threading

import pytest
from tdm_planner.exceptions import Infeasible
from tdm_sim.live.wishes import LONGEST, SHORTEST, start_delay, Wishes

PATIENCE = 30.0  # s


@pytest.fixture
def wishes() -> Iterator[Wishes]:
    made = Wishes()
    yield made
    made.close()


def test_a_newer_wish_takes_the_place_of_one_that_waits(wishes: Wishes) -> None:
    begun, go_on, done = threading.Event(), threading.Event(), threading.Event()
    carried_out: list[str] = []

    def first() -> str:
        begun.set()
        go_on.wait(PATIENCE)
        return 'first'

    wishes.wish('drag', first, carried_out.append)
    assert begun.wait(PATIENCE)
    for number in range(5):
        wishes.wish('drag', lambda number=number: f'drag {number}', carried_out.append)
    wishes.wish('push', lambda: 'push', carried_out.append)
    wishes.wish('last', lambda: '', lambda _: done.set())
    go_on.set()
    assert done.wait(PATIENCE)
    assert carried_out == ['first', 'drag 4', 'push']


@pytest.mark.parametrize(
    ('error', 'told'),
    [
        (Infeasible('the goal is outside the arena'), 'INFEASIBLE: the goal is outside the arena'),
        (KeyError('x'), "INTERNAL: KeyError: 'x'"),
    ],
)
def test_what_cannot_be_done_is_told_and_the_next_is_done(
    wishes: Wishes, error: Exception, told: str
) -> None:
    texts: list[str] = []
    done = threading.Event()

    def fail() -> str:
        raise error

    wishes.wish('drag', fail, texts.append)
    wishes.wish('next', lambda: 'done', lambda text: (texts.append(text), done.set()))
    assert done.wait(PATIENCE)
    assert texts == [told, 'done']


def test_a_motion_starts_as_soon_as_solving_allows() -> None:
    delays = [start_delay(solve_time) for solve_time in (0.0, 0.02, 0.2, 0.4, 5.0)]
    assert delays == sorted(delays)
    assert (delays[0], delays[-1]) == (SHORTEST, LONGEST)
    assert delays[2] > 2 * 0.2
