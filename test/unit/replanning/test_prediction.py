# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What is predicted is what trackers do, what will fail is seen in time; closed loops of both."""

from dataclasses import replace
import itertools
import math

from benchmark.receding import RecedingHorizon
import closed_loop
from closed_loop import FORMATION, pendulum, pendulum_tracker, robot, seen, states_on, SWING, WEAK
from double_integrator import DoubleIntegrator
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.formation.search import kept_motions
from tdm_planner.problems.pendulum.candidates import arcs_of
from tdm_planner.problems.pendulum.task import PENDULUM_NAME
from tdm_planner.problems.planner_parameters import ReplanParameters
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.replanning.formation_execution import FormationExecution
from tdm_planner.replanning.planned_plants import planned_plant
from tdm_planner.replanning.replanner import Replanner
from tdm_planner.replanning.swing_up_execution import SwingUpExecution
from tdm_planner.tracking.motion import ObservedPhase
from tdm_planner.tracking.robot_tracking import RobotTrackerParameters

TUNED = {'weights__psi': 30.0, 'weights__psi_dot': 10.0, 'weights__torque': 0.05}
TRACKED = [(phase, False, True) for phase in ObservedPhase]
TRACKED += [(ObservedPhase.FOLLOWING, True, known) for known in (True, False)]
AWAY = np.array([0.008, -0.008, 0.005, 0.005, 0.01, 0.01, 0.0])


swing = pytest.fixture(closed_loop.swing_up, scope='module', name='swing')
flight = pytest.fixture(closed_loop.crossing, scope='module', name='flight')


def outlook(execution, at, states):
    return execution.outlook(execution.predict(seen(states, at), at), at)


def states_then(loop, until):
    while loop.time < until:
        loop.tick()
    return {name: vehicle.plant.state for name, vehicle in loop.vehicles.items()}


@pytest.mark.parametrize(('phase', 'tuned', 'known'), TRACKED)
def test_the_pendulum_is_predicted_where_its_own_tracker_takes_it(swing, phase, tuned, known):
    """With the defaults in place of a tuned tracker's weights it is predicted elsewhere."""
    tracker = pendulum_tracker(1.2 * WEAK, **TUNED) if tuned else pendulum_tracker(WEAK)
    away, begin = ([0.05, 0.1, 0.15, 0.5], 0.2) if tuned else ([0.05, 0.05, 0.3, 0.3], 0.6)
    planned = swing.solution.trajectory
    way = np.sign(planned.controls[0])  # the mirrored plan is as good
    vehicle = pendulum(tracker, planned.states[0] + way * away)
    loop = RecedingHorizon({PENDULUM_NAME: vehicle}, SWING, 0.005)
    loop.begin(swing)
    now = seen(states_then(loop, begin), loop.time, phase)
    if phase is ObservedPhase.IDLE:
        tracker.stop('test')
    elif phase is ObservedPhase.RECOVERING:
        replan = replace(tracker.parameters.replan, on_deviation=True)
        tracker.parameters = replace(tracker.parameters, replan=replan)
        tracker.abort('test')
    execution = SwingUpExecution(swing, tracker.parameters if tuned and known else None)
    predicted = execution.predict(now, loop.time + 0.2)[PENDULUM_NAME]
    missed = np.abs(predicted.state - states_then(loop, loop.time + 0.1975)[PENDULUM_NAME])
    assert (missed < [5e-3, 5e-3, 0.1, 0.1]).all() == known, missed


@pytest.mark.parametrize(
    ('stamps', 'late', 'turned'),
    [
        pytest.param([0.0], 0.04, 0.0, id='late on its plan'),
        pytest.param([0.0, -0.3], 0.0, 0.0, id='states in the wrong order'),
        *(pytest.param([0.0], 0.0, n, id=f'{n:g} turns away') for n in (-2.0, 1.0)),
    ],
)
def test_a_pendulum_is_predicted_along_its_plan_from_any_state_of_it(swing, stamps, late, turned):
    """Theta goes on as the plan counts the turns: so does goal.turns."""
    execution, middle = SwingUpExecution(swing), 0.5 * swing.solution.duration
    for at in (middle + stamp for stamp in stamps):
        state = states_on(swing, at - late)[PENDULUM_NAME] + [math.tau * turned, 0.0, 0.0, 0.0]
        now = seen({PENDULUM_NAME: state}, at)
        predicted = execution.predict(now, middle + 0.1)[PENDULUM_NAME]
        expected = states_on(swing, middle + 0.1 - late)[PENDULUM_NAME]
        missed = np.abs(predicted.state - expected)
        assert (missed < [5e-3, 5e-3, 0.1, 0.1]).all(), missed


