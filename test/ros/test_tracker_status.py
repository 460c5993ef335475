# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The status of every plan: what changes is told, what is over is told once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from action_msgs.msg import GoalStatus
from tdm_planner.nodes.messages import nanoseconds_of
from tdm_planner.nodes.tracker_status import goal_id, TrackerStatus
from tdm_planner.tracking.tracker import Phase

NAMES = {
    getattr(GoalStatus, name): name.removeprefix('STATUS_')
    for name in dir(GoalStatus)
    if name.startswith('STATUS_')
}


class Bench:
    """A tracker whose phase and motions the test sets; `told` is what was published."""

    def __init__(self) -> None:
        self.told: list[dict[int, str]] = []
        publisher = SimpleNamespace(publish=self.publish)
        node: Any = SimpleNamespace(create_publisher=lambda *_: publisher)
        self.status = TrackerStatus(node)
        self.plans: dict[int, Any] = {}
        self.status.begin()

    def publish(self, message: Any) -> None:
        for item in message.status_list:
            start = nanoseconds_of(item.goal_info.stamp)
            assert list(item.goal_info.goal_id.uuid) == goal_id(start)
        self.told.append(
            {
                nanoseconds_of(item.goal_info.stamp): NAMES[item.status]
                for item in message.status_list
            }
        )

    def accept(self, start: int) -> None:
        self.plans[start] = object()
        self.status.accepted(self.plans[start], start)

    def tracker(
        self, phase: Phase, current: int | None, following: int | None, unquiet: bool
    ) -> Any:
        current_motion, following_motion = (
            None if start is None else SimpleNamespace(trajectory=self.plans[start])
            for start in (current, following)
        )
        return SimpleNamespace(
            phase=phase, current=current_motion, following=following_motion, unquiet=unquiet
        )

    def tick(
        self,
        phase: Phase,
        current: int | None = None,
        following: int | None = None,
        unquiet: bool = False,
    ) -> dict[int, str]:
        """Return what is told last once the tracker has come into a phase."""
        self.status.update(self.tracker(phase, current, following, unquiet))
        return self.told[-1]


def test_a_plan_from_its_acceptance_to_its_end() -> None:
    bench = Bench()
    assert bench.told == [{}]
    bench.accept(5)
    assert bench.tick(Phase.WAITING, 5) == {5: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 5) == {5: 'EXECUTING'}
    bench.tick(Phase.TRACKING, 5)
    assert bench.tick(Phase.HOLDING, 5) == {5: 'SUCCEEDED'}
    bench.tick(Phase.HOLDING, 5)
    assert len(bench.told) == 4  # changes only
    assert bench.tick(Phase.STOPPED) == {5: 'ABORTED'}
    bench.accept(7)
    assert bench.tick(Phase.WAITING, 7) == {5: 'ABORTED', 7: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 7) == {7: 'EXECUTING'}


def test_a_plan_that_is_superseded_is_canceled() -> None:
    bench = Bench()
    bench.accept(5)
    bench.tick(Phase.TRACKING, 5)
    bench.accept(8)
    assert bench.tick(Phase.TRACKING, 5, 8) == {5: 'EXECUTING', 8: 'ACCEPTED'}
    bench.accept(9)
    told = bench.tick(Phase.TRACKING, 5, 9)
    assert told == {5: 'EXECUTING', 8: 'CANCELED', 9: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 9) == {5: 'CANCELED', 9: 'EXECUTING'}
    bench.status.cancel()
    assert bench.told[-1] == {9: 'CANCELED'}


def test_a_goal_held_that_a_plan_follows_stays_succeeded() -> None:
    bench = Bench()
    bench.accept(5)
    bench.tick(Phase.HOLDING, 5)
    bench.accept(8)
    bench.tick(Phase.HOLDING, 5, 8)
    assert bench.tick(Phase.TRACKING, 8) == {5: 'SUCCEEDED', 8: 'EXECUTING'}
    assert bench.tick(Phase.STOPPED) == {8: 'ABORTED'}


def test_a_plan_that_is_rejected_is_aborted_and_the_one_before_goes_on() -> None:
    bench = Bench()
    bench.accept(5)
    bench.tick(Phase.HOLDING, 5)
    bench.status.rejected(8, bench.tracker(Phase.HOLDING, 5, None, False))
    assert bench.tick(Phase.HOLDING, 5) == {5: 'SUCCEEDED', 8: 'ABORTED'}
    bench.accept(9)
    bench.tick(Phase.HOLDING, 5, 9)
    # Refused when it was to begin.
    assert bench.tick(Phase.HOLDING, 5) == {5: 'SUCCEEDED', 9: 'ABORTED'}
    assert bench.tick(Phase.STOPPED) == {5: 'ABORTED'}


def test_a_motion_given_up_is_canceling_until_the_plant_is_at_rest() -> None:
    bench = Bench()
    bench.accept(5)
    bench.tick(Phase.TRACKING, 5)
    assert bench.tick(Phase.RECOVERING, unquiet=True) == {5: 'CANCELING'}
    bench.accept(8)
    told = bench.tick(Phase.WAITING, 8, unquiet=True)
    assert told == {5: 'CANCELING', 8: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 8) == {5: 'ABORTED', 8: 'EXECUTING'}
    assert bench.tick(Phase.RECOVERING, unquiet=True) == {8: 'CANCELING'}
    assert bench.tick(Phase.RECOVERING) == {8: 'ABORTED'}


def test_a_tracker_that_was_restarted_recovers_from_a_plan_that_it_missed() -> None:
    bench = Bench()
    bench.status.rejected(5, bench.tracker(Phase.RECOVERING, None, None, True))
    assert bench.tick(Phase.RECOVERING, unquiet=True) == {5: 'CANCELING'}
    assert bench.tick(Phase.RECOVERING) == {5: 'ABORTED'}


def test_a_tracker_that_is_deactivated_cancels_what_it_has_given_up_as_well() -> None:
    bench = Bench()
    bench.accept(5)
    bench.tick(Phase.TRACKING, 5)
    assert bench.tick(Phase.STOPPED) == {5: 'ABORTED'}
    bench.status.cancel()
    assert bench.told[-1] == {5: 'CANCELED'}
