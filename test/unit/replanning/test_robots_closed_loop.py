# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Three robots replanned for on the way: when they are in place, nothing is planned any more."""

from __future__ import annotations

import numpy as np
import pytest
from tdm_planner.parameters import build
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.replanning import FormationExecution, PlanInForce, Replanner
from tdm_planner.tracking import RobotTracker, RobotTrackerParameters
from tdm_sim.mismatch import mismatched
from tdm_sim.receding import RecedingHorizon, Vehicle
from tdm_sim.simulation import PlantSetup, SimulatedPlant

INTERVAL, HELD = 0.02, 4.0  # s
PROBLEM = RobotFormation()
NOISE = np.array([0.002, 0.002, 0.002, 0.002, 0.005, 0.005, 0.005])


@pytest.fixture(scope='module')
def flown() -> tuple[RecedingHorizon, float]:
    """Return the loop after the robots' arrival, and the least distance there was [m]."""
    plan = PlanInForce(PROBLEM, PROBLEM.solve(deadline=10.0), start=0.0)
    limits = np.array([PROBLEM.limits.thrust, PROBLEM.limits.thruster_rate, PROBLEM.limits.torque])
    vehicles = {}
    tracking = {'rate': 1.0 / INTERVAL, 'replan.on_deviation': True}
    for k, (name, motion) in enumerate(plan.solution.trajectories.items()):
        setup = PlantSetup(
            mismatched(PROBLEM.plant, 0.05, k),
            motion.states[0],
            np.array([0.0, *-limits[1:]]),
            limits,
            NOISE,
        )
        tracker = RobotTracker(build(RobotTrackerParameters, tracking))
        vehicles[name] = Vehicle(tracker, SimulatedPlant(setup, k))
    replanner = Replanner(FormationExecution(PROBLEM), ReplanParameters(rate=2.0, delay=0.6))
    loop = RecedingHorizon(vehicles, PROBLEM, INTERVAL, replanner)
    loop.begin(plan)
    closest, pushed = np.inf, False
    while loop.time < loop.plans[-1].end + HELD:
        if not pushed and loop.time > 0.4 * plan.end:
            pushed = True
            vehicles['robot2'].plant.push(lambda x: x + np.eye(7)[2] * 0.05)
        loop.tick()
        places = np.array([vehicle.plant.state[:2] for vehicle in vehicles.values()])
        for a in range(3):
            for b in range(a):
                closest = min(closest, float(np.hypot(*(places[a] - places[b]))))
    return loop, closest


def test_a_pushed_robot_arrives_and_all_keep_their_distance(
    flown: tuple[RecedingHorizon, float],
) -> None:
    loop, closest = flown
    assert closest > PROBLEM.arena.minimum_separation
    for k, vehicle in enumerate(loop.vehicles.values()):
        np.testing.assert_allclose(vehicle.plant.state[:2], PROBLEM.task.goal[k], atol=0.02)


def test_near_the_goal_no_plan_follows_the_other(flown: tuple[RecedingHorizon, float]) -> None:
    loop, _ = flown
    last = loop.plans[-1]
    # The end was reached by one plan, and after it there was neither another nor a search.
    assert last.solution.duration > 1.0
    late = [
        review
        for review, at in zip(loop.reviews, review_times(loop), strict=True)
        if at > last.end
    ]
    assert len(late) >= 4
    assert all(review.plan is None and review.solve_time == 0.0 for review in late)
    starts = np.array([made.start for made in loop.plans])
    assert (np.diff(starts) > 0.6 - 1e-9).all()


def review_times(loop: RecedingHorizon) -> list[float]:
    """Instants of the reviews, counted back from the end, where nothing interrupts them."""
    period = 1.0 / loop.replanner.parameters.rate if loop.replanner else np.nan
    count = len(loop.reviews)
    return [loop.time - period * (count - k) for k in range(count)]
