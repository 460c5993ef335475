# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A tracker that starts while a plan is in force, and a planner that repeats it."""

from dataclasses import replace
import math

import numpy as np
import pytest
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.tracker import Phase, TrajectoryRefused
from tdm_planner.tracking.tracker_parameters import ReplanOnDeviation

HANGING = np.array([math.pi, 0.0, 0.0, 0.0])


@pytest.fixture(scope='module')
def plan():
    problem = PendulumSwingUp.from_parameters({'limits.torque': 0.09, 'solver.deadline': 30.0})
    return problem.solve().trajectory


def tracker(on_deviation=True):
    made = PendulumTracker(
        PendulumTrackerParameters(replan=ReplanOnDeviation(on_deviation=on_deviation))
    )
    made.prepare_hold()
    made.observe(HANGING, 100.0)
    return made


@pytest.mark.parametrize('since', [0.3, 2.0, 9.0])
def test_what_it_has_missed_is_gone_on_with(plan, since):
    made = tracker()
    with pytest.raises(TrajectoryRefused):
        made.accept(plan, 100.0 - since, 100.0)
    assert made.phase is Phase.RECOVERING
    assert made.command(100.01).phase is Phase.RECOVERING
    assert made.wants_plan


def test_not_unless_it_is_asked_to(plan):
    made = tracker(on_deviation=False)
    with pytest.raises(TrajectoryRefused):
        made.accept(plan, 99.7, 100.0)
    assert made.phase is Phase.IDLE


@pytest.mark.parametrize('ahead', [0.5, 5.0])
def test_a_plan_that_begins_elsewhere_in_the_future_moves_nothing(plan, ahead):
    made = tracker()
    made.observe(HANGING + np.array([0.3, 0.0, 0.0, 0.0]), 100.02)
    before = made.command(100.03).control
    elsewhere = replace(plan, states=plan.states + np.array([1.0, 0.0, 0.0, 0.0]))
    with pytest.raises(TrajectoryRefused):
        made.accept(elsewhere, 100.0 + ahead, 100.04)
    assert made.phase is Phase.IDLE
    assert made.command(100.05).control == before == 0.0


def test_the_plan_of_yesterday_moves_nothing(plan):
    made = tracker()
    with pytest.raises(TrajectoryRefused, match='past'):
        made.accept(plan, 100.0 - 86400.0, 100.0)
    assert made.phase is Phase.IDLE
    assert made.command(100.01).control == 0.0


def test_a_plan_that_is_repeated_is_recognised(plan):
    made = tracker()
    assert not made.follows(plan, 101.0)
    made.accept(plan, 101.0, 100.0)
    repeated = replace(plan, states=plan.states + 1e-13)
    assert made.follows(repeated, 101.0)
    assert not made.follows(repeated, 101.1)
    assert not made.follows(replace(plan, controls=0.5 * plan.controls), 101.0)
    assert made.newest.start == 101.0
