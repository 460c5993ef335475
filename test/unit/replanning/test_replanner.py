# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The receding horizon in closed loop, with its latency, on plants that are not the models."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

import numpy as np
import pytest
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.problems.swing_up_task import VEHICLE
from tdm_planner.replanning import Mode, Observation, PlanInForce, Replanner, SwingUpExecution
from tdm_planner.tracking import PendulumTracker, PendulumTrackerParameters, Phase
from tdm_sim.disturbances import pendulum_push
from tdm_sim.mismatch import mismatched
from tdm_sim.receding import RecedingHorizon, Vehicle
from tdm_sim.simulation import PlantSetup, SimulatedPlant

LIMIT, INTERVAL = 0.02, 0.005
PROBLEM = build(PendulumSwingUp, {'limits.torque': LIMIT})
# Generous, so that a busy machine does not decide the outcome.
PARAMETERS = ReplanParameters(rate=5.0, delay=0.4)
NOISE = np.array([0.0015, 0.0015, 0.1, 0.1])


@pytest.fixture(scope='module')
def plan() -> PlanInForce:
    return PlanInForce(PROBLEM, PROBLEM.solve(deadline=10.0), start=0.0)


def closed_loop(
    plan: PlanInForce,
    seed: int = 1,
    replanning: bool = True,
    mismatch: float = 0.05,
    noise: float = 1.0,
    **values: Any,
) -> RecedingHorizon:
    setup = PlantSetup(
        mismatched(PROBLEM.plant, mismatch, seed),
        plan.solution.trajectory.states[0],
        np.array([-LIMIT]),
        np.array([LIMIT]),
        noise * NOISE,
    )
    values = {'limits.torque': LIMIT, 'replan.on_deviation': True, **values}
    tracker = PendulumTracker(build(PendulumTrackerParameters, values))
    replanner = Replanner(SwingUpExecution(PROBLEM), PARAMETERS) if replanning else None
    vehicles = {VEHICLE: Vehicle(tracker, SimulatedPlant(setup, seed))}
    loop = RecedingHorizon(vehicles, PROBLEM, INTERVAL, replanner)
    loop.begin(plan)
    return loop


def run(loop: RecedingHorizon, until: float, push: float = 0.0, at: float = math.inf) -> None:
    plant = loop.vehicles[VEHICLE].plant
    while loop.time < until:
        if loop.time <= at < loop.time + INTERVAL:
            plant.push(lambda x: pendulum_push(PROBLEM.plant, x, push))
        loop.tick()


def upright(loop: RecedingHorizon) -> bool:
    tracker, plant = loop.vehicles[VEHICLE]
    angle = math.remainder(float(plant.state[0]), math.tau)
    return tracker.phase is Phase.HOLDING and abs(angle) < 0.05


def test_undisturbed_the_plan_is_kept_and_no_chatter_near_the_goal(plan: PlanInForce) -> None:
    loop = closed_loop(plan)
    run(loop, 5.0)
    assert upright(loop)
    assert len(loop.plans) == 1
    last = loop.reviews[-5:]
    assert all(review.outlook.settled and review.solve_time == 0.0 for review in last)


@pytest.mark.parametrize('replanning', [True, False])
def test_a_push_that_the_feedback_cannot_mend_is_planned_for(
    plan: PlanInForce, replanning: bool
) -> None:
    loop = closed_loop(plan, seed=3, replanning=replanning)
    run(loop, 9.0, push=-1e-3, at=0.7)
    assert upright(loop) == replanning
    assert (len(loop.plans) > 1) == replanning
    assert len(loop.refusals) <= 1  # made from a state just before the push


def test_only_verified_plans_are_put_in_force_and_they_start_late_enough(
    plan: PlanInForce,
) -> None:
    loop = closed_loop(plan, seed=5)
    run(loop, 3.0, push=-1e-3, at=0.7)
    assert len(loop.plans) > 1
    assert all(made.solution.verification.ok for made in loop.plans)
    starts = [made.start for made in loop.plans]
    # one begins before the next is thought of
    assert min(np.diff(starts)) > PARAMETERS.delay - 1e-9


def test_the_state_goes_on_where_a_plan_takes_over(plan: PlanInForce) -> None:
    # A plant as modelled and measured well, and feedback that does not give up meanwhile.
    options: dict[str, Any] = {'tolerance.path': 3.0}
    loop = closed_loop(plan, seed=5, mismatch=0.0, noise=0.01, **options)
    state = {}
    while loop.time < 3.0:
        if 0.7 <= loop.time < 0.7 + INTERVAL:
            loop.vehicles[VEHICLE].plant.push(lambda x: pendulum_push(PROBLEM.plant, x, -1e-3))
        state[round(loop.time / INTERVAL)] = loop.vehicles[VEHICLE].plant.state
        loop.tick()
    made_since = [made for made in loop.plans if made.start - PARAMETERS.delay > 0.7]
    assert made_since
    for made in made_since:
        true = state[round(made.start / INTERVAL)]
        planned = made.solution.trajectory.states[0]
        assert (np.abs(planned - true) < [0.03, 0.05, 0.5, 0.8]).all()


