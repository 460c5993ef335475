# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The two halves of a robot's measured state: odom and joint_states."""

from __future__ import annotations

from nav_msgs.msg import Odometry
import pytest
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.robot_messages import ROBOT_JOINTS
from tdm_planner.nodes.tracked_plants import TrackedRobot

NOW = 1_700_000_000_000_000_000  # ns
TIMEOUT = 0.1  # s


class Halves:
    """A robot whose messages come at instants of a clock that is set by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.steady = 50.0
        monkeypatch.setattr('time.monotonic', lambda: self.steady)
        self.robot = TrackedRobot()

    def joints(self, stamp: int) -> None:
        message = JointState(name=ROBOT_JOINTS, position=[0.3, 0.0], velocity=[0.0, 0.0])
        message.header.stamp = to_stamp(stamp)
        self.robot.take_joints(message)

    def state(self, stamp: int) -> bool:
        message = Odometry()
        message.header.stamp = to_stamp(stamp)
        message.pose.pose.orientation.w = 1.0
        state = self.robot.state(message, TIMEOUT)
        return state is not None and state[-1] == 0.3


@pytest.fixture
def halves(monkeypatch: pytest.MonkeyPatch) -> Halves:
    return Halves(monkeypatch)


def test_without_joints_there_is_no_state(halves: Halves) -> None:
    assert not halves.state(NOW)


@pytest.mark.parametrize('late', [-99_000_000, 0, 99_000_000])
def test_stamps_may_differ_by_the_timeout(halves: Halves, late: int) -> None:
    halves.joints(NOW)
    halves.steady += 3600.0  # by what clock it came is no matter
    assert halves.state(NOW + late)


@pytest.mark.parametrize('late', [-101_000_000, 101_000_000])
def test_joints_that_have_ceased_are_noticed(halves: Halves, late: int) -> None:
    halves.joints(NOW)
    with pytest.raises(InvalidProblem, match=r'0\.101 s apart, more than state_timeout = 0\.1 s'):
        halves.state(NOW + late)


@pytest.mark.parametrize('stamps', [(0, 0), (NOW, 0), (0, NOW)])
def test_so_they_are_without_stamps(halves: Halves, stamps: tuple[int, int]) -> None:
    halves.joints(stamps[0])
    halves.steady += 0.09
    assert halves.state(stamps[1])
    halves.steady += 0.02
    with pytest.raises(InvalidProblem, match='state_timeout'):
        halves.state(stamps[1])