def test_a_smooth_torque_goes_on_within_new_limits_and_from_zero_at_the_goal(swing):
    execution, smooth = SwingUpExecution(swing), replace(SWING, method='smooth')
    weaker = replace(smooth, limits=replace(smooth.limits, torque=0.5 * WEAK))
    for share, problem, part in ((0.5, smooth, 1.0), (0.5, weaker, 0.5), (1.5, weaker, 0.0)):
        at = share * swing.solution.duration
        predicted = execution.predict(seen(states_on(swing, at), at), at + 0.01)
        planned = abs(swing.solution.trajectory.controls[0, 0])
        asked = execution.problem_from(problem, predicted).start.torque
        assert abs(asked) == pytest.approx(part * planned)


def test_robots_are_predicted_where_their_trackers_take_them(flight):
    away = np.array([0.01, -0.01, 0.002, 0.002, 0.01, 0.0, 0.0])
    vehicles = {name: robot(state + away) for name, state in states_on(flight, 0.0).items()}
    loop = RecedingHorizon(vehicles, FORMATION, 0.02)
    loop.begin(flight)
    now = seen(states_then(loop, 3.0), loop.time)
    predicted = FormationExecution(flight).predict(now, loop.time + 0.3)
    for name, state in states_then(loop, loop.time + 0.29).items():
        missed = np.abs(predicted[name].state - state)[:6]
        assert (missed < [2e-3, 2e-3, 5e-3, 5e-3, 2e-2, 2e-2]).all(), missed


def test_only_what_the_feedback_cannot_mend_is_a_failure(swing):
    little, much = [0.01, 0.01, 0.05, 0.05], [0.0, 0.0, 15.0, 0.0]
    for share, away in ((0.1, little), (0.4, little), (0.7, little), (0.5, much)):
        at = share * swing.solution.duration
        state = states_on(swing, at)[PENDULUM_NAME] + away
        found = outlook(SwingUpExecution(swing), at, {PENDULUM_NAME: state})
        assert ('cannot bring it back' in found.failure) == (away is much), share
        assert (found.failure == '') == (away is little), share
        assert found.cost == pytest.approx(swing.solution.duration - at)


def test_a_push_towards_another_robot_is_seen(flight):
    plans = flight.solution.trajectories
    times = np.arange(0.0, flight.solution.duration, 0.1)
    places = [plans[name].sample(times).state[:, :2] for name in ('robot1', 'robot2')]
    nearest = int(np.linalg.norm(places[0] - places[1], axis=1).argmin())
    at = float(times[max(nearest - 15, 0)])
    for speed in (0.0, 0.3):
        states = states_on(flight, at)
        towards = states['robot2'][:2] - states['robot1'][:2]
        states['robot1'][2:4] += speed * towards / np.linalg.norm(towards)
        found = outlook(FormationExecution(flight), at, states)
        assert bool(found.failure) == (speed > 0.0), found


@pytest.mark.parametrize(('name', 'axis'), [('robot2', 0), ('robot3', 1)])
@pytest.mark.parametrize('away', [0.0, 0.1])
def test_what_leads_near_a_wall_is_seen(flight, name, axis, away):
    narrow = replace(FORMATION, arena=replace(FORMATION.arena, length=3.61, width=3.61))
    states = states_on(flight, 0.0)
    states[name][axis] += away
    found = outlook(FormationExecution(replace(flight, problem=narrow)), 0.0, states)
    assert (f"'{name}' would come" in found.failure) == (away > 0.0)
    assert ('near a wall' in found.failure) == (away > 0.0)


@pytest.mark.parametrize('away', [0.0, 0.1])
def test_what_leads_near_a_keep_out_zone_is_seen(flight, away):
    """A zone that the plan passes with 2 cm more than it must."""
    plan = flight.solution.trajectories['robot2']
    x, y = plan.states[:, :2].T
    k = x.argmin()  # to the left of it there is nobody
    at, zone = float(plan.times[k]), [float(x[k]) - 0.1 - 0.2 - 0.02, float(y[k]), 0.1]
    asked = replace(FORMATION, arena=replace(FORMATION.arena, obstacles=zone))
    states = states_on(flight, at)
    states['robot2'][0] -= away
    found = outlook(FormationExecution(replace(flight, problem=asked)), at, states)
    assert ("'robot2' would come" in found.failure) == (away > 0.0)
    assert ('near a keep-out zone' in found.failure) == (away > 0.0)