def test_another_question_is_answered_at_once(plan: PlanInForce) -> None:
    replanner = Replanner(SwingUpExecution(PROBLEM), PARAMETERS)
    replanner.adopt(plan)
    at = 0.1
    seen = {VEHICLE: Observation(plan.solution.trajectory.sample(at).state, at, Mode.FOLLOWING)}
    assert replanner.review(PROBLEM, seen, at).plan is None
    wanted = 1 if round(plan.solution.trajectory.states[-1, 0] / math.tau) == 0 else 0
    other = replace(PROBLEM, goal=replace(PROBLEM.goal, turns=wanted))
    review = replanner.review(other, seen, at)
    assert review.necessary
    assert review.plan is not None, review.reason
    last = review.plan.solution.trajectory.states[-1]
    assert last[0] == pytest.approx(math.tau * wanted, abs=1e-3)


def test_a_plan_that_has_not_begun_is_left_alone(plan: PlanInForce) -> None:
    replanner = Replanner(SwingUpExecution(PROBLEM), PARAMETERS)
    seen = {VEHICLE: Observation(np.zeros(4), 0.0, Mode.IDLE)}
    assert replanner.review(PROBLEM, seen, 0.0).plan is None
    replanner.adopt(replace(plan, start=1.0))
    assert replanner.review(PROBLEM, seen, 0.0).plan is None


def test_a_state_beyond_the_limits_keeps_the_plan_and_says_why(plan: PlanInForce) -> None:
    replanner = Replanner(SwingUpExecution(PROBLEM), PARAMETERS)
    replanner.adopt(plan)
    seen = {VEHICLE: Observation(np.array([3.0, 5.0, 0.0, 0.0]), 0.5, Mode.IDLE)}
    review = replanner.review(PROBLEM, seen, 0.5)
    assert review.plan is None
    assert review.necessary
    assert 'INVALID_PROBLEM' in review.reason


@pytest.mark.parametrize('mode', [Mode.FOLLOWING, Mode.RECOVERING])
def test_where_the_plan_is_followed_its_rest_is_the_first_guess(
    plan: PlanInForce, monkeypatch: pytest.MonkeyPatch, mode: Mode
) -> None:
    guesses = []
    solve = PendulumSwingUp.solve

    def noted(self: PendulumSwingUp, *args: Any, **options: Any) -> Any:
        guesses.append(options['warm_start'])
        return solve(self, *args, **options)

    monkeypatch.setattr(PendulumSwingUp, 'solve', noted)
    replanner = Replanner(SwingUpExecution(PROBLEM), PARAMETERS)
    replanner.adopt(plan)
    at = 0.3
    state = plan.solution.trajectory.sample(at).state + np.array([0.1, 0.0, 1.0, 0.0])
    replanner.review(PROBLEM, {VEHICLE: Observation(state, at, mode)}, at)
    rest = plan.remainder(at + PARAMETERS.delay)
    assert rest is not None
    (guess,) = guesses
    if mode is Mode.FOLLOWING:
        left = guess.trajectory
        np.testing.assert_array_equal(left.times, rest.trajectory.times)
        np.testing.assert_array_equal(left.states, rest.trajectory.states)
    else:
        assert guess is None


def test_a_smooth_torque_is_handed_over_without_a_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through replanner and tracker: what the plant is told goes on where plans change."""
    solve = PendulumSwingUp.solve

    def at_leisure(self: PendulumSwingUp, deadline: float, **options: Any) -> Any:
        return solve(self, deadline=10.0, **options)

    monkeypatch.setattr(PendulumSwingUp, 'solve', at_leisure)
    limit = 0.09
    problem = build(PendulumSwingUp, {'limits.torque': limit, 'method': 'smooth'})
    first = PlanInForce(problem, problem.solve(deadline=10.0), start=0.0)
    setup = PlantSetup(
        problem.plant,
        first.solution.trajectory.states[0],
        np.array([-limit]),
        np.array([limit]),
        np.zeros(4),
    )
    tracker = PendulumTracker(build(PendulumTrackerParameters, {'limits.torque': limit}))
    replanner = Replanner(SwingUpExecution(problem), ReplanParameters(rate=20.0, delay=0.1))
    vehicles = {VEHICLE: Vehicle(tracker, SimulatedPlant(setup))}
    loop = RecedingHorizon(vehicles, problem, interval := 0.002, replanner)
    loop.begin(first)
    torques: list[float] = []
    while loop.time < first.end:
        if len(torques) == 20:
            # Another question, which is answered at once, on the way.
            loop.problem = replace(problem, limits=replace(problem.limits, disk_angle=1.8))
        loop.tick()
        torques.append(float(vehicles[VEHICLE].plant.control[0]))
    handed_over = [made for made in loop.plans[1:] if made.start < first.end - 0.05]
    assert handed_over, [review.reason for review in loop.reviews]
    for made in handed_over:
        at = round(made.start / interval)
        around = np.diff(torques[slice(at - 2, at + 3)])
        planned = made.solution.trajectory.control('torque')
        steepest = np.abs(np.diff(planned) / np.diff(made.solution.trajectory.times)).max()
        assert np.abs(around).max() < 1.5 * steepest * interval + 0.03 * limit
