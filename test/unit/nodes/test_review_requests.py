# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reviews and recoveries that something overtakes while they are under way: they are dropped."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from tdm_planner.nodes import recovery
from tdm_planner.nodes.replanning import Replanning
from tdm_planner.replanning import Outlook, PlanInForce, Review

SILENT = SimpleNamespace(info=lambda *_, **__: None, warning=lambda *_, **__: None)


class Reviewed:
    """A planner's review under way, solved when the test says so."""

    def __init__(self) -> None:
        self.published: list[Any] = []
        self.busy, self.now = False, 10**9
        clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now))
        node = SimpleNamespace(get_clock=lambda: clock, get_logger=lambda: SILENT)
        self.replanning = Replanning(node, self, self.published.append)  # type: ignore[arg-type]
        self.replanning.active = True
        self.replanning.plan = SimpleNamespace(start=0)  # type: ignore[assignment]
        self.replanning.adapter = SimpleNamespace(  # type: ignore[assignment]
            replans=True, inactive=[], observations=lambda *_: {}
        )
        self.replanning._on_timer()

    def submit(self, job: Any, done: Callable[[Any], None]) -> None:
        self.done = done

    def finish(self) -> None:
        made = PlanInForce('problem', 'solution', 0.5)  # type: ignore[arg-type]
        self.done(Review(made, 'the problem has changed', Outlook(), True))


@pytest.fixture
def review() -> Reviewed:
    return Reviewed()


def test_a_new_plan_is_published_unless_it_comes_late(review: Reviewed) -> None:
    review.finish()
    assert [plan.start for plan in review.published] == [1_500_000_000]
    review.now += 600_000_000
    review.finish()
    assert len(review.published) == 1
    assert review.replanning.last == 'a new plan came 0.100 s late'


def test_not_when_the_node_was_deactivated_meanwhile(review: Reviewed) -> None:
    review.replanning.active = False
    review.replanning.active = True
    review.finish()
    assert review.published == []


def test_when_another_planner_has_taken_over_only_a_request_that_waits_is_solved(
    review: Reviewed,
) -> None:
    asked: list[str] = []
    assert review.replanning.yields
    review.replanning.when_free(lambda: asked.append('request'))
    assert not review.replanning.yields
    review.replanning.plan = None
    assert asked == []
    review.finish()
    assert review.published == []
    assert asked == ['request']


class Restarted:
    """A planner being restarted; `told` is called with what trackers say, timers ring at will."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.active = 100.0, False
        self.timers: list[Callable[[], None]] = []
        self.taken: list[Any] = []
        monkeypatch.setattr(recovery, 'time', SimpleNamespace(monotonic=lambda: self.now))
        this: Any = self
        recovery.Recovery(this, this, lambda *found: self.taken.append(found))

    def watch_plans_followed(self, found: Any) -> None:
        self.told = found

    def create_timer(self, period: float, ring: Callable[[], None]) -> Callable[[], None]:
        self.timers.append(ring)
        return ring

    def destroy_timer(self, timer: Callable[[], None]) -> None:
        self.timers.remove(timer)

    def later(self, seconds: float) -> None:
        self.now += seconds
        for ring in list(self.timers):
            ring()


@pytest.fixture
def restarted(monkeypatch: pytest.MonkeyPatch) -> Restarted:
    return Restarted(monkeypatch)


def test_what_is_followed_when_it_starts_is_taken_over(restarted: Restarted) -> None:
    restarted.active = True
    restarted.told({'pendulum': 'plan A'}, 1)
    restarted.later(1.0)
    assert restarted.taken == [({'pendulum': 'plan A'}, 1)]
    restarted.now += recovery.WINDOW
    restarted.told({'pendulum': 'plan B'}, 2)
    restarted.later(60.0)
    assert len(restarted.taken) == 1


def test_what_begins_long_after_it_started_is_not(restarted: Restarted) -> None:
    restarted.active = True
    restarted.now += recovery.WINDOW + 1.0
    restarted.told({'pendulum': 'plan A'}, 1)
    restarted.later(60.0)
    assert restarted.taken == []


@pytest.mark.parametrize('news', [{}, {'pendulum': 'plan B'}])
def test_what_was_given_up_before_it_was_activated_is_forgotten(
    restarted: Restarted, news: Any
) -> None:
    restarted.told({'pendulum': 'plan A'}, 1)
    restarted.later(30.0)
    restarted.told(news, 2)
    restarted.active = True
    restarted.later(1.0)
    assert restarted.taken == ([(news, 2)] if news else [])