@pytest.mark.parametrize(('x', 'zone'), [(0.2, []), (1.0, [0.5, 2.0, 0.3]), (1.6, [])])
def test_a_goal_as_near_as_allowed_is_no_failure(x, zone):
    """To a wall, to a keep-out zone, to another robot; nor is what feedback leaves there."""
    values = {'robots': ['robot1', 'robot2'], 'arena.obstacles': zone}
    values |= {'formation.anchor': [0.0, 2.0, 0.0]}
    values |= {'formation.robot1': [x, 0.0, 0.0], 'formation.robot2': [2.0, 0.0, 0.0]}
    problem = RobotFormation.from_parameters(values)
    plan = TimedPlan(problem, problem.solve(counted=True), 0.0)
    for share, away in itertools.product((0.2, 0.6, 1.0, 1.2), (0.0, 2e-3, -2e-3)):
        states = states_on(plan, share * plan.end)
        states['robot1'][:2] += away
        assert not outlook(FormationExecution(plan), share * plan.end, states).failure


def test_robots_held_at_their_goals_stay_there(flight):
    execution, at = FormationExecution(flight), flight.end + 2.0
    away = np.array([0.005, -0.005, 0.002, 0.0, 0.01, 0.0, 0.0])
    states = {name: state + away for name, state in states_on(flight, at).items()}
    predicted = execution.predict(seen(states, at), at)
    assert execution.outlook(predicted, at).settled
    new = execution.problem_from(FORMATION, predicted)
    assert new.task.staying.all()
    assert (new.task.arrived > 1.9).all()


@pytest.mark.parametrize(('ends', 'order'), [('varied', 0), ('given', 0), ('given', 2)])
def test_plans_of_robots_begin_with_the_thruster_where_it_is(flight, ends, order):
    asked = replace(FORMATION, end_accelerations=ends, speed_factor_order=order)
    execution, at = FormationExecution(flight), 4.0
    predicted = execution.predict(seen(states_on(flight, at), at), at + 0.15)
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


@settings(max_examples=20)
@given(share=st.floats(0.0, 0.95))
@pytest.mark.parametrize('name', ['swing', 'flight'])
def test_the_rest_of_a_plan_is_the_same_motion_later(request, name, share):
    plan = replace(request.getfixturevalue(name), start=3.0)
    elapsed = share * plan.solution.duration
    rest = plan.remainder(plan.start + elapsed)
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


def test_there_is_no_rest_before_the_start_or_after_the_end(swing):
    assert swing.remainder(swing.start - 0.1) is None
    assert swing.remainder(swing.end) is None
    with pytest.raises(InvalidProblem, match='nothing is left'):
        swing.solution.trajectory.after(swing.solution.duration)


def test_a_tuned_robot_is_predicted_with_its_own_gains(flight):
    at, stiff = 4.0, build(RobotTrackerParameters, {'feedback.yaw': 0.01})
    turned = {name: state + 0.05 * np.eye(7)[4] for name, state in states_on(flight, at).items()}
    now = seen(turned, at)
    usual = FormationExecution(flight).predict(now, at + 0.5)
    tuned = FormationExecution(flight, {'robot1': stiff}).predict(now, at + 0.5)
    assert abs(tuned['robot1'].state[4] - usual['robot1'].state[4]) > 1e-3
    np.testing.assert_array_equal(tuned['robot2'].state, usual['robot2'].state)


@pytest.fixture(scope='module')
def leg(flight):
    """Return a plan, and an instant at which the first robot is on its last leg."""
    rate = FORMATION.limits.thruster_rate
    return flight, flight.solution.trajectories['robot1'].duration - 0.8 * np.pi / rate


def asked_at(plan, at, asked=FORMATION, **away):
    execution, now = FormationExecution(plan), seen(states_on(plan, at), at, **away)
    return execution.problem_from(asked, execution.predict(now, at))


def test_a_robot_about_to_arrive_keeps_its_motion(leg):
    plan, at = leg
    problem = asked_at(plan, at, robot1=AWAY, robot3=2 * AWAY)
    new = problem.solve(deadline=60.0, warm_start=plan.remainder(at))
    assert new.verification.ok
    old = plan.solution.trajectories['robot1']
    kept = new.trajectories['robot1']
    assert kept.duration == pytest.approx(old.duration - at, abs=1e-6)
    times = np.linspace(0.0, kept.duration, 200)
    impulses = kept.control_integral(times), old.control_integral(times + at)
    np.testing.assert_allclose(impulses[0], impulses[1] - impulses[1][0], atol=1e-6)
    states = kept.sample(times).state, old.sample(times + at).state
    np.testing.assert_allclose(*states, atol=1e-3)
    # Another robot's deviation, with more time left, is planned from.
    away = np.abs(new.trajectories['robot3'].states[0, :2] - problem.task.start[2]).max()
    assert away < 1e-9


