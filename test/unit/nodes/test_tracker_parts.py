# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Parts of the tracker node, each by itself.

The status of every plan: what changes is told, what is over is told once. The two halves of a
robot's measured state.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from action_msgs.msg import GoalStatus
from nav_msgs.msg import Odometry
import pytest
from sensor_msgs.msg import JointState
from tdm_planner.nodes.measured_state import MeasuredState
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.nodes.tracked_plants import tracked_plant
from tdm_planner.nodes.tracker_status import goal_id, TrackerStatus
from tdm_planner.plant_kind import ROBOT
from tdm_planner.tracking import Phase
from trajectory_msgs.msg import JointTrajectory

NOW = 1_700_000_000_000  # ns
TIMEOUT = 0.1  # s
NAMES = {
    getattr(GoalStatus, name): name.removeprefix('STATUS_')
    for name in dir(GoalStatus)
    if name.startswith('STATUS_')
}


class Bench:
    """A tracker whose phase and motions the test sets; `told` is what was published."""

    def __init__(self) -> None:
        self.told: list[dict[int, str]] = []
        self.followed: list[Any] = []
        told = {'tracker_status': self.publish, 'active_trajectory': self.followed.append}
        node: Any = SimpleNamespace(
            create_publisher=lambda _, topic, *__: SimpleNamespace(publish=told[topic])
        )
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
        self.status.accepted(self.plans[start], start, str(start).encode())

    def tracker(
        self, phase: Phase, current: int | None, following: int | None, unquiet: bool
    ) -> Any:
        current_motion, following_motion = (
            None if start is None else SimpleNamespace(trajectory=self.plans[start])
            for start in (current, following)
        )
        return SimpleNamespace(
            phase=phase,
            current=current_motion,
            following=following_motion,
            newest=following_motion or current_motion,
            unquiet=unquiet,
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


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_plan_from_its_acceptance_to_its_end(bench: Bench) -> None:
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


def test_a_plan_that_is_superseded_is_canceled(bench: Bench) -> None:
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


def test_a_goal_held_that_a_plan_follows_stays_succeeded(bench: Bench) -> None:
    bench.accept(5)
    bench.tick(Phase.HOLDING, 5)
    bench.accept(8)
    bench.tick(Phase.HOLDING, 5, 8)
    assert bench.tick(Phase.TRACKING, 8) == {5: 'SUCCEEDED', 8: 'EXECUTING'}
    assert bench.tick(Phase.STOPPED) == {8: 'ABORTED'}
    bench.status.cancel()
    assert bench.told[-1] == {8: 'CANCELED'}
    assert bench.followed == [b'5', b'8', JointTrajectory()]


def test_a_plan_that_is_rejected_is_aborted_and_the_one_before_goes_on(bench: Bench) -> None:
    bench.accept(5)
    bench.tick(Phase.HOLDING, 5)
    bench.status.rejected(8, bench.tracker(Phase.HOLDING, 5, None, False))
    assert bench.tick(Phase.HOLDING, 5) == {5: 'SUCCEEDED', 8: 'ABORTED'}
    bench.accept(9)
    bench.tick(Phase.HOLDING, 5, 9)
    # Refused when it was to begin.
    assert bench.tick(Phase.HOLDING, 5) == {5: 'SUCCEEDED', 9: 'ABORTED'}
    assert bench.tick(Phase.STOPPED) == {5: 'ABORTED'}


def test_a_motion_given_up_is_canceling_until_the_plant_is_at_rest(bench: Bench) -> None:
    bench.accept(5)
    bench.tick(Phase.TRACKING, 5)
    assert bench.tick(Phase.RECOVERING, unquiet=True) == {5: 'CANCELING'}
    bench.accept(8)
    told = bench.tick(Phase.WAITING, 8, unquiet=True)
    assert told == {5: 'CANCELING', 8: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 8) == {5: 'ABORTED', 8: 'EXECUTING'}
    assert bench.tick(Phase.RECOVERING, unquiet=True) == {8: 'CANCELING'}
    assert bench.tick(Phase.RECOVERING) == {8: 'ABORTED'}
    # A tracker that was restarted recovers from a plan that it missed.
    bench.status.rejected(9, bench.tracker(Phase.RECOVERING, None, None, True))
    assert bench.tick(Phase.RECOVERING, unquiet=True)[9] == 'CANCELING'
    assert bench.tick(Phase.RECOVERING)[9] == 'ABORTED'


class Parts:
    """A robot whose odometry and joints come at instants of a clock that is set by hand."""

    def __init__(self) -> None:
        self.now, self.states, self.ignored = NOW, 0, ['']
        callbacks: list[Any] = []
        clock: Any = SimpleNamespace(
            runs=True, instant_of=lambda stamp: (nanoseconds_of(stamp) or self.now) * 1e-9
        )

        def subscribe(_: Any, topic: str, callback: Any, *more: Any) -> SimpleNamespace:
            callbacks.append(callback)
            return SimpleNamespace(topic_name=topic)

        node: Any = SimpleNamespace(create_subscription=subscribe)
        MeasuredState(node, clock, ROBOT, '', self.observe, self.ignored.append, lambda: TIMEOUT)
        self.take_odometry, self.take_joints = callbacks

    def observe(self, state: Any, _: float) -> None:
        self.states += 1
        assert state[-1] == 0.3

    def joints(self, stamp: int) -> None:
        message = JointState(name=['thruster', 'reaction_wheel'], position=[0.3, 0.0])
        message.header.stamp = to_stamp(stamp)
        self.take_joints(message)

    def state(self, stamp: int) -> bool:
        """Whether a state is taken."""
        message = Odometry()
        message.header.stamp = to_stamp(stamp)
        message.pose.pose.orientation.w = 1.0
        before = self.states
        self.take_odometry(message)
        return self.states > before


@pytest.fixture
def parts() -> Parts:
    return Parts()


def test_stamps_may_differ_by_the_timeout(parts: Parts) -> None:
    assert not parts.state(NOW)  # without joints there is none
    assert parts.ignored == ['']
    parts.joints(NOW)
    parts.now += 3600 * 10**9  # by what clock it came is no matter
    for sign in (-1, 1):
        assert parts.state(NOW + sign * 99_000_000)
        assert not parts.state(NOW + sign * 101_000_000)
        assert '0.101 s apart, more than state_timeout = 0.1 s' in parts.ignored[-1]


@pytest.mark.parametrize('stamps', [(0, 0), (NOW, 0), (0, NOW + 90_000_000)])
def test_without_stamps_it_is_when_they_come(parts: Parts, stamps: tuple[int, int]) -> None:
    parts.joints(stamps[0])
    parts.now += 90_000_000
    assert parts.state(stamps[1])
    parts.now += 20_000_000
    assert parts.state(stamps[1] and stamps[1] + 20_000_000) is False


@pytest.mark.parametrize(
    ('name', 'kind'), [('pendulum_swing_up', 'pendulum'), ('robot_formation', 'robot')]
)
def test_a_plant_is_known_by_its_problem_as_well(name: str, kind: str) -> None:
    assert tracked_plant(name) is tracked_plant(kind)
