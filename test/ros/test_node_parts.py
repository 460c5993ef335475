# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parts of nodes over DDS: diagnostics, what is known of a tracker, and what rclpy must have."""

from __future__ import annotations

from typing import Any

from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from ros_harness import MODULES
from stepped_ros import Stepped
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.diagnostics import Diagnostics, Level, Report
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.tracker_status import goal_status, TrackerWatch
from tdm_planner.replanning import Mode
from tdm_planner.tracking import PendulumTrackerParameters

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)


# Diagnostics.


def test_diagnostics_are_published_every_second_and_on_change(ros: Stepped) -> None:
    for level in Level:
        assert bytes([level]) == getattr(DiagnosticStatus, level.name)
    reports = [Report(Level.OK, 'fine', {'figure': 1 / 3, 'count': 2})]
    received = ros.subscribe('/diagnostics', DiagnosticArray)
    diagnostics = Diagnostics(ros.node, 'something', lambda: reports[-1])
    ros.spin_for(1.1)
    (array,) = received
    (status,) = array.status
    assert (status.level, status.name, status.message) == (b'\x00', '/test: something', 'fine')
    figures = {item.key: item.value for item in status.values}
    assert figures == {'figure': '0.333333', 'count': '2'}
    assert array.header.stamp.sec > 0
    diagnostics.update()
    ros.spin_for(0.1)
    assert len(received) == 1
    for report in (Report(Level.ERROR, 'fine'), Report(Level.ERROR, 'broken')):
        reports.append(report)
        diagnostics.update()
        ros.settle()
    assert [array.status[0].message for array in received] == ['fine', 'fine', 'broken']
    ros.spin_for(2.0)
    assert len(received) == 5


# What the planner knows of a tracker: its mode, its plan, its parameters.


class Unset(MotionClock):
    """A clock whose instants are nanoseconds, of a time of day that may be set."""

    def __init__(self) -> None:
        """Need no node."""
        self.step = 0

    def instant(self, stamp: int) -> float:
        return float(stamp - self.step)


TOLD: list[tuple[dict[int, int], Mode, int | None, bool]] = [  # what is known of the plan at 7
    ({5: EXECUTING}, Mode.FOLLOWING, 5, False),
    ({5: SUCCEEDED}, Mode.FOLLOWING, 5, False),
    ({5: ACCEPTED}, Mode.FOLLOWING, 5, False),  # its start has come meanwhile
    ({7: ACCEPTED}, Mode.FOLLOWING, 7, False),
    ({9: ACCEPTED}, Mode.IDLE, None, False),
    ({5: EXECUTING, 6: ACCEPTED}, Mode.FOLLOWING, 6, False),
    ({5: EXECUTING, 6: ABORTED}, Mode.FOLLOWING, 5, False),
    ({5: CANCELING, 9: ACCEPTED}, Mode.RECOVERING, None, False),
    ({5: ABORTED}, Mode.IDLE, None, False),
    ({5: CANCELED}, Mode.IDLE, None, True),
    ({}, Mode.IDLE, None, True),
]


def test_the_mode_is_what_the_tracker_tells(ros: Stepped) -> None:
    """By the status of plans, by their starts; where the clock is set a plan goes on."""
    clock = Unset()
    watch = TrackerWatch(ros.node, clock, 'told/', PendulumTrackerParameters)
    publisher = ros.publisher('told/tracker_status', GoalStatusArray, LATCHED)

    def tell(statuses: dict[int, int]) -> None:
        plans = [goal_status(start, status) for start, status in statuses.items()]
        publisher.publish(GoalStatusArray(status_list=plans))
        ros.settle()

    # Where no tracker was heard, the plan is taken to be followed.
    assert not watch.heard
    assert (watch.mode(7), watch.followed(7), watch.inactive) == (Mode.FOLLOWING, None, False)
    assert not watch.rejects(5)
    for statuses, *expected in TOLD:
        tell(statuses)
        assert watch.heard
        assert [watch.mode(7), watch.followed(7), watch.inactive] == expected, statuses
        for start, status in statuses.items():
            assert watch.rejects(start) == (status in (ABORTED, CANCELED, CANCELING))
        assert watch.rejects(1234)
    tell({5: EXECUTING})
    clock.step = 100
    assert watch.followed(7) == 5
    tell({5: SUCCEEDED, 109: ACCEPTED})
    assert watch.followed(7) == 5
    assert watch.followed(9) == 9
    watch.forget_plans()
    assert watch.followed(9) is None


def test_the_parameters_are_those_that_the_tracker_has_at_present(ros: Stepped) -> None:
    watch = TrackerWatch(ros.node, MotionClock(ros.node), 'tuned/', PendulumTrackerParameters)
    values: dict[str, Any] = {'limits.torque': 0.02, 'weights.theta': 5.0}

    def knows(weight: float) -> bool:
        known = watch.parameters
        assert known is None or isinstance(known, PendulumTrackerParameters)
        return known is not None and known.weights.theta == weight

    assert not watch.inactive  # nobody is there: another controller may follow
    tracker = ros.start(MODULES['tracker'], {**values, 'autostart': False}, namespace='tuned')
    assert ros.meet(lambda: watch.inactive)
    tracker.end_cleanly()
    tracker = ros.start(MODULES['tracker'], values, namespace='tuned')
    assert ros.spin_until(lambda: knows(5.0), 5.0)
    assert watch.parameters.limits.torque == 0.02  # type: ignore[union-attr]
    assert ros.set_parameters('/tuned/tracker', weights__theta=7.0) == ['']
    assert ros.spin_until(lambda: knows(7.0), 1.0)
    tracker.end_cleanly()
    tracker = ros.start(MODULES['tracker'], {**values, 'weights.theta': 9.0}, namespace='tuned')
    assert ros.spin_until(lambda: knows(9.0), 5.0)
    tracker.end_cleanly()
    assert ros.meet(lambda: watch.inactive)
