# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The pendulum's tracker in closed loop, and what every tracker does with what it is sent."""

from dataclasses import replace
import math
from unittest.mock import Mock

from benchmark.rigs import rig
from closed_loop import HANGING, Loop, moved, pendulum, pendulum_tracker, STRONG, swing_up, WEAK
from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.arrays import wrapped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.tracking.motion import Phase, TrajectoryRejected
from tdm_planner.tracking.pendulum_tracking import EstimatedPendulum, PendulumTracker
from tdm_planner.trajectory import Trajectory

STRONGLY = {'limits.torque': STRONG, 'torque_reserve': 0.2}


@pytest.fixture(scope='module')
def plan() -> Trajectory:
    """Return a swing-up in less than half a second, with torque kept for the feedback."""
    return build(PendulumSwingUp, STRONGLY).solve(deadline=10.0).trajectory


@pytest.fixture
def loop(plan: Trajectory) -> Loop:
    return Loop(pendulum(pendulum_tracker())).begin(plan)


def held(loop: Loop, run: float, last: float = 0.5) -> bool:
    loop.run(run)
    count = round(last / loop.tick)
    return loop.upright(last) and np.abs(np.array(loop.states[-count:])[:, 1]).max() < 2.0


def seeing(state: np.ndarray = HANGING, at: float = 0.0, **values) -> PendulumTracker:
    tracker = pendulum_tracker(**values)
    tracker.observe(state, at)
    return tracker


@pytest.mark.parametrize('limit', [WEAK, STRONG])
def test_the_plan_is_followed_to_its_end(plan: Trajectory, limit: float) -> None:
    if limit == WEAK:
        plan = swing_up().solution.trajectory
    loop = Loop(pendulum(pendulum_tracker(limit))).begin(plan)
    while loop.now < 0.1 + plan.duration - loop.tick:
        loop.run(loop.tick)
        assert loop.tracker.phase is not Phase.HOLDING
    miss = loop.plant.state - plan.sample(loop.now - 0.1).state
    assert np.abs(miss[:2]).max() < 0.01
    assert np.abs(miss[2:]).max() < 0.1
    assert held(loop, 0.01 + loop.tick, loop.tick)


def test_a_plan_that_began_late_ends_in_time() -> None:
    plan = swing_up().solution.trajectory
    loop = Loop(pendulum(pendulum_tracker(WEAK)), late=0.003).begin(plan)
    lateness = []
    while loop.now < 0.1 + plan.duration - loop.tick:
        loop.run(loop.tick)
        lateness.append(loop.tracker.newest.late)
    assert max(lateness) > 5e-4
    assert abs(lateness[-1]) < 1e-4


@pytest.mark.parametrize('ahead', [0.1, 0.5, 0.9])
def test_a_start_between_two_commands_loses_no_torque(plan: Trajectory, ahead: float) -> None:
    loop = Loop(pendulum(pendulum_tracker()))
    start = 0.1 - ahead * loop.tick
    loop.begin(plan, start).run(0.1 + loop.tick - loop.now)
    assert (np.flatnonzero(loop.controls) * loop.tick)[0] == pytest.approx(0.1 - loop.tick)
    wanted = plan.control_integral(plan.times[0] + loop.now - start)
    assert loop.controls.sum() * loop.tick == pytest.approx(float(wanted[0]), rel=0.02)


def test_where_the_plan_is_lost_upright_is_held_if_it_can_be(plan: Trajectory, loop: Loop) -> None:
    loop.run(0.3)
    assert loop.tracker.phase is Phase.TRACKING
    away = plan.sample(loop.now - 0.1).state[0]
    assert abs(away) > loop.tracker.parameters.tolerance.path
    loop.plant.push(lambda state: 0.0 * state)
    loop.run(0.05)
    assert (loop.tracker.phase, loop.tracker.current.reached) == (Phase.HOLDING, True)
    assert held(loop, 0.5, 0.3)


def test_a_known_delay_is_compensated(plan: Trajectory, loop: Loop) -> None:
    late = Loop(pendulum(pendulum_tracker()), delay=4).begin(plan)
    assert held(loop, 1.5)
    assert held(late, 1.5)
    # with a perfect model the delayed loop sends the same commands
    assert np.abs(late.controls - loop.controls)[:100].max() < 0.01 * STRONG


