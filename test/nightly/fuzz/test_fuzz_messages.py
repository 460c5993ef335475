# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Messages with anything in them, without the network: read, or refused in one sentence."""

from __future__ import annotations

from typing import Any

from fuzz_corpus import corpus
from fuzz_judges import outcome
from fuzz_messages import plain
from fuzz_profiles import cases
from fuzz_strategies import goal_poses, joint_states, joint_trajectories, odometries, robot_plans
from fuzz_trackers import histories, live_through, read_plan, read_state
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.trajectory import Trajectory


@cases(40)
@given(
    st.one_of(
        st.tuples(st.just('pendulum'), joint_states()),
        st.tuples(st.just('robot'), st.tuples(odometries, joint_states())),
    )
)
def test_a_state_is_read_or_refused(case: Any) -> None:
    found = outcome(lambda: read_state(*case), case)
    assert isinstance(found, InvalidProblem) or np.isfinite(found).all()


@cases(40)
@given(
    st.one_of(
        st.tuples(st.just('pendulum'), joint_trajectories()),
        st.tuples(st.just('robot'), robot_plans()),
    )
)
def test_a_plan_is_read_or_refused(case: Any) -> None:
    found = outcome(lambda: read_plan(*case), case)
    assert isinstance(found, (InvalidProblem, Trajectory))


@cases(10)
@given(goal_poses)
def test_a_goal_is_read_or_refused(case: Any) -> None:
    pytest.importorskip('rclpy')
    from tdm_planner.nodes.adapters.goal_tool import arena_pose

    found = outcome(lambda: arena_pose(plain(case)), case)
    assert isinstance(found, InvalidProblem) or np.isfinite(found).all()


@pytest.mark.parametrize('plant', ['pendulum', 'robot'])
def test_a_tracker_survives_whatever_it_meets(plant: str) -> None:
    @cases(40)
    @given(histories(plant))
    def survives(history: dict[str, Any]) -> None:
        outcome(lambda: live_through(history), history)

    survives()


@pytest.mark.parametrize('history', corpus('trackers'))
def test_what_once_escaped_does_so_no_more(history: dict[str, Any]) -> None:
    outcome(lambda: live_through(history), history)
