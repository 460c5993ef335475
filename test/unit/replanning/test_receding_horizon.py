# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The receding horizon in closed loop, with its latency, on plants that are not the models."""

from dataclasses import replace
import itertools
import math

from benchmark.receding import RecedingHorizon
import closed_loop
from closed_loop import FORMATION, pendulum, pendulum_tracker, robot, SWING, WEAK
import numpy as np
import pytest
from tdm_planner.problems.pendulum.task import VEHICLE
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.replanning import FormationExecution, Replanner, SwingUpExecution
from tdm_planner.tracking import Phase
from tdm_sim.simulation import pendulum_push

INTERVAL = 0.005  # s
# Generous, so that a busy machine does not decide the outcome.
PARAMETERS = ReplanParameters(rate=5.0, delay=0.4)


def swinging(seed=1, replanning=True, mismatch=0.05, noise=1.0, **values):
    plan = closed_loop.swing_up()
    tracker = pendulum_tracker(WEAK, **{'replan__on_deviation': True, **values})
    start = plan.solution.trajectory.states[0]
    vehicles = {VEHICLE: pendulum(tracker, start, mismatch, noise, seed)}
    replanner = Replanner(SwingUpExecution(SWING), PARAMETERS) if replanning else None
    loop = RecedingHorizon(vehicles, SWING, INTERVAL, replanner)
    loop.begin(plan)
    return loop


def run(loop: RecedingHorizon, until: float) -> None:
    while loop.time < until:
        loop.tick()


@pytest.mark.parametrize(('seed', 'replanning'), [(3, True), (5, True), (3, False)])
def test_a_push_that_the_feedback_cannot_mend_is_planned_for(seed, replanning):
    loop = swinging(seed, replanning)
    tracker, plant = loop.vehicles[VEHICLE]
    run(loop, 0.7)
    plant.push(lambda x: pendulum_push(SWING.plant, x, 1.5e-3))
    run(loop, loop.plans[0].end + 1.0)
    while replanning and loop.time < loop.plans[-1].end + 1.0:
        loop.tick()
    upright = abs(math.remainder(float(plant.state[0]), math.tau)) < 0.05
    assert (upright and tracker.phase is Phase.HOLDING) == replanning
    assert (len(loop.plans) > 1) == replanning
    assert len(loop.rejections) <= 1  # made from a state just before the push
    assert all(made.solution.verification.ok for made in loop.plans)
    starts = [made.start for made in loop.plans]
    assert (np.diff(starts) > PARAMETERS.delay - 1e-9).all()
    last = loop.reviews[-4:]
    assert all(review.outlook.settled and review.solve_time == 0.0 for review in last)


def test_the_next_review_but_one_mends_a_refusal() -> None:
    loop = swinging(mismatch=0.0, noise=0.0, replan__on_deviation=False)
    tracker, plant = loop.vehicles[VEHICLE]
    usual = tracker.parameters
    turns = round(loop.plans[0].solution.trajectory.states[-1, 0] / math.tau)
    loop.problem = replace(SWING, goal=replace(SWING.goal, turns=1 - turns))
    tracker.parameters = replace(usual, tolerance=replace(usual.tolerance, start=1e-9))
    while not loop.rejections:
        loop.tick()
        assert loop.time < 3.0
    tracker.parameters = usual
    rejected = loop.plans[-1]
    while len(loop.plans) < 3 and loop.time < rejected.start + 3.0:
        loop.tick()
    assert any(review.rejected for review in loop.reviews)
    # Seen when the plans have parted, at the next review; the new plan follows.
    mended = loop.plans[2]
    assert mended.start < rejected.start + 1.0 + 2 / PARAMETERS.rate + PARAMETERS.delay
    run(loop, mended.end + 1.0)
    assert tracker.phase is Phase.HOLDING
    assert float(plant.state[0]) == pytest.approx(math.tau * (1 - turns), abs=0.05)


def test_a_smooth_torque_is_handed_over_without_a_jump() -> None:
    first = closed_loop.smooth_swing_up()
    problem, interval = first.problem, 0.002
    limit = problem.limits.torque
    vehicle = pendulum(pendulum_tracker(limit), first.solution.trajectory.states[0])
    replanner = Replanner(SwingUpExecution(problem), ReplanParameters(rate=20.0, delay=0.1))
    loop = RecedingHorizon({VEHICLE: vehicle}, problem, interval, replanner)
    loop.begin(first)
    torques: list[float] = []
    while len(loop.plans) < 2 or loop.time < loop.plans[1].start + 0.02:
        if len(torques) == 20:
            loop.problem = replace(problem, limits=replace(problem.limits, disk_angle=1.8))
        loop.tick()
        torques.append(float(vehicle.plant.control[0]))
        assert loop.time < first.end - 0.05, [review.reason for review in loop.reviews]
    made = loop.plans[1]
    at = round(made.start / interval)
    planned = made.solution.trajectory.control('torque')
    steepest = np.abs(np.diff(planned) / np.diff(made.solution.trajectory.times)).max()
    around = np.abs(np.diff(torques[slice(at - 2, at + 3)])).max()
    assert around < 1.5 * steepest * interval + 0.03 * limit


def test_a_pushed_robot_arrives_and_near_the_goal_no_plan_follows_the_other() -> None:
    plan, interval, delay = closed_loop.crossing(), 0.02, 0.6
    vehicles = {
        name: robot(motion.states[0], 0.05, 1.0, seed=k, gains=False, replan__on_deviation=True)
        for k, (name, motion) in enumerate(plan.solution.trajectories.items())
    }
    replanner = Replanner(FormationExecution(FORMATION), ReplanParameters(rate=2.0, delay=delay))
    loop = RecedingHorizon(vehicles, FORMATION, interval, replanner)
    loop.begin(plan)
    closest, late = math.inf, []
    pushed_at = round(0.4 * plan.end / interval)
    while loop.time < loop.plans[-1].end + 3.0:
        if round(loop.time / interval) == pushed_at:
            vehicles['robot2'].plant.push(lambda x: x + 0.05 * np.eye(7)[2])
        reviewed = len(loop.reviews)
        loop.tick()
        if loop.time > loop.plans[-1].end + interval:
            late += loop.reviews[reviewed:]
        places = [vehicle.plant.state[:2] for vehicle in vehicles.values()]
        pairs = itertools.combinations(places, 2)
        closest = min(closest, *(math.hypot(*(one - other)) for one, other in pairs))
    assert closest > FORMATION.arena.minimum_separation
    for vehicle, goal in zip(vehicles.values(), FORMATION.task.goal, strict=True):
        np.testing.assert_allclose(vehicle.plant.state[:2], goal, atol=0.02)
    # The end was reached by one plan, and after it there was neither another nor a search.
    assert loop.plans[-1].solution.duration > 1.0
    assert len(late) >= 4
    assert all(review.plan is None and review.solve_time == 0.0 for review in late)
    assert (np.diff([made.start for made in loop.plans]) > delay - 1e-9).all()
