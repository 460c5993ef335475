# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The robot's tracker in closed loop with a robot that is not quite the model."""

from dataclasses import replace
import math

from closed_loop import Loop, robot
import numpy as np
import pytest
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.robot_replay import replay
from tdm_planner.tracking.motion import finished, Motion, Phase, TrajectoryRejected
from tdm_planner.trajectory import Trajectory

THRUST, RATE, TORQUE = 1.05, 2.0, 0.02  # N, rad/s, N m
DURATION = 12.0  # s
ALPHA = np.eye(7)[6]
SLOW = {'limits__thrust': 0.315, 'limits__thruster_rate': 0.5, 'limits__torque': 0.00189}


def trajectory(times: np.ndarray, controls: np.ndarray, interpolation: str) -> Trajectory:
    plant = FloatingRobot()
    draft = Trajectory.of(plant, times, np.zeros((times.size, 7)), controls, interpolation)
    return replace(draft, states=replay(plant, draft, times))


def there_and_stop(turn: float = 1.0) -> Trajectory:
    """Accelerate and brake along x by a smooth law, the thruster turned half round in between."""
    plant = FloatingRobot()
    t = np.linspace(0.0, DURATION, 601)
    s = t / DURATION
    second = (60 * s - 180 * s**2 + 120 * s**3) / DURATION**2
    alpha = np.interp(t, DURATION / 2 + np.array([-1.25, 1.25]), [0.0, math.pi])
    rate = np.gradient(alpha - turn * (10 * s**3 - 15 * s**4 + 6 * s**5), t)
    push = plant.mass * np.maximum(second * np.cos(alpha), 0.0)
    return trajectory(t, np.stack([push, rate, plant.inertia * turn * second], axis=1), 'linear')


def burn_coast_burn() -> Trajectory:
    """Burn for 1 s along x, coast for 25 s, the thruster turning half round, and brake for 1 s."""
    controls = np.zeros((6, 3))
    controls[[0, 4], 0] = 0.9 * SLOW['limits__thrust']
    controls[2, 1] = 0.4
    times = np.array([0.0, 1.0, 10.0, 10.0 + math.pi / 0.4, 26.0, 27.0])
    return trajectory(times, controls, 'zero_order_hold')


def test_the_burns_of_a_plan_that_coasts_are_found() -> None:
    tracker = robot(burn_coast_burn().states[0], **SLOW).tracker
    burns = finished(tracker.prepare(burn_coast_burn())).burns
    assert burns == pytest.approx(np.array([[0, 1], [26, 27]]))
    assert finished(tracker.prepare(there_and_stop())).burns is None


@pytest.fixture(scope='module')
def plan() -> Trajectory:
    return there_and_stop()


def away(loop: Loop, plan: Trajectory) -> float:
    return math.hypot(*(loop.plant.state[:2] - plan.states[-1, :2]))


def followed(loop: Loop, plan: Trajectory) -> Loop:
    loop.begin(plan, 0.2)
    begun = len(loop.states)
    loop.run(plan.duration + 0.14)
    times = loop.tick * (np.arange(begun, len(loop.states)) + 1) - 0.2
    offset = np.array(loop.states[begun:])[:, :2] - plan.sample(times).state[:, :2]
    assert np.hypot(*offset.T).max() < 0.01
    return loop


def test_a_wrong_and_noisy_robot_arrives_and_keeps_its_station_without_chatter(plan):
    loop = followed(Loop(robot(plan.states[0], mismatch=0.05, noise=1.0)), plan).run(8.0)
    assert (loop.tracker.phase, loop.tracker.current.reached) == (Phase.HOLDING, True)
    late = np.array(loop.states[-200:])
    assert np.hypot(*(late[:, :2] - plan.states[-1, :2]).T).max() < 0.02
    assert np.abs(late[:, 4] - plan.states[-1, 4]).max() < 0.03
    loop.run(20.0)
    assert np.mean(np.abs(loop.controls[-1000:, 1]) > 0.1) < 0.3
    assert np.mean(loop.controls[-1000:, 0] > 0.0) < 0.1
    loop.push(0.0, 0.0, 0.02, 0.02, 0.0, 0.0, 0.0)
    loop.run(20.0)
    assert loop.tracker.phase is Phase.HOLDING
    assert away(loop, plan) < 0.02
    assert np.mean(loop.controls[-150:, 0] > 0) < 0.3
    assert (loop.controls >= [0.0, -RATE, -TORQUE]).all()
    assert (loop.controls <= [THRUST, RATE, TORQUE]).all()


