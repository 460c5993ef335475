# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a planner that has been restarted takes over, and when it does not."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from tdm_planner.nodes import recovery


class Node:
    """Has timers that ring when the test says so."""

    def __init__(self) -> None:
        self.active = False
        self.timers: list[Callable[[], None]] = []

    def create_timer(self, period: float, ring: Callable[[], None]) -> Callable[[], None]:
        self.timers.append(ring)
        return ring

    def destroy_timer(self, timer: Callable[[], None]) -> None:
        self.timers.remove(timer)

    def ring(self) -> None:
        for timer in list(self.timers):
            timer()


class Bench:
    """A planner being restarted; `told` is called with what trackers say."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(recovery, 'time', SimpleNamespace(monotonic=lambda: self.now))
        self.node, self.taken = Node(), []  # type: ignore[var-annotated]
        self.told: Any = None
        node: Any = self.node
        adapter: Any = self
        recovery.Recovery(node, adapter, lambda *found: self.taken.append(found))

    def watch_plans_followed(self, found: Any) -> None:
        self.told = found

    def later(self, seconds: float) -> None:
        self.now += seconds
        self.node.ring()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_what_is_followed_when_it_starts_is_taken_over(bench: Bench) -> None:
    bench.node.active = True
    bench.told({'pendulum': 'plan A'}, 1)
    bench.later(1.0)
    assert bench.taken == [({'pendulum': 'plan A'}, 1)]
    bench.now += recovery.WINDOW
    bench.told({'pendulum': 'plan B'}, 2)
    bench.later(60.0)
    assert len(bench.taken) == 1


def test_what_begins_long_after_it_started_is_not(bench: Bench) -> None:
    bench.node.active = True
    bench.now += recovery.WINDOW + 1.0
    bench.told({'pendulum': 'plan A'}, 1)
    bench.later(60.0)
    assert bench.taken == []


@pytest.mark.parametrize('news', [{}, {'pendulum': 'plan B'}])
def test_what_was_given_up_before_it_was_activated_is_forgotten(bench: Bench, news: Any) -> None:
    bench.told({'pendulum': 'plan A'}, 1)
    bench.later(30.0)
    bench.told(news, 2)
    bench.node.active = True
    bench.later(1.0)
    assert bench.taken == ([(news, 2)] if news else [])
