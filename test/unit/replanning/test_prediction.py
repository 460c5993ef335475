# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What is predicted is what trackers do, what will fail is seen in time; the rest of plans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from benchmark.receding import RecedingHorizon
from closed_loop import (
    crossing,
    FORMATION,
    pendulum,
    pendulum_tracker,
    robot,
    SWING,
    swing_up,
    WEAK,
)
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.problems.pendulum.switching_seeds import arcs_of
from tdm_planner.problems.pendulum.task import VEHICLE
from tdm_planner.replanning import (
    ActivePlan,
    FormationExecution,
    Mode,
    Observation,
    SwingUpExecution,
)
from tdm_planner.replanning.execution import Execution, Outlook
from tdm_planner.tracking import RobotTrackerParameters

SETTINGS = settings(max_examples=20)
TUNED = {'weights__psi': 30.0, 'weights__psi_dot': 10.0, 'weights__torque': 0.05}


@pytest.fixture(scope='module')
def swing() -> ActivePlan:
    return swing_up()


@pytest.fixture(scope='module')
def flight() -> ActivePlan:
    return crossing()


def outlook(
    execution: Execution, plan: ActivePlan, at: float, states: Mapping[str, np.ndarray]
) -> Outlook:
    seen = {name: Observation(state, at, Mode.FOLLOWING) for name, state in states.items()}
    return execution.outlook(plan, execution.predict(plan, seen, at), at)


def seen_on(plan: ActivePlan, at: float, away: float | np.ndarray = 0.0) -> dict[str, Observation]:
    """Return what is seen of vehicles that follow a plan, so far away from it."""
    states = states_at(plan, at)
    return {name: Observation(state + away, at, Mode.FOLLOWING) for name, state in states.items()}


def states_at(plan: ActivePlan, at: float) -> dict[str, np.ndarray]:
    return {name: part.sample(at).state for name, part in plan.solution.trajectories.items()}


@pytest.mark.parametrize(
    ('mode', 'tuned', 'known'),
    [
        *((mode, False, True) for mode in Mode),
        (Mode.FOLLOWING, True, True),
        (Mode.FOLLOWING, True, False),
    ],
)
def test_the_pendulum_is_predicted_where_its_own_tracker_takes_it(swing, mode, tuned, known):
    """With the defaults in place of a tuned tracker's weights it is predicted elsewhere."""
    tracker = pendulum_tracker(1.2 * WEAK, **TUNED) if tuned else pendulum_tracker(WEAK)
    away, begin = ([0.05, 0.1, 0.15, 0.5], 0.2) if tuned else ([0.05, 0.05, 0.3, 0.3], 0.6)
    vehicle = pendulum(tracker, swing.solution.trajectory.states[0] + away)
    loop = RecedingHorizon({VEHICLE: vehicle}, SWING, 0.005)
    loop.begin(swing)
    while loop.time < begin:
        loop.tick()
    if mode is Mode.IDLE:
        tracker.stop('test')
    elif mode is Mode.RECOVERING:
        tracker.parameters = replace(
            tracker.parameters, replan=replace(tracker.parameters.replan, on_deviation=True)
        )
        tracker.give_up('test')
    seen = {VEHICLE: Observation(vehicle.plant.state, loop.time, mode)}
    execution = SwingUpExecution(SWING, tracker.parameters if tuned and known else None)
    predicted = execution.predict(swing, seen, loop.time + 0.2)[VEHICLE]
    for _ in range(40):
        loop.tick()
    missed = np.abs(predicted.state - vehicle.plant.state)
    assert (missed < [5e-3, 5e-3, 0.1, 0.1]).all() == known, missed


def test_a_pendulum_that_is_late_on_its_plan_is_predicted_late(swing: ActivePlan) -> None:
    """Its tracker lets the plan wait."""
    at, late = 0.5 * swing.solution.duration, 0.04
    seen = {VEHICLE: Observation(states_at(swing, at - late)[VEHICLE], at, Mode.FOLLOWING)}
    predicted = SwingUpExecution(SWING).predict(swing, seen, at + 0.1)[VEHICLE]
    missed = np.abs(predicted.state - states_at(swing, at + 0.1 - late)[VEHICLE])
    assert (missed < [5e-3, 5e-3, 0.1, 0.1]).all(), missed


def test_robots_are_predicted_where_their_trackers_take_them(flight: ActivePlan) -> None:
    away = np.array([0.01, -0.01, 0.002, 0.002, 0.01, 0.0, 0.0])
    vehicles = {
        name: robot(part.states[0] + away) for name, part in flight.solution.trajectories.items()
    }
    loop = RecedingHorizon(vehicles, FORMATION, 0.02)
    loop.begin(flight)
    while loop.time < 3.0:
        loop.tick()
    seen = {
        name: Observation(vehicle.plant.state, loop.time, Mode.FOLLOWING)
        for name, vehicle in vehicles.items()
    }
    predicted = FormationExecution(FORMATION).predict(flight, seen, loop.time + 0.3)
    for _ in range(15):
        loop.tick()
    for name, vehicle in vehicles.items():
        missed = np.abs(predicted[name].state - vehicle.plant.state)[:6]
        assert (missed < [2e-3, 2e-3, 5e-3, 5e-3, 2e-2, 2e-2]).all(), missed


