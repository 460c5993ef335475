# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math

from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.goal_tool import arena_pose
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation_parameters import place_in_arena, place_in_formation


@given(st.tuples(st.floats(0.5, 3.5), st.floats(2.9, 3.5), st.floats(-3.0, 3.0)))
@settings(max_examples=20)
def test_the_problem_puts_the_goal_where_it_was_wanted(pose: tuple[float, ...]) -> None:
    """The problem's own composition of anchor and place is the reference."""
    anchor = [2.0, 1.0, 0.8]
    place = place_in_formation(anchor, pose)
    problem = RobotFormation.from_parameters(
        {'formation.anchor': anchor, 'formation.robot2': place}
    )
    assert problem.task.goal[1] == pytest.approx(pose[:2])
    for x, y, yaw in ((*pose[:2], problem.task.goal_yaw[1]), place_in_arena(anchor, place)):
        assert (x, y) == pytest.approx(pose[:2], abs=1e-9)
        assert math.remainder(yaw - pose[2], math.tau) == pytest.approx(0.0, abs=1e-9)


def stamped(
    x: float = 1.0, y: float = 2.0, z: float = 0.0, w: float = 1.0, frame: str = 'arena'
) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = x, y
    message.pose.orientation.z, message.pose.orientation.w = z, w
    return message


def test_a_pose_in_the_arena_is_read() -> None:
    assert arena_pose(stamped()) == (1.0, 2.0, 0.0)
    assert arena_pose(stamped(z=math.sin(0.4), w=math.cos(0.4), frame=''))[2] == (
        pytest.approx(0.8)
    )


@pytest.mark.parametrize(
    ('message', 'words'),
    [
        (stamped(frame='map'), ["'map'", "'arena'"]),
        (stamped(x=math.nan), ['nan', 'finite']),
        (stamped(y=math.inf), ['inf', 'finite']),
        (stamped(w=0.0), ['unit quaternion']),
        (stamped(z=2.0), ['unit quaternion']),
        (stamped(w=math.nan), ['unit quaternion']),
    ],
)
def test_other_poses_are_refused_in_one_sentence(message: PoseStamped, words: list[str]) -> None:
    with pytest.raises(InvalidProblem) as caught:
        arena_pose(message)
    assert all(word in str(caught.value) for word in words)
