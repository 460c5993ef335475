# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the planner knows of a tracker: its mode, its plan, its parameters."""

from __future__ import annotations

from typing import Any

from action_msgs.msg import GoalStatusArray
import pytest
from ros_harness import Ros
from tdm_planner.nodes.adapters.tracker_watch import TrackerWatch
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.tracker_status import goal_status
from tdm_planner.replanning import Mode
from tdm_planner.tracking import PendulumTrackerParameters

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)


class Told:
    """A watch, and a publisher in the tracker's place."""

    def __init__(self, ros: Ros, namespace: str) -> None:
        self.ros, self.count = ros, 0
        self.watch = TrackerWatch(ros.node, f'{namespace}/', PendulumTrackerParameters)
        self.publisher = ros.publisher(f'{namespace}/tracker_status', GoalStatusArray, LATCHED)

    def tell(self, **statuses: int) -> TrackerWatch:
        """Tell the status of plans, by their starts with a letter before."""
        self.count += 1  # a plan that nobody asks for shows that the message has come
        plans = {int(name[1:]): status for name, status in statuses.items()}
        message = GoalStatusArray()
        for start, status in {**plans, 10**9 + self.count: CANCELED}.items():
            message.status_list.append(goal_status(start, status))
        self.publisher.publish(message)
        assert self.ros.spin_until(lambda: 10**9 + self.count in (self.watch._statuses or {}))
        return self.watch


@pytest.fixture(scope='module')
def told(ros: Ros) -> Told:
    return Told(ros, 'told')


def test_where_no_tracker_was_heard_the_plan_is_taken_to_be_followed(told: Told) -> None:
    assert not told.watch.heard
    assert told.watch.mode(7) is Mode.FOLLOWING
    assert told.watch.followed(7) is None
    assert not told.watch.inactive
    assert not told.watch.rejects(5)


def test_a_tracker_that_was_never_activated_is_inactive(ros: Ros) -> None:
    watch = TrackerWatch(ros.node, 'dormant/', PendulumTrackerParameters)
    assert not watch.inactive  # nobody is there: another controller may follow
    ros.start('tdm_planner.nodes.tracker', {'autostart': False}, namespace='dormant')
    assert ros.spin_until(lambda: watch.inactive, 20.0)


@pytest.mark.parametrize(
    ('statuses', 'mode', 'followed', 'inactive'),
    [
        ({'p5': EXECUTING}, Mode.FOLLOWING, 5, False),
        ({'p5': SUCCEEDED}, Mode.FOLLOWING, 5, False),
        ({'p5': ACCEPTED}, Mode.FOLLOWING, 5, False),  # its start has come meanwhile
        ({'p9': ACCEPTED}, Mode.IDLE, None, False),
        ({'p5': EXECUTING, 'p6': ACCEPTED}, Mode.FOLLOWING, 6, False),
        ({'p5': EXECUTING, 'p6': ABORTED}, Mode.FOLLOWING, 5, False),
        ({'p5': CANCELING, 'p9': ACCEPTED}, Mode.RECOVERING, None, False),
        ({'p5': ABORTED}, Mode.IDLE, None, False),
        ({'p5': CANCELED}, Mode.IDLE, None, True),
        ({}, Mode.IDLE, None, True),
    ],
    ids=str,
)
def test_the_mode_is_what_the_tracker_tells(
    told: Told, statuses: dict[str, int], mode: Mode, followed: int | None, inactive: bool
) -> None:
    watch = told.tell(**statuses)
    assert watch.mode(7) is mode
    assert watch.followed(7) == followed
    assert watch.inactive == inactive
    for name, status in statuses.items():
        assert watch.rejects(int(name[1:])) == (status in (ABORTED, CANCELED, CANCELING))
    assert watch.rejects(1234)


def test_a_plan_goes_on_when_the_clock_is_set(told: Told) -> None:
    watch = told.tell(p5=EXECUTING)
    watch.clock_was_set(100)
    assert watch.followed(107) == 105
    assert told.tell(p5=SUCCEEDED, p8=ACCEPTED).followed(107) == 105
    watch.clock_was_set(None)
    assert watch.followed(107) is None


def test_the_parameters_are_those_that_the_tracker_has_at_present(ros: Ros) -> None:
    watch = TrackerWatch(ros.node, 'tuned/', PendulumTrackerParameters)
    values: dict[str, Any] = {'limits.torque': 0.02, 'weights.theta': 5.0}

    def knows(weight: float) -> bool:
        known = watch.parameters
        assert known is None or isinstance(known, PendulumTrackerParameters)
        return known is not None and known.weights.theta == weight

    tracker = ros.start('tdm_planner.nodes.tracker', values, namespace='tuned')
    assert ros.spin_until(lambda: knows(5.0), 30.0)
    assert watch.parameters.limits.torque == 0.02  # type: ignore[union-attr]
    assert ros.set_parameters('/tuned/tracker', weights__theta=7.0) == ['']
    assert ros.spin_until(lambda: knows(7.0), 30.0)
    tracker.end_cleanly()
    values['weights.theta'] = 9.0
    tracker = ros.start('tdm_planner.nodes.tracker', values, namespace='tuned')
    assert ros.spin_until(lambda: knows(9.0), 30.0)
    tracker.end_cleanly()
    assert ros.spin_until(lambda: watch.inactive, 30.0)
