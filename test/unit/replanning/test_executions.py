# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is foreseen is what trackers and plants do; what will fail is seen in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.swing_up_task import VEHICLE
from tdm_planner.replanning import (
    FormationExecution,
    Mode,
    Observation,
    PlanInForce,
    SwingUpExecution,
)
from tdm_planner.tracking import (
    PendulumTracker,
    PendulumTrackerParameters,
    RobotTracker,
    RobotTrackerParameters,
)
from tdm_sim.receding import RecedingHorizon, Vehicle
from tdm_sim.simulation import PlantSetup, SimulatedPlant

SWING = build(PendulumSwingUp, {'limits.torque': 0.02})
LIMIT, INTERVAL = SWING.limits.torque, 0.005


@pytest.fixture(scope='module')
def swing() -> PlanInForce:
    return PlanInForce(SWING, SWING.solve(deadline=10.0), start=0.0)


@pytest.fixture(scope='module')
def crossing() -> PlanInForce:
    problem = RobotFormation()
    return PlanInForce(problem, problem.solve(deadline=10.0), start=0.0)


USUAL = build(PendulumTrackerParameters, {'limits.torque': LIMIT})


def pendulum_loop(
    plan: PlanInForce, away: np.ndarray, parameters: PendulumTrackerParameters = USUAL
) -> RecedingHorizon:
    start, limit = plan.solution.trajectory.states[0] + away, parameters.limits.torque
    setup = PlantSetup(SWING.plant, start, np.array([-limit]), np.array([limit]), np.zeros(4))
    tracker = PendulumTracker(parameters)
    loop = RecedingHorizon({VEHICLE: Vehicle(tracker, SimulatedPlant(setup))}, SWING, INTERVAL)
    loop.begin(plan)
    return loop


@pytest.mark.parametrize('mode', [Mode.FOLLOWING, Mode.RECOVERING, Mode.IDLE])
def test_the_pendulum_is_foreseen_where_its_tracker_takes_it(
    swing: PlanInForce, mode: Mode
) -> None:
    execution = SwingUpExecution(SWING)
    loop = pendulum_loop(swing, np.array([0.05, 0.05, 0.3, 0.3]))
    tracker, plant = loop.vehicles[VEHICLE]
    while loop.time < 0.6:
        loop.tick()
    if mode is Mode.IDLE:
        tracker.stop('test')
    elif mode is Mode.RECOVERING:
        tracker.parameters = replace(
            tracker.parameters, replan=replace(tracker.parameters.replan, on_deviation=True)
        )
        tracker.give_up('test')
    seen = {VEHICLE: Observation(plant.state, loop.time, mode)}
    foreseen = execution.foresee(swing, seen, loop.time + 0.2)[VEHICLE]
    for _ in range(40):
        loop.tick()
    away = np.abs(foreseen.state - plant.state)
    assert (away < [5e-3, 5e-3, 0.1, 0.1]).all(), away


@pytest.mark.parametrize('known', [True, False])
def test_a_tuned_tracker_is_foreseen_with_its_own_weights_and_limits(
    swing: PlanInForce, known: bool
) -> None:
    """With the defaults in its place the pendulum is foreseen elsewhere."""
    tuned = build(
        PendulumTrackerParameters,
        {
            'limits.torque': 1.2 * LIMIT,
            'weights.psi': 30.0,
            'weights.psi_dot': 10.0,
            'weights.torque': 0.05,
        },
    )
    loop = pendulum_loop(swing, np.array([0.1, 0.2, 0.3, 1.0]), tuned)
    _, plant = loop.vehicles[VEHICLE]
    while loop.time < 0.2:
        loop.tick()
    seen = {VEHICLE: Observation(plant.state, loop.time, Mode.FOLLOWING)}
    execution = SwingUpExecution(SWING, tuned if known else None)
    foreseen = execution.foresee(swing, seen, loop.time + 0.2)[VEHICLE]
    for _ in range(40):
        loop.tick()
    away = np.abs(foreseen.state - plant.state)
    assert (away < [5e-3, 5e-3, 0.1, 0.1]).all() == known, away


def test_a_tuned_robot_is_foreseen_with_its_own_gains(crossing: PlanInForce) -> None:
    problem = crossing.problem
    assert isinstance(problem, RobotFormation)
    at, stiff = 4.0, build(RobotTrackerParameters, {'feedback.yaw': 0.01})
    seen = {}
    for name, trajectory in crossing.solution.trajectories.items():
        turned = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0])
        state = trajectory.sample(at).state + turned
        seen[name] = Observation(state, at, Mode.FOLLOWING)
    usual = FormationExecution(problem).foresee(crossing, seen, at + 0.5)
    tuned = FormationExecution(problem, {'robot1': stiff}).foresee(crossing, seen, at + 0.5)
    assert abs(tuned['robot1'].state[4] - usual['robot1'].state[4]) > 1e-3
    np.testing.assert_array_equal(tuned['robot2'].state, usual['robot2'].state)


