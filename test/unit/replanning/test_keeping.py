# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plans that trackers refuse are found out: the one that is followed is reviewed."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.problems.swing_up_task import VEHICLE
from tdm_planner.replanning import (
    FormationExecution,
    Mode,
    Observation,
    PlanInForce,
    Replanner,
    SwingUpExecution,
)
from tdm_planner.tracking import PendulumTracker, PendulumTrackerParameters, Phase
from tdm_sim.receding import RecedingHorizon, Vehicle
from tdm_sim.simulation import PlantSetup, SimulatedPlant

LIMIT, INTERVAL = 0.02, 0.005
SWING = build(PendulumSwingUp, {'limits.torque': LIMIT})
PARAMETERS = ReplanParameters(rate=5.0, delay=0.4)


@pytest.fixture(scope='module')
def swing() -> PlanInForce:
    return PlanInForce(SWING, SWING.solve(deadline=10.0), start=0.0)


@pytest.fixture(scope='module')
def crossing() -> PlanInForce:
    problem = RobotFormation()
    return PlanInForce(problem, problem.solve(deadline=10.0), start=0.0)


def following(plan: PlanInForce, at: float) -> Observation:
    """Return what is seen of a pendulum whose tracker says that it follows `plan`."""
    reference = plan.solution.trajectory.sample(plan.elapsed(at)).state
    return Observation(reference, at, Mode.FOLLOWING, plan.start)


def test_the_plan_that_is_followed_is_the_one_that_the_tracker_names(swing: PlanInForce) -> None:
    execution, later = SwingUpExecution(SWING), replace(swing, start=0.5)
    for followed, kept in ((swing, [VEHICLE]), (later, [])):
        seen = {VEHICLE: following(followed, 0.9)}
        assert execution.keeping(swing, later, seen) == kept


def test_what_is_not_told_is_taken_to_be_followed(swing: PlanInForce) -> None:
    execution, later = SwingUpExecution(SWING), replace(swing, start=0.5)
    seen = following(swing, 0.9)
    assert not execution.keeping(swing, later, {VEHICLE: replace(seen, followed=None)})


def test_a_plan_that_has_just_begun_is_not_yet_taken_for_refused(swing: PlanInForce) -> None:
    replanner = Replanner(SwingUpExecution(SWING), PARAMETERS)
    replanner.adopt(swing)
    later = replace(swing, start=0.5)
    replanner.adopt(later)
    review = replanner.review(SWING, {VEHICLE: following(swing, 0.51)}, 0.52)
    assert (review.plan, review.refused, replanner.plan) == (None, (), later)


def test_the_robots_that_keep_their_plan_are_named_and_it_is_mended(crossing: PlanInForce) -> None:
    problem = crossing.problem
    assert isinstance(problem, RobotFormation)
    later, at = replace(crossing, start=3.0), 8.0
    plans = {'robot1': crossing, 'robot2': later, 'robot3': later}
    seen = {}
    for name, plan in plans.items():
        state = plan.solution.trajectories[name].sample(plan.elapsed(at)).state
        seen[name] = Observation(state, at, Mode.FOLLOWING, plan.start)
    replanner = Replanner(FormationExecution(problem), ReplanParameters(rate=5.0, delay=3.0))
    replanner.adopt(crossing)
    replanner.adopt(later)
    review = replanner.review(problem, seen, at)
    assert review.refused == ('robot1',)
    assert review.necessary
    assert 'robot1' in review.outlook.trouble
    assert replanner.plan is later


def test_a_plan_that_all_refuse_is_forgotten(swing: PlanInForce) -> None:
    later = replace(swing, start=0.5)
    replanner = Replanner(SwingUpExecution(SWING), PARAMETERS)
    replanner.adopt(swing)
    replanner.adopt(later)
    seen = {VEHICLE: following(swing, 0.9)}
    review = replanner.review(SWING, seen, 0.9)
    assert review.refused == (VEHICLE,)
    assert replanner.plan is swing
    assert replanner.history == (swing,)
    assert not review.necessary
    assert not replanner.review(SWING, seen, 0.9).refused


def test_in_closed_loop_the_next_review_but_one_mends_a_refusal(swing: PlanInForce) -> None:
    setup = PlantSetup(
        SWING.plant, swing.solution.trajectory.states[0], np.array([-LIMIT]), np.array([LIMIT]),
        np.zeros(4),
    )  # fmt: skip
    tracker = PendulumTracker(build(PendulumTrackerParameters, {'limits.torque': LIMIT}))
    vehicles = {VEHICLE: Vehicle(tracker, SimulatedPlant(setup))}
    replanner = Replanner(SwingUpExecution(SWING), PARAMETERS)
    loop = RecedingHorizon(vehicles, SWING, INTERVAL, replanner)
    loop.begin(swing)
    usual = tracker.parameters
    strict = replace(usual, tolerance=replace(usual.tolerance, start=1e-9))
    turns = round(swing.solution.trajectory.states[-1, 0] / math.tau)
    loop.problem = replace(SWING, goal=replace(SWING.goal, turns=1 - turns))
    tracker.parameters = strict
    while not loop.refusals:
        loop.tick()
        assert loop.time < 3.0
    tracker.parameters = usual
    refused = loop.plans[-1]
    while len(loop.plans) < 3 and loop.time < refused.start + 3.0:
        loop.tick()
    assert any(review.refused for review in loop.reviews)
    # Seen when the plans have parted, at the next review; the new plan follows.
    mended = loop.plans[2]
    assert mended.start < refused.start + 1.0 + 2 / PARAMETERS.rate + PARAMETERS.delay
    while loop.time < mended.end + 1.5:
        loop.tick()
    assert tracker.phase is Phase.HOLDING
    theta = float(vehicles[VEHICLE].plant.state[0])
    assert theta == pytest.approx(math.tau * (1 - turns), abs=0.05)
