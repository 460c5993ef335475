# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a formation's trackers say they follow is one plan, or none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from stepped_ros import Stepped
from tdm_planner.nodes.adapters.followed_plans import FollowedPlans
from tdm_planner.nodes.messages import LATCHED, to_stamp
from tdm_planner.nodes.robot_messages import robot_controls_message, robot_trajectory_message
from tdm_planner.problems import RobotFormation
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

ROBOTS = ('robot1', 'robot2')


@pytest.fixture(scope='module')
def solution() -> Any:
    places = {'formation.robot1': [0.4, 0.0, 0.0], 'formation.robot2': [-0.4, 0.0, 0.0]}
    problem = RobotFormation.from_parameters({'robots': list(ROBOTS), **places})
    return problem, problem.solve()


def test_a_plan_is_found_when_all_follow_it(ros: Stepped, solution: Any) -> None:
    problem, plan = solution
    found: list[Any] = []
    FollowedPlans(ros.node, ROBOTS, lambda plans, start: found.append((plans, start)))
    publishers = {
        robot: (
            ros.publisher(f'{robot}/trajectory_in_force', MultiDOFJointTrajectory, LATCHED),
            ros.publisher(f'{robot}/controls_in_force', JointTrajectory, LATCHED),
        )
        for robot in ROBOTS
    }

    def follow(robot: str, start: int) -> None:
        trajectory = plan.trajectories[robot].with_rates(problem.plant.derivative)
        motion, controls = publishers[robot]
        motion.publish(robot_trajectory_message(robot, trajectory, to_stamp(start)))
        controls.publish(robot_controls_message(trajectory, problem.plant, to_stamp(start)))

    follow('robot1', 5)
    follow('robot2', 4)
    ros.settle()
    assert not found
    follow('robot2', 5)
    assert ros.spin_until(lambda: bool(found))
    trajectories, start = found[-1]
    assert start == 5
    for robot in ROBOTS:
        planned = plan.trajectories[robot]
        assert np.allclose(trajectories[robot].controls, planned.controls, atol=1e-12)
    assert problem.recognised(trajectories).cost == pytest.approx(plan.cost)
    for motion, controls in publishers.values():
        motion.publish(MultiDOFJointTrajectory())
        controls.publish(JointTrajectory())
    assert ros.spin_until(lambda: not found[-1][0])