def test_a_coast_is_corrected_once_and_a_slow_thruster_does_not_chase_its_error() -> None:
    plan = burn_coast_burn()
    loop = followed(Loop(robot(plan.states[0], mismatch=0.05, noise=1.0, **SLOW)), plan)
    assert loop.tick * loop.controls[:, 0].sum() < 1.1 * 2.0 * plan.controls[0, 0]
    loop.run(8.0)
    assert loop.tracker.phase is Phase.HOLDING
    late = np.array(loop.states[-400:])
    assert np.hypot(*(late[:, :2] - plan.states[-1, :2]).T).max() < 0.01


@pytest.mark.parametrize('before', [4.0, 9.0])
def test_the_thruster_is_back_in_time_for_the_burn_that_brakes(before: float) -> None:
    """A correction turns it by a right angle and back, which takes 2 pi s."""
    plan = burn_coast_burn()
    loop = Loop(robot(plan.states[0], **SLOW)).begin(plan).run(26.0 - before)
    loop.push(*(0.05 * np.eye(7)[1]))
    braking = loop.run(before).tracker.error(loop.plant.state, plan.sample(26.0).state)
    assert abs(braking[6]) < 0.4
    loop.run(30.0)
    assert away(loop, plan) < 0.02


def test_the_actuator_gains_are_found(plan: Trajectory) -> None:
    loop = Loop(robot(plan.states[0], mismatch=0.2, noise=1.0, seed=2)).begin(plan).run(DURATION)
    setup = loop.plant.setup
    true_gain = setup.gains[0] * FloatingRobot().mass / setup.plant.mass
    assert abs(true_gain - 1) > 0.05
    assert loop.tracker.estimator.predict(loop.now)[7] == pytest.approx(true_gain, abs=0.02)


@pytest.mark.parametrize(('share', 'most'), [(1.0, 0.015), (0.95, 0.02), (0.9, 0.03)])
def test_a_thruster_that_turns_more_slowly_than_told_is_seen_where_it_is(share, most) -> None:
    """By its own sensor, whatever was commanded."""
    tracker, rng = robot(np.zeros(7)).tracker, np.random.default_rng(0)
    state, tick, errors = np.zeros(7), tracker.parameters.interval, []
    noise = tracker.estimator.noise.measurement
    for now in tick * np.arange(6000):
        tracker.observe(state + noise * rng.standard_normal(7), now)
        errors.append(tracker.estimator.predict(now)[6] - state[6])
        rate = RATE * np.sign(np.sin(math.tau * now / 6.0))
        tracker.estimator.history.add(now, np.array([0.0, rate, 0.0]))
        state = state + tick * share * rate * ALPHA
    assert np.abs(errors[400:]).max() < most


def test_commands_make_up_for_the_actuator_gains(plan: Trajectory) -> None:
    tracker = robot(plan.states[0]).tracker
    motion = Motion(plan, 0.0, finished(tracker.prepare(plan)))
    state = plan.sample(2.0).state

    def command(*gains: float) -> np.ndarray:
        return tracker.track(motion, 2.0, np.array([*state, *gains])).control

    usual = command(1.0, 1.0)
    assert usual[0] > 0.1
    assert command(0.8, 1.25) / usual == pytest.approx(1.0 / np.array([0.8, 1.0, 1.25]))


def test_yaw_may_be_wrapped_and_the_thruster_whole_turns_away() -> None:
    def wrap(state: np.ndarray) -> np.ndarray:
        return np.array([*state[:4], math.remainder(state[4], math.tau), *state[5:]])

    plan = there_and_stop(turn=4.0)
    loop = Loop(robot(plan.states[0] + 4 * math.pi * ALPHA), seen_as=wrap).begin(plan, 0.2)
    loop.run(DURATION + 3.0)
    assert away(loop, plan) < 0.01
    assert abs(math.remainder(loop.plant.state[4] - plan.states[-1, 4], math.tau)) < 0.02
    assert abs(loop.plant.state[6] - plan.states[-1, 6] - 4 * math.pi) < math.pi