def test_robots_are_foreseen_where_their_trackers_take_them(crossing: PlanInForce) -> None:
    problem = crossing.problem
    assert isinstance(problem, RobotFormation)
    limits, vehicles = problem.limits, {}
    for name, trajectory in crossing.solution.trajectories.items():
        start = trajectory.states[0] + [0.01, -0.01, 0.002, 0.002, 0.01, 0.0, 0.0]
        lower = np.array([0.0, -limits.thruster_rate, -limits.torque])
        upper = np.array([limits.thrust, limits.thruster_rate, limits.torque])
        setup = PlantSetup(problem.plant, start, lower, upper, np.zeros(7))
        tracker = RobotTracker(build(RobotTrackerParameters, {'rate': 50.0}))
        vehicles[name] = Vehicle(tracker, SimulatedPlant(setup))
    loop = RecedingHorizon(vehicles, problem, 0.02)
    loop.begin(crossing)
    while loop.time < 5.0:
        loop.tick()
    seen = {
        name: Observation(vehicle.plant.state, loop.time, Mode.FOLLOWING)
        for name, vehicle in vehicles.items()
    }
    foreseen = FormationExecution(problem).foresee(crossing, seen, loop.time + 0.3)
    for _ in range(15):
        loop.tick()
    for name, vehicle in vehicles.items():
        away = np.abs(foreseen[name].state - vehicle.plant.state)
        assert (away[:6] < [2e-3, 2e-3, 5e-3, 5e-3, 2e-2, 2e-2]).all(), away


@pytest.mark.parametrize('share', [0.1, 0.4, 0.7])
def test_a_plan_that_is_followed_is_kept(swing: PlanInForce, share: float) -> None:
    execution, at = SwingUpExecution(SWING), share * swing.solution.duration
    state = swing.solution.trajectory.sample(at).state + np.array([0.01, 0.01, 0.05, 0.05])
    seen = {VEHICLE: Observation(state, at, Mode.FOLLOWING)}
    outlook = execution.outlook(swing, execution.foresee(swing, seen, at), at)
    assert not outlook.trouble
    assert outlook.cost == pytest.approx(swing.solution.duration - at)


def test_what_the_feedback_cannot_mend_is_seen(swing: PlanInForce) -> None:
    execution, at = SwingUpExecution(SWING), 0.5 * swing.solution.duration
    state = swing.solution.trajectory.sample(at).state + np.array([-0.3, 0.0, -8.0, 0.0])
    seen = {VEHICLE: Observation(state, at, Mode.FOLLOWING)}
    assert execution.outlook(swing, execution.foresee(swing, seen, at), at).trouble


def test_upright_and_held_all_is_settled_and_a_fall_is_seen(swing: PlanInForce) -> None:
    execution, at = SwingUpExecution(SWING), swing.end + 3.0
    goal = swing.solution.trajectory.states[-1]
    for away, settled in (([0.01, 0.05, 0.1, 0.1], True), ([1.5, 0.0, 8.0, 0.0], False)):
        seen = {VEHICLE: Observation(goal + away, at, Mode.FOLLOWING)}
        outlook = execution.outlook(swing, execution.foresee(swing, seen, at), at)
        assert outlook.settled == settled
        assert bool(outlook.trouble) != settled


def test_a_push_towards_another_robot_is_seen(crossing: PlanInForce) -> None:
    problem = crossing.problem
    assert isinstance(problem, RobotFormation)
    execution = FormationExecution(problem)
    plans = crossing.solution.trajectories
    times = np.arange(0.0, crossing.solution.duration, 0.1)
    places = {name: plan.sample(times).state[:, :2] for name, plan in plans.items()}
    apart = np.linalg.norm(places['robot1'] - places['robot2'], axis=1)
    at = float(times[max(int(apart.argmin()) - 15, 0)])
    states = {name: plan.sample(at).state for name, plan in plans.items()}
    towards = states['robot2'][:2] - states['robot1'][:2]
    for speed in (0.0, 0.3):
        pushed = {name: state.copy() for name, state in states.items()}
        pushed['robot1'][2:4] += speed * towards / np.linalg.norm(towards)
        seen = {n: Observation(state, at, Mode.FOLLOWING) for n, state in pushed.items()}
        outlook = execution.outlook(crossing, execution.foresee(crossing, seen, at), at)
        assert bool(outlook.trouble) == (speed > 0.0), outlook


def test_robots_held_at_their_goals_stay_there(crossing: PlanInForce) -> None:
    problem = crossing.problem
    assert isinstance(problem, RobotFormation)
    execution, at = FormationExecution(problem), crossing.end + 2.0
    ends = {n: plan.states[-1] for n, plan in crossing.solution.trajectories.items()}
    away = np.array([0.005, -0.005, 0.002, 0.0, 0.01, 0.0, 0.0])
    seen = {n: Observation(end + away, at, Mode.FOLLOWING) for n, end in ends.items()}
    foreseen = execution.foresee(crossing, seen, at)
    assert execution.outlook(crossing, foreseen, at).settled
    new = execution.problem_from(problem, foreseen)
    assert new.task.staying.all()
    assert (new.task.arrived > 1.9).all()


@pytest.mark.parametrize('ends', ['varied', 'given'])
def test_plans_of_robots_begin_with_the_thruster_where_it_is(
    crossing: PlanInForce, ends: str
) -> None:
    problem = crossing.problem
    assert isinstance(problem, RobotFormation)
    asked = replace(problem, end_accelerations=ends)
    execution, at = FormationExecution(problem), 4.0
    seen = {
        name: Observation(plan.sample(at).state, at, Mode.FOLLOWING)
        for name, plan in crossing.solution.trajectories.items()
    }
    foreseen = execution.foresee(crossing, seen, at + 0.15)
    new = execution.problem_from(asked, foreseen).solve(deadline=10.0)
    assert new.verification.ok
    for name, robot in foreseen.items():
        first = new.trajectories[name]
        np.testing.assert_allclose(first.states[0], robot.state, atol=1e-9)
        torque = first.control('torque')[0]
        assert torque == pytest.approx(robot.control[2], abs=0.02 * problem.limits.torque)
        if ends == 'given':
            thrust = first.control('thrust')[0]
            assert thrust == pytest.approx(robot.control[0], abs=0.02 * problem.limits.thrust)