@pytest.mark.parametrize(
    ('share', 'away', 'failure'),
    [
        *((share, [0.01, 0.01, 0.05, 0.05], '') for share in (0.1, 0.4, 0.7)),
        (0.5, [-0.3, 0.0, -8.0, 0.0], 'cannot bring it back'),
    ],
)
def test_a_plan_that_is_followed_is_kept_and_what_the_feedback_cannot_mend_is_seen(
    swing, share, away, failure
):
    at = share * swing.solution.duration
    state = states_at(swing, at)[VEHICLE] + away
    seen = outlook(SwingUpExecution(SWING), swing, at, {VEHICLE: state})
    assert bool(seen.failure) == bool(failure)
    assert failure in seen.failure
    assert seen.cost == pytest.approx(swing.solution.duration - at)


def test_a_push_towards_another_robot_is_seen(flight: ActivePlan) -> None:
    plans = flight.solution.trajectories
    times = np.arange(0.0, flight.solution.duration, 0.1)
    places = [plans[name].sample(times).state[:, :2] for name in ('robot1', 'robot2')]
    nearest = int(np.linalg.norm(places[0] - places[1], axis=1).argmin())
    at = float(times[max(nearest - 15, 0)])
    for speed in (0.0, 0.3):
        states = states_at(flight, at)
        towards = states['robot2'][:2] - states['robot1'][:2]
        states['robot1'][2:4] += speed * towards / np.linalg.norm(towards)
        seen = outlook(FormationExecution(FORMATION), flight, at, states)
        assert bool(seen.failure) == (speed > 0.0), seen


@pytest.mark.parametrize(('name', 'axis'), [('robot2', 0), ('robot3', 1)])
@pytest.mark.parametrize('away', [0.0, 0.1])
def test_what_leads_near_a_wall_is_seen(flight, name, axis, away):
    narrow = replace(FORMATION, arena=replace(FORMATION.arena, length=3.61, width=3.61))
    states = states_at(flight, 0.0)
    states[name][axis] += away
    seen = outlook(FormationExecution(narrow), replace(flight, problem=narrow), 0.0, states)
    assert (f"'{name}' would come" in seen.failure) == (away > 0.0)
    assert ('near a wall' in seen.failure) == (away > 0.0)


def test_robots_held_at_their_goals_stay_there(flight: ActivePlan) -> None:
    execution, at = FormationExecution(FORMATION), flight.end + 2.0
    away = np.array([0.005, -0.005, 0.002, 0.0, 0.01, 0.0, 0.0])
    predicted = execution.predict(flight, seen_on(flight, at, away), at)
    assert execution.outlook(flight, predicted, at).settled
    new = execution.problem_from(FORMATION, predicted)
    assert new.task.staying.all()
    assert (new.task.arrived > 1.9).all()


@pytest.mark.parametrize('ends', ['varied', 'given'])
def test_plans_of_robots_begin_with_the_thruster_where_it_is(flight, ends):
    asked = replace(FORMATION, end_accelerations=ends)
    execution, at = FormationExecution(FORMATION), 4.0
    predicted = execution.predict(flight, seen_on(flight, at), at + 0.15)
    new = execution.problem_from(asked, predicted).solve(deadline=60.0)
    assert new.verification.ok
    limits = FORMATION.limits
    for name, now in predicted.items():
        first = new.trajectories[name]
        np.testing.assert_allclose(first.states[0], now.state, atol=1e-9)
        torque, thrust = first.control('torque')[0], first.control('thrust')[0]
        assert torque == pytest.approx(now.control[2], abs=0.02 * limits.torque)
        if ends == 'given':
            assert thrust == pytest.approx(now.control[0], abs=0.02 * limits.thrust)


@SETTINGS
@given(share=st.floats(0.0, 0.95))
@pytest.mark.parametrize('name', ['swing', 'flight'])
def test_the_rest_of_a_plan_is_the_same_motion_later(request, name, share):
    plan = replace(request.getfixturevalue(name), start=3.0)
    elapsed = share * plan.solution.duration
    rest = plan.remainder(plan.start + elapsed)
    assert rest is not None
    for vehicle, whole in plan.solution.trajectories.items():
        left = rest.trajectories[vehicle]
        if elapsed > whole.duration - 0.01:
            continue
        assert left.times[0] == 0.0
        assert left.duration == pytest.approx(whole.duration - elapsed, abs=2e-9)
        times = left.times[1:-1]
        planned, later = whole.sample(elapsed + times), left.sample(times)
        np.testing.assert_allclose(later.state, planned.state, atol=1e-6)
        arcs, fewer = arcs_of(whole), arcs_of(left)
        assert (arcs is None) == (fewer is None) == (name == 'flight')
        if arcs is not None and fewer is not None:
            count = fewer.torques.size
            assert list(fewer.torques) == list(arcs.torques[-count:])
            same = arcs.durations[-count:][1:]
            np.testing.assert_allclose(fewer.durations[1:], same, atol=1e-8)
            assert fewer.durations.sum() == pytest.approx(left.duration, abs=1e-6)


def test_there_is_no_rest_before_the_start_or_after_the_end(swing: ActivePlan) -> None:
    assert swing.remainder(swing.start - 0.1) is None
    assert swing.remainder(swing.end) is None
    with pytest.raises(InvalidProblem, match='nothing is left'):
        swing.solution.trajectory.after(swing.solution.duration)


def test_a_tuned_robot_is_predicted_with_its_own_gains(flight: ActivePlan) -> None:
    at, stiff = 4.0, build(RobotTrackerParameters, {'feedback.yaw': 0.01})
    seen = seen_on(flight, at, 0.05 * np.eye(7)[4])
    usual = FormationExecution(FORMATION).predict(flight, seen, at + 0.5)
    tuned = FormationExecution(FORMATION, {'robot1': stiff}).predict(flight, seen, at + 0.5)
    assert abs(tuned['robot1'].state[4] - usual['robot1'].state[4]) > 1e-3
    np.testing.assert_array_equal(tuned['robot2'].state, usual['robot2'].state)
