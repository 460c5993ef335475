# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where a plant will be when the next plan takes over, against its motion under the old plan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tdm_planner.nodes.planned_plants import PlannedRobots
from tdm_planner.nodes.vehicle import ActivePlans, Vehicle
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.problems import RobotFormation
from tdm_planner.trajectory import TimedTrajectory
from tdm_planner.verification import replay

START = 1_700.0


@pytest.fixture(scope='module')
def plan():
    solution = RobotFormation().solve(deadline=10.0)
    plant = FloatingRobot()
    return TimedTrajectory(solution.trajectories['robot1'].with_rates(plant.derivative), START)


class Robot(Vehicle):
    """A robot that follows a plan, measured in a state at an instant."""

    def __init__(self, plan: TimedTrajectory | None, state: Any, measured: float) -> None:
        self._plant = PlannedRobots(RobotFormation, {})
        self._angles = np.isin(np.arange(7), (4, 6))
        self.fresh = lambda *_: (state, measured)  # type: ignore[method-assign]
        self.followed = lambda _: plan  # type: ignore[method-assign]


def predict(plan, state, measured, start):
    return Robot(plan, state, measured).predicted({'start.max_age': 1.0}, measured, start)


@pytest.mark.parametrize('at', [0.2, 1.3, 3.3])
def test_a_robot_that_follows_its_plan_is_met_on_it(plan, at):
    """Under full thrust drifting alone would miss by ten centimetres."""
    times = np.array([at, at + 1.0])
    before, after = replay(FloatingRobot(), plan.trajectory, times)
    measured = START + at
    predicted = predict(plan, before, measured, measured + 1.0)
    np.testing.assert_allclose(predicted[:6], after[:6], atol=1e-3)


def test_a_small_deviation_is_carried_along(plan):
    measured = START + 2.0
    state = plan.reference(measured) + np.array([0.02, 0, 0, 0.01, 0, 0, 0])
    away = predict(plan, state, measured, measured + 1.0) - plan.reference(measured + 1.0)
    np.testing.assert_allclose(away[:4], [0.02, 0.01, 0.0, 0.01], atol=1e-9)


def test_a_robot_that_does_not_follow_drifts(plan):
    state = np.array([1.0, 1.0, 0.1, 0.0, 0.0, 0.2, 0.5])
    for force in (plan, None):
        predicted = predict(force, state, START + 9.0, START + 10.0)
        np.testing.assert_allclose(predicted, [1.1, 1.0, 0.1, 0.0, 0.2, 0.2, 0.5], atol=1e-12)


def test_after_its_end_the_plan_stays_at_the_goal(plan):
    late = START + 100.0
    np.testing.assert_allclose(plan.reference(late), plan.trajectory.states[-1], atol=1e-12)
    early = plan.reference(START - 1.0)
    np.testing.assert_allclose(early, plan.trajectory.states[0], atol=1e-12)


def test_until_a_plan_begins_the_one_before_is_active(plan):
    def begins(start):
        return TimedTrajectory(plan.trajectory, start)

    plans = ActivePlans()
    assert plans.at(9.0) is plans.next_start(9.0) is None
    first, third = begins(10.0), begins(20.0)
    plans.add(first, 9.0)
    assert plans.at(9.0) is None
    assert plans.next_start(9.0) == 10.0
    assert plans.at(11.0) is first
    plans.add(begins(19.0), 18.0)
    assert plans.at(18.0) is first
    plans.add(third, 18.1)
    # The second one never begins.
    assert plans.at(19.0) is first
    assert plans.next_start(19.9) == 20.0
    assert plans.next_start(20.0) is None
    assert plans.at(20.0) is third
    plans.clear()
    assert plans.at(20.0) is None
