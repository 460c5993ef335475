# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A review that was overtaken while it was under way has no consequences."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from tdm_planner.nodes.replanning import Replanning
from tdm_planner.replanning import Outlook, PlanInForce, Review

SILENT = SimpleNamespace(info=lambda *_, **__: None, warning=lambda *_, **__: None)


class Bench:
    """A planner's reviews, solved when the test says so."""

    def __init__(self) -> None:
        self.published: list[Any] = []
        self.busy = False
        self.done: Callable[[Any], None] | None = None
        clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=10**9))
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
        assert self.done is not None
        self.done(Review(made, 'the problem has changed', Outlook(), True))


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_new_plan_is_published(bench: Bench) -> None:
    bench.finish()
    assert len(bench.published) == 1


def test_not_when_another_planner_has_taken_over(bench: Bench) -> None:
    bench.replanning.plan = None
    bench.finish()
    assert bench.published == []


def test_not_when_the_node_was_deactivated_meanwhile(bench: Bench) -> None:
    bench.replanning.active = False
    bench.replanning.active = True
    bench.finish()
    assert bench.published == []


def test_a_request_that_waits_is_solved_all_the_same(bench: Bench) -> None:
    asked: list[str] = []
    bench.replanning.when_free(lambda: asked.append('request'))
    bench.replanning.plan = None
    bench.finish()
    assert asked == ['request']
