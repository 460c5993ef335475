# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults during a mission, in stepped time: some of data, all of which are tried by night."""

from __future__ import annotations

import copy
from typing import Any

from data_faults import FAULTS, misled_rig, QUICK
from pendulum_rig import note, PendulumRig, UPRIGHT
import pytest
from ros_harness import MODULES
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, to_stamp
from trajectory_msgs.msg import JointTrajectory


@pytest.mark.parametrize('fault', QUICK)
def test_a_mission_under_a_fault_of_data(ros: Any, fault: str) -> None:
    note(fault, **FAULTS[fault](misled_rig(ros, fault)))


def test_two_planners_run_by_mistake(ros: Any) -> None:
    """It is told of; of their plans the one that starts last is followed."""
    rig = PendulumRig(ros, 'two')
    began = rig.now
    other = ros.start(MODULES['planner'], rig.parameters('planner'), namespace='two')
    rig.wait(lambda: rig.says('tracker', '2 planners publish /two/trajectory'))
    note('two planners', detected=rig.now - began)
    rig.wait(lambda: rig.says('planner', '2 planners publish /two/plan_summary'))
    rig.wait(lambda: other.output.count('2 planners publish') == 2)  # both have the name
    ros.request('/two/plan', Trigger)
    rig.wait(lambda: other.output.count(': plan 1: ') == 2)
    held = rig.held_since(rig.now)
    followed = rig.followed[-1]
    third = ros.publisher('/two/trajectory', JointTrajectory, LATCHED)
    earlier = copy.deepcopy(followed)
    earlier.header.stamp = to_stamp(nanoseconds_of(followed.header.stamp) - 100_000_000)
    third.publish(earlier)
    rig.wait(lambda: rig.said('tracker', "it starts 0.1 s before the active one; of 3 planners'"))
    assert rig.followed[-1] == followed
    ros.node.destroy_publisher(third)
    other.end()
    rig.wait(lambda: rig.figure('tracker', 'planners') == 1)
    rig.wait(lambda: not rig.says('tracker', 'planners publish'))
    assert rig.lean(held + 0.5) < UPRIGHT
