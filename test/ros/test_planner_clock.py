# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A planner whose computer's clock is set goes on with the plan in force."""

from __future__ import annotations

from collections.abc import Iterator
import math

import pytest
import rclpy
from ros_harness import Ros
from tdm_planner.nodes.planner import Planner
from tdm_planner.nodes.planning import Plan
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.trajectory import NANOSECOND

HOUR = 3600 * 1_000_000_000  # ns


@pytest.fixture
def planner(ros: Ros) -> Iterator[Planner]:
    rclpy.init(args=['--ros-args', '-r', '__ns:=/set'], domain_id=ros.domain)
    node = Planner()
    yield node
    node.destroy_node()
    rclpy.shutdown()


def test_the_plan_goes_on_as_the_plant_does(planner: Planner) -> None:
    problem = PendulumSwingUp.from_parameters({'limits.torque': 0.09})
    now = planner._now()
    planner._publish(Plan(problem, problem.solve(deadline=10.0), now))
    adapter, replanning = planner._adapter, planner._replanning
    assert adapter is not None
    assert replanning is not None
    assert adapter.next_start(now - 1) == now
    seconds = replanning._seconds(now)

    planner._on_clock_step(-HOUR * NANOSECOND)

    assert replanning.plan is planner._plan
    assert replanning.plan is not None
    assert replanning.plan.start == now - HOUR
    assert math.isclose(replanning._seconds(now - HOUR), seconds, abs_tol=1e-6)
    assert adapter.next_start(now - HOUR) is None
    assert adapter.next_start(now - HOUR - 1) == now - HOUR