@pytest.mark.parametrize('push', [0.0, 0.1])
@pytest.mark.parametrize('elsewhere', [0.0, 0.1])
def test_no_motion_is_kept_of_a_robot_pushed_or_led_elsewhere(leg, push, elsewhere):
    (plan, at), formation = leg, FORMATION.formation
    x, y, turn = formation.anchor
    moved = replace(formation, anchor=[x + elsewhere, y, turn])
    asked = replace(FORMATION, formation=moved)
    away = AWAY + push * np.eye(7)[2]
    planned = plan.solution.trajectories['robot1'].sample(at).state[:2]
    task = asked_at(plan, at, asked, robot1=away).task
    expected = planned + AWAY[:2] if push or elsewhere else planned
    np.testing.assert_allclose(task.start[0], expected, atol=1e-9)
    for other in (task, asked_at(plan, at, asked, robot1=0 * AWAY).task):
        kept = kept_motions(other, plan.remainder(at).trajectories)
        keeps = not elsewhere and not (push and other is task)
        assert ('robot1' in kept) == keeps


def test_a_smooth_torque_is_handed_over_without_a_jump() -> None:
    limit, interval = closed_loop.STRONG, 0.002
    problem = build(PendulumSwingUp, {'limits.torque': limit, 'method': 'smooth'})
    first = TimedPlan(problem, problem.solve(deadline=60.0), start=0.0)
    vehicle = pendulum(pendulum_tracker(limit), first.solution.trajectory.states[0])
    parameters = ReplanParameters(rate=20.0, delay=0.1)
    replanner = lambda plan: Replanner(SwingUpExecution(plan), parameters)  # noqa: E731
    loop = RecedingHorizon({PENDULUM_NAME: vehicle}, problem, interval, replanner)
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
        name: robot(motion.states[0], 0.05, 1.0, seed=k, replan__on_deviation=True)
        for k, (name, motion) in enumerate(plan.solution.trajectories.items())
    }
    parameters = ReplanParameters(rate=2.0, delay=delay)
    replanner = lambda plan: Replanner(FormationExecution(plan), parameters)  # noqa: E731
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
    assert {(review.plan, review.reason) for review in late} == {(None, 'the active plan does')}
    assert (np.diff([made.start for made in loop.plans]) > delay - 1e-9).all()


@pytest.mark.parametrize(
    ('speed', 'least', 'most'), [(0.0, 0, 4), (0.5, 190, 200), (2.0, 200, 200)]
)
def test_a_stated_plant_moves_on_as_it_did_and_noise_is_hardly_ever_motion(speed, least, most):
    values, moving = {'start.x': 0.0, 'start.v': 0.0}, 0
    rng, times = np.random.default_rng(0), 0.05 * np.arange(4)
    DoubleIntegrator().prepare()
    for noise in rng.normal(0.0, [2e-3, 0.02], (200, 4, 2)):
        plant = planned_plant(DoubleIntegrator, values)
        states = noise + np.stack([speed * times, np.full(4, speed)], axis=1)
        for state, at in zip(states, times, strict=True):
            plant.observe(state, at)
        now, at = states[-1], times[-1]
        ahead = plant.predict_without_plan(now, at, at + 1.0, values)
        assert plant.moves == (ahead[0] != now[0])
        assert ahead == pytest.approx([now[0] + plant.moves * now[1], now[1]], abs=1e-9)
        moving += plant.moves
    assert least <= moving <= most


def test_what_a_stated_plant_did_before_a_long_gap_does_not_count():
    values = {'start.x': 0.0, 'start.v': 0.0}
    plant, state = planned_plant(DoubleIntegrator, values), np.array([0.2, 2.0])
    for now in (0.0, 0.05, 3600.0):
        plant.observe(state + np.array([2.0 * (now - 3600.0), 0.0]), now)
    assert plant.predict_without_plan(state, 3600.0, 3601.0, values) is state


def test_a_stated_plant_is_predicted_whatever_the_parameters_of_its_start_are():
    plant = planned_plant(DoubleIntegrator, {'start.x': 0.0, 'start.v': 0.0})
    state, wrong = np.array([0.2, 2.0]), {'start.x': math.nan, 'start.v': 0.0}
    plant.observe(np.array([0.1, 2.0]), 0.0)
    assert plant.predict_without_plan(state, 0.05, 1.05, wrong) == pytest.approx(state)