def test_there_is_no_thrust_while_the_direction_is_off(plan: Trajectory) -> None:
    loop = Loop(robot(plan.states[0] + math.pi * ALPHA))
    loop.tracker.observe(loop.plant.state, 0.0)
    loop.tracker.accept(plan, 0.0, 0.0)
    loop.run(2.0)
    states = np.array(loop.states)
    heading = np.cos(states[:-1, 4] + states[:-1, 6])
    off = heading < math.cos(1.1)  # the misalignment allowed is 1 rad
    assert off[:25].all()
    assert not loop.controls[1:, 0][off].any()
    assert loop.controls[-1, 0] > 0.0


@pytest.mark.parametrize('on_deviation', [False, True])
def test_a_robot_carried_away_is_given_up_and_brakes_for_a_new_plan(plan, on_deviation):
    loop = Loop(robot(plan.states[0], noise=1.0, replan__on_deviation=on_deviation))
    loop.begin(plan, 0.2)
    loop.run(3.0)
    loop.push(0.1, 0.4, 0.1, 0.1, 0.0, 0.3, 0.0)
    loop.run(0.06)
    assert not loop.tracker.wants_plan
    if not on_deviation:
        assert loop.tracker.phase is Phase.STOPPED
        assert not loop.controls[-1].any()
        with pytest.raises(TrajectoryRejected, match=r'tolerance\.start'):
            loop.tracker.accept(plan, loop.now + 1.0, loop.now)
        return
    assert loop.tracker.phase is Phase.RECOVERING
    loop.run(8.0)
    assert loop.tracker.wants_plan
    assert np.hypot(*loop.plant.state[2:4]) < 0.015
    assert not loop.controls[-1].any()


@pytest.mark.parametrize('on_deviation', [False, True])
def test_a_robot_that_does_not_reach_its_goal_has_missed_it_and_goes_on_to_hold(on_deviation):
    plan = trajectory(np.array([0.0, 2.0]), np.zeros((2, 3)), 'zero_order_hold')
    wanted = replace(plan, states=plan.states + np.linspace(0.0, 0.24, 2)[:, None] * np.eye(7)[0])
    loop = Loop(robot(plan.states[0], replan__on_deviation=on_deviation))
    weak = loop.plant.setup.limits * [1e-9, 1.0, 1.0]
    loop.plant.setup = replace(loop.plant.setup, limits=weak)
    loop.begin(wanted, 0.2)
    loop.run(1.8 + loop.tracker.settling)
    assert (loop.tracker.phase, loop.tracker.current.reached) == (Phase.HOLDING, None)
    loop.run(0.5)
    assert 'the goal was not reached 8 s after the plan ended' in loop.commands[-1].problem
    if on_deviation:
        assert loop.tracker.phase is Phase.RECOVERING
    else:
        assert (loop.tracker.phase, loop.tracker.current.reached) == (Phase.HOLDING, False)


def test_a_slow_thruster_has_the_time_it_takes_to_reach_the_goal(plan: Trajectory) -> None:
    plan = trajectory(np.array([0.0, 2.0]), np.zeros((2, 3)), 'zero_order_hold')
    loop = Loop(robot(plan.states[0], mismatch=0.05, noise=1.0, **SLOW)).begin(plan).run(2.0)
    loop.push(0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    loop.run(10.0)
    assert loop.tracker.current.reached is None
    loop.run(loop.tracker.settling - 10.0)
    assert loop.tracker.current.reached


def test_the_thruster_turns_before_the_start_and_nothing_is_fired(plan: Trajectory) -> None:
    loop = Loop(robot(plan.states[0] + 1.5 * ALPHA)).begin(plan, 2.0).run(1.8)
    assert loop.plant.state[6] == pytest.approx(plan.states[0, 6], abs=0.02)
    assert not loop.controls[:, [0, 2]].any()