@pytest.mark.parametrize('mismatch', [0.0, 0.05])
def test_a_delay_of_commands_that_nobody_told_of_is_found(plan: Trajectory, mismatch: float):
    late = 0.004
    tracker = pendulum_tracker()
    loop = Loop(pendulum(tracker, mismatch=mismatch, noise=1.0), late=late).begin(plan)
    loop.run(plan.duration + 0.1)
    found = tracker.estimator.delay
    assert found == pytest.approx(late, abs=5e-4)
    assert held(loop, 1.5)
    assert tracker.estimator.delay == found  # about upright friction would be taken for a delay
    again, told = pendulum_tracker(weights__torque=3.0), pendulum_tracker(command_delay=0.002)
    for changed in (again, told):
        changed.adopt(tracker)
    assert again.estimator.delay == tracker.estimator.delay
    assert told.estimator.delay == 0.002


@pytest.mark.parametrize(('wraps', 'turns'), [(True, 0), (False, 3), (True, -2)])
def test_theta_may_be_wrapped_or_turns_away(plan: Trajectory, wraps: bool, turns: int) -> None:
    start = moved(HANGING, math.tau * turns, 0.0, 0.0, 0.0)
    loop = Loop(pendulum(pendulum_tracker(), start, noise=1.0))
    if wraps:
        loop.seen_as = lambda x: np.array([wrapped(x[0]), *x[1:]])
    loop.begin(plan)
    assert held(loop, 1.4)


def test_the_hold_outlasts_a_refusal_and_ends_with_a_push_until_the_next_plan(plan, loop):
    loop.run(1.2)
    assert loop.tracker.phase is Phase.HOLDING
    with pytest.raises(TrajectoryRejected):
        loop.tracker.accept(plan, loop.now + 0.2, loop.now)
    assert held(loop, 0.5)
    loop.push(0.0, 0.0, 40.0, 0.0)
    loop.run(0.5)
    assert loop.tracker.phase is Phase.STOPPED
    assert 'away from the goal' in loop.commands[-1].problem
    assert not loop.commands[-1].control.any()
    loop.plant.reset()
    loop.begin(replace(plan))
    assert held(loop, 1.4)


def test_refusals_name_what_is_wrong(plan: Trajectory) -> None:
    tracker = seeing(at=100.0)
    wild = plan.states.copy()
    wild[5:, 2:] = 1e200
    for refused, start, words in (
        (plan, 100.0 - plan.duration, 'past'),
        (plan, 100.0 - 86400.0, 'past'),
        (plan, math.nan, 'past'),
        (plan, 100.0 + 7201.0, 'starts in 7.2e.03 s: must not be more than 7200 s'),
        (replace(plan, times=1e4 * plan.times), 101.0, 'lasts .* more than 3600 s'),
        (replace(plan, states=wild), 100.1, 'must not be beyond'),
        (replace(plan, states=moved(plan.states, 1.0, 0, 0, 0)), 105.0, r'tolerance\.start'),
        (plan, 100.0 - 0.9 * plan.duration, r'tolerance\.path'),
    ):
        with np.errstate(all='ignore'), pytest.raises(TrajectoryRejected, match=words):
            tracker.accept(refused, start, 100.0)
        assert tracker.phase is Phase.IDLE
        assert not tracker.command(100.0).control.any()


def test_a_trajectory_under_way_is_joined_and_changed_parameters_act_without_a_jump(plan, loop):
    loop.run(0.2)
    loop.tracker = seeing(loop.plant.measure(), loop.now)
    loop.tracker.accept(plan, 0.1, loop.now)
    loop.run(0.1)
    assert loop.tracker.phase is Phase.TRACKING
    changed = pendulum_tracker(weights__torque=1.0)
    changed.adopt(loop.tracker)
    loop.tracker = changed
    assert held(loop, 1.2)
    assert loop.tracker.phase is Phase.HOLDING


def test_old_states_switch_the_torque_off_until_they_return(plan: Trajectory) -> None:
    tracker = pendulum_tracker(state_timeout=0.05)
    assert 'no state' in tracker.command(0.0).problem
    loop = Loop(pendulum(tracker)).begin(plan).run(1.0)
    last = loop.now - loop.tick
    assert all(tracker.command(t).action is not None for t in (loop.now, last + 0.0499))
    late = tracker.command(last + 0.0501)
    assert late.action is None
    assert not late.control.any()
    assert 'state_timeout' in late.problem
    tracker.observe(loop.plant.state, last + 0.06)
    back = tracker.command(last + 0.06)
    assert (back.action is not None, back.problem) == (True, '')


def test_a_state_that_cannot_be_estimated_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until so much time has passed without as a state may be old."""
    tracker = pendulum_tracker()
    told = 'the estimate of the state broke down (Singular matrix) and begins anew'

    def breaks(state: np.ndarray, stamp: float) -> None:
        monkeypatch.undo()
        raise np.linalg.LinAlgError('Singular\nmatrix')

    monkeypatch.setattr(tracker.estimator, 'observe', breaks)
    later = tracker.parameters.state_timeout + 0.002
    for at, problem in ((0.0, told), (0.005, told), (later, '')):
        tracker.observe(HANGING, at)
        assert tracker.command(at + 0.001 * (at < later)).problem == problem
    assert tracker.phase is Phase.IDLE


def test_a_state_that_is_not_finite_is_not_followed(loop: Loop, monkeypatch) -> None:
    loop.run(0.2)
    monkeypatch.setattr(loop.tracker.estimator, 'move', lambda *_: np.full(9, np.nan))
    loop.tracker.accept(loop.tracker.current.trajectory, loop.now + 1.0, loop.now)
    command = loop.tracker.command(loop.now)
    assert (command.control, command.phase) == (0.0, Phase.STOPPED)
    assert command.problem == 'the feedback broke down: the estimated state is not finite'


@given(
    seed=st.integers(0, 10_000),
    gains=st.tuples(*[st.floats(0.8, 1.2)] * 7),
    theta=st.floats(-math.pi, math.pi),
)
@example(60017, (1.0, 1.05, *[1.0] * 5), 0.0)  # the arm has all but 3 % of the disk's inertia
def test_a_torque_turns_the_disk_its_way_whatever_is_estimated_of_the_rig(seed, gains, theta):
    k = rig(seed).plant.coefficients
    forward, backward = (
        EstimatedPendulum.equations(k, (theta, 0.0, 0.0, 0.0, *gains), (torque,))[3]
        for torque in (k.gravity, -k.gravity)
    )
    assert math.isfinite(forward)
    assert forward > backward


@pytest.mark.parametrize('to', [-50.0, 1e6])
def test_a_clock_that_is_set_stops_the_motion(plan: Trajectory, loop: Loop, to: float) -> None:
    loop.run(0.2)
    assert loop.tracker.phase is Phase.TRACKING
    command = loop.tracker.command(to)  # before the first state of the new time
    assert not command.control.any()
    assert ('the clock was set back' in command.problem) == (to < 0.0)
    loop.tracker.observe(HANGING, to + 0.01)
    command = loop.tracker.command(to + 0.01)
    assert command.phase is Phase.STOPPED
    assert not command.control.any()
    assert ('clock' in command.problem) == (to < 0.0)
    loop.tracker.accept(plan, to + 0.5, to + 0.01)
    assert loop.tracker.phase is Phase.WAITING
    loop.tracker.observe(moved(HANGING, 0.5, 0.0, 0.0, 0.0), to + 0.5)
    command = loop.tracker.command(to + 0.5)
    assert command.phase is Phase.STOPPED
    assert 'tolerance.start' in command.problem


def test_what_was_told_before_the_clock_was_set_back_is_not_told_for_ever(monkeypatch) -> None:
    tracker = pendulum_tracker()
    tracker.observe(HANGING, 50.0)
    with monkeypatch.context() as patch:
        patch.setattr(tracker.estimator, 'observe', Mock(side_effect=FloatingPointError('so')))
        tracker.observe(HANGING, 50.005)
    assert 'broke down' in tracker.command(50.01).problem
    tracker.command(1.0)
    tracker.observe(HANGING, 1.005)
    assert not tracker.command(1.01).problem


def test_a_recovery_ends_when_it_is_not_wanted_any_more() -> None:
    swinging = seeing(np.array([math.pi - 1.0, 0.0, 4.0, 0.0]), replan__on_deviation=True)
    swinging.abort('it was pushed')
    assert swinging.command(0.005).phase is Phase.RECOVERING
    changed = pendulum_tracker(replan__on_deviation=False)
    changed.adopt(swinging)
    command = changed.command(0.01)
    assert (command.phase, command.problem) == (Phase.STOPPED, 'it was pushed')
    assert command.control == 0.0


def test_a_stuck_sensor_switches_the_torque_off_and_stays_stuck_for_other_parameters() -> None:
    tracker = pendulum_tracker(replan__on_deviation=True)
    tracker.phase = Phase.RECOVERING
    problems = []
    for k in range(65):
        if k == 60:
            changed = pendulum_tracker(replan__on_deviation=True, weights__torque=2.0)
            changed.adopt(tracker)
            tracker = changed
        tracker.observe(moved(HANGING, 0.0, 0.8, 0.0, 0.0), 0.005 * k)
        command = tracker.command(0.005 * k)
        problems.append('sensor stuck' in command.problem)
        assert bool(command.control.any()) != problems[-1]
    assert not problems[5]
    assert all(problems[25:])


@pytest.mark.parametrize('push', [30.0, -60.0])
def test_where_a_new_plan_is_wanted_the_pendulum_is_brought_to_rest(plan, push):
    tracker = pendulum_tracker(replan__on_deviation=True)
    loop = Loop(pendulum(tracker, mismatch=0.05, noise=1.0)).begin(plan).run(1.0)
    loop.push(0.0, 0.0, push, 0.0)
    loop.run(0.3)
    assert tracker.phase is Phase.RECOVERING
    assert not tracker.wants_plan
    assert 'away from the goal' in loop.commands[-1].problem
    while not tracker.wants_plan:
        loop.run(loop.tick)
        assert loop.now < 10.0
    assert not loop.commands[-1].control.any()
    start = tracker.estimator.predict(loop.now + 0.5)[:4]
    values = {f'start.{n}': x for n, x in zip(plan.state_names, start.tolist(), strict=True)}
    new = build(PendulumSwingUp, {**STRONGLY, **values}).solve(deadline=10.0)
    tracker.accept(new.trajectory, loop.now + 0.5, loop.now)
    assert held(loop, 2.0)
    assert tracker.phase is Phase.HOLDING


LATELY = [(since, True, Phase.RECOVERING) for since in (0.3, 2.0, 9.0)]
OTHERWISE = [(0.3, False, Phase.IDLE), *((s, True, Phase.IDLE) for s in (86400.0, -0.5, -5.0))]


@pytest.mark.parametrize(('since', 'on_deviation', 'phase'), LATELY + OTHERWISE)
def test_a_restarted_tracker_recovers_if_a_plan_began_lately(plan, since, on_deviation, phase):
    """A plan that it refuses, and that began `since` s ago or begins later on."""
    tracker = seeing(at=100.0, replan__on_deviation=on_deviation)
    if since < 0.0:
        plan = replace(plan, states=moved(plan.states, 1.0, 0.0, 0.0, 0.0))
    with pytest.raises(TrajectoryRejected):
        tracker.accept(plan, 100.0 - since, 100.0)
    assert tracker.phase is phase
    command = tracker.command(100.01)
    assert command.phase is phase
    assert not command.control.any()
    assert tracker.wants_plan == (phase is Phase.RECOVERING)


def test_a_plan_that_is_repeated_is_recognised_and_needs_a_feedback(plan: Trajectory) -> None:
    tracker = seeing(at=100.0)
    tracker.accept(plan, 101.0, 100.0)
    assert tracker.newest.is_of(replace(plan, states=plan.states + 1e-13))
    assert not tracker.newest.is_of(replace(plan, controls=0.5 * plan.controls))
    assert tracker.newest.start == 101.0
    with pytest.raises(InvalidProblem, match='no feedback'):
        pendulum_tracker(plant__gravity=1e9).adopt(tracker)


def test_commands_are_computed_for_when_they_act(plan: Trajectory) -> None:
    """Where a command takes a while, the plan is played so much earlier."""
    acting = []
    for delay in (0.0, 0.05):
        tracker = seeing(command_delay=delay)
        tracker.accept(plan, 0.05, 0.0)
        acting.append(tracker.command(0.05 - delay).action.control)
    np.testing.assert_allclose(*acting, atol=1e-3 * STRONG)
    assert acting[0].any()


def test_the_start_is_compared_with_the_propagated_state(plan: Trajectory) -> None:
    tracker = seeing(moved(HANGING, 0.05, 0.0, 0.0, 0.0), tolerance__start=0.02)
    at_start = tracker.estimator.predict(0.3)[:4]
    assert abs(at_start[0] - HANGING[0] - 0.05) > 0.03  # it swings meanwhile
    away = (at_start - plan.states[0]) * [1, 1, 0, 0]
    tracker.accept(replace(plan, states=plan.states + away, rates=None), 0.3, 0.0)
    assert tracker.phase is Phase.WAITING


@pytest.mark.parametrize('theta', [math.pi, -math.pi])
def test_after_a_plan_that_ends_hanging_the_disk_is_held_and_the_pendulum_hangs(theta) -> None:
    """As the first trajectory that one sends to a tracker by hand: it rests."""
    states = np.tile([theta, 0.3, 0.0, 0.0], (2, 1))
    rest = Trajectory.of(
        RotaryPendulum(), np.array([0.0, 1.0]), states, np.zeros((2, 1)), 'zero_order_hold'
    )
    start = moved(states[0], 0.05, 0.1, 0.0, 0.0)
    loop = Loop(pendulum(pendulum_tracker(), start)).begin(rest)
    loop.run(4.0)
    assert (loop.tracker.phase, loop.tracker.current.reached) == (Phase.HOLDING, True)
    assert np.abs(loop.plant.state - states[0]).max() < 0.05
