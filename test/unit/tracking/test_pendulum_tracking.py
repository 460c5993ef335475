# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import math

import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.tracker import Phase, TrajectoryRefused, wrapped
from tdm_planner.trajectory import Trajectory
from tdm_sim.mismatch import mismatched
from tdm_sim.simulation import PlantSetup, SimulatedPlant

LIMIT = 0.09
TICK = 0.005


@pytest.fixture(scope='module')
def plan() -> Trajectory:
    values = {'limits.torque': LIMIT, 'torque_reserve': 0.2}
    return build(PendulumSwingUp, values).solve(deadline=10.0).trajectory


def make_tracker(**values: float) -> PendulumTracker:
    dotted = {name.replace('__', '.'): value for name, value in values.items()}
    return PendulumTracker(build(PendulumTrackerParameters, {'limits.torque': LIMIT, **dotted}))


@dataclass
class Loop:
    """A tracker and a plant stepped together; `delay` s pass before a state is seen."""

    tracker: PendulumTracker
    initial: np.ndarray
    mismatch: float = 0.0
    noise: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    delay: int = 0
    seen_as: Callable[[np.ndarray], np.ndarray] = staticmethod(lambda x: x)
    states: list[np.ndarray] = field(default_factory=list)
    commands: list = field(default_factory=list)

    def __post_init__(self) -> None:
        a, r = self.noise
        limit = np.array([LIMIT])
        setup = PlantSetup(
            mismatched(self.tracker.parameters.plant, self.mismatch, self.seed),
            self.initial,
            -limit,
            limit,
            np.array([a, a, r, r]),
        )
        self.plant = SimulatedPlant(setup, self.seed)
        self.samples: list[tuple[np.ndarray, float]] = []

    @property
    def now(self) -> float:
        return len(self.states) * TICK

    def run(self, duration: float) -> None:
        for _ in range(round(duration / TICK)):
            now = self.now
            self.samples.append((self.plant.measure(), now))
            if len(self.samples) > self.delay:
                state, stamp = self.samples[-1 - self.delay]
                self.tracker.observe(self.seen_as(state), stamp)
            self.commands.append(self.tracker.command(now))
            self.plant.command(self.commands[-1].control)
            self.plant.step(TICK)
            self.states.append(self.plant.state)

    def held(self, duration: float) -> bool:
        count = round(duration / TICK)
        states = np.array(self.states)[-count:]
        upright = np.abs(wrapped(states[:, 0])).max() < 0.05
        return bool(upright and np.abs(states[:, 1]).max() < 2.0)


def hanging() -> np.ndarray:
    return np.array([math.pi, 0.0, 0.0, 0.0])


@pytest.mark.parametrize('seed', range(4))
def test_a_mismatched_noisy_pendulum_is_caught_and_held(plan: Trajectory, seed: int) -> None:
    loop = Loop(make_tracker(), hanging(), mismatch=0.05, noise=(0.0015, 0.1), seed=seed)
    loop.run(0.1)
    loop.tracker.accept(plan, 0.3, loop.now)
    assert loop.tracker.phase is Phase.WAITING
    loop.run(3.0)
    assert loop.tracker.phase is Phase.HOLDING
    assert loop.held(1.5)
    torque = np.array([c.control[0] for c in loop.commands])
    assert np.abs(torque).max() <= LIMIT
    assert not torque[:60].any()  # nothing before the start


def test_without_errors_the_feedback_has_little_to_do(plan: Trajectory) -> None:
    loop = Loop(make_tracker(), hanging())
    loop.tracker.observe(hanging(), 0.0)
    loop.tracker.accept(plan, 0.0125, 0.0)  # the start does not fall on a tick
    loop.run(0.35)
    feedback = [c.action.feedback[0] for c in loop.commands if c.action]
    assert len(feedback) == 67
    assert np.abs(feedback).max() < 0.15 * LIMIT


def test_a_known_delay_is_compensated(plan: Trajectory) -> None:
    for delay in (0, 4):
        loop = Loop(make_tracker(), hanging(), delay=delay)
        loop.run(0.05)
        loop.tracker.accept(plan, 0.1, loop.now)
        loop.run(3.0)
        assert loop.held(1.5)
        reference = np.array([c.control[0] for c in loop.commands])
        if delay == 0:
            exact = reference
    # with a perfect model the delayed loop sends the same commands
    assert np.abs(reference - exact)[:100].max() < 0.01 * LIMIT


def test_theta_may_be_wrapped_or_turns_away(plan: Trajectory) -> None:
    def wrap(state: np.ndarray) -> np.ndarray:
        return np.concatenate([[math.remainder(state[0], math.tau)], state[1:]])

    for seen_as, turns in ((wrap, 0), (lambda x: x, 3), (wrap, -2)):
        start = hanging() + np.array([math.tau * turns, 0, 0, 0])
        loop = Loop(make_tracker(), start, noise=(0.0015, 0.1), seen_as=seen_as)
        loop.run(0.05)
        loop.tracker.accept(plan, 0.1, loop.now)
        loop.run(2.0)
        assert loop.held(1.0)


def test_a_push_beyond_the_tolerance_stops_the_motion(plan: Trajectory) -> None:
    loop = Loop(make_tracker(), hanging())
    loop.run(0.05)
    loop.tracker.accept(plan, 0.1, loop.now)
    loop.run(2.0)
    assert loop.held(0.5)
    loop.plant.push(lambda x: x + np.array([0.0, 0.0, 40.0, 0.0]))
    loop.run(0.5)
    assert loop.tracker.phase is Phase.STOPPED
    assert 'away from the goal' in loop.commands[-1].problem
    assert not loop.commands[-1].control.any()
    # the next trajectory is taken
    again = Trajectory(
        plan.times,
        plan.states,
        plan.controls,
        plan.state_names,
        plan.control_names,
        plan.interpolation,
    )
    loop.plant.reset()
    loop.run(0.05)
    loop.tracker.accept(again, loop.now + 0.1, loop.now)
    loop.run(2.0)
    assert loop.held(0.5)


def test_refusals_name_what_is_wrong(plan: Trajectory) -> None:
    tracker = make_tracker()
    tracker.observe(hanging(), 100.0)
    with pytest.raises(TrajectoryRefused, match='past'):
        tracker.accept(plan, 100.0 - plan.duration, 100.0)
    with pytest.raises(TrajectoryRefused, match='past'):
        tracker.accept(plan, math.nan, 100.0)
    names = ('a', 'b', 'c', 'd')
    other = Trajectory(plan.times, plan.states, plan.controls, names, ('torque',))
    with pytest.raises(TrajectoryRefused, match='expected theta, psi'):
        tracker.accept(other, 101.0, 100.0)
    tracker.observe(np.array([2.0, 0.0, 0.0, 0.0]), 101.0)
    with pytest.raises(TrajectoryRefused, match=r'tolerance\.start'):
        tracker.accept(plan, 101.005, 101.0)
    assert tracker.phase is Phase.IDLE
    with pytest.raises(TrajectoryRefused, match=r'tolerance\.path'):
        tracker.accept(plan, 101.0 - 0.9 * plan.duration, 101.0)


def test_the_start_is_compared_with_the_propagated_state(plan: Trajectory) -> None:
    tracker = make_tracker(tolerance__start=0.02)
    state = hanging() + np.array([0.05, 0.0, 0.0, 0.0])
    tracker.observe(state, 0.0)
    at_start = tracker.estimator.predict(0.3)
    assert abs(at_start[0] - state[0]) > 0.03  # it swings meanwhile
    moving = Trajectory(
        plan.times,
        plan.states + (at_start - plan.states[0]) * [1, 1, 0, 0],
        plan.controls,
        plan.state_names,
        plan.control_names,
    )
    tracker.accept(moving, 0.3, 0.0)
    assert tracker.phase is Phase.WAITING


def test_the_trajectory_in_force_stays_when_the_next_is_refused(plan: Trajectory) -> None:
    loop = Loop(make_tracker(), hanging())
    loop.run(0.05)
    loop.tracker.accept(plan, 0.1, loop.now)
    loop.run(1.5)
    assert loop.tracker.phase is Phase.HOLDING
    with pytest.raises(TrajectoryRefused):
        loop.tracker.accept(plan, loop.now + 0.2, loop.now)
    loop.run(1.0)
    assert loop.tracker.phase is Phase.HOLDING
    assert loop.held(1.0)


def test_a_trajectory_under_way_is_joined(plan: Trajectory) -> None:
    first = Loop(make_tracker(), hanging())
    first.run(0.05)
    first.tracker.accept(plan, 0.05, first.now)
    first.run(0.5 * plan.duration)
    # a new tracker takes over in the middle
    first.tracker = make_tracker()
    first.tracker.observe(first.plant.measure(), first.now)
    first.tracker.accept(plan, 0.05, first.now)
    first.run(2.0)
    assert first.held(1.0)


def test_old_states_switch_the_torque_off_until_they_return(plan: Trajectory) -> None:
    tracker = make_tracker(state_timeout=0.05)
    assert 'no state' in tracker.command(0.0).problem
    loop = Loop(tracker, hanging())
    loop.run(0.05)
    tracker.accept(plan, 0.1, loop.now)
    loop.run(2.0)
    last = loop.now - TICK
    held = tracker.command(loop.now)
    assert held.action is not None
    late = tracker.command(last + 0.06)
    assert late.action is None
    assert not late.control.any()
    assert 'state_timeout' in late.problem
    tracker.observe(loop.plant.state, last + 0.07)
    back = tracker.command(last + 0.07)
    assert back.action is not None
    assert not back.problem


def test_a_state_that_cannot_be_estimated_is_told() -> None:
    """Until so much time has passed without as a state may be old."""
    tracker = make_tracker()

    def breaks(state: np.ndarray, stamp: float) -> None:
        raise np.linalg.LinAlgError('Singular\nmatrix')

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracker.estimator, 'observe', breaks)
        tracker.observe(hanging(), 0.0)
    told = 'the estimate of the state broke down (Singular matrix) and begins anew'
    assert tracker.command(0.001).problem == told
    tracker.observe(hanging(), 0.005)
    assert tracker.command(0.006).problem == told
    later = tracker.parameters.state_timeout + 0.002
    tracker.observe(hanging(), later)
    assert not tracker.command(later).problem
    assert tracker.phase is Phase.IDLE


def test_a_clock_set_back_stops_the_motion(plan: Trajectory) -> None:
    loop = Loop(make_tracker(), hanging())
    loop.run(0.05)
    loop.tracker.accept(plan, 0.1, loop.now)
    loop.run(0.2)
    assert loop.tracker.phase is Phase.TRACKING
    command = loop.tracker.command(-50.0)
    assert command.phase is Phase.STOPPED
    assert not command.control.any()
    loop.tracker.observe(hanging(), -49.0)
    command = loop.tracker.command(-49.0)
    assert 'clock' in command.problem
    loop.tracker.accept(plan, -48.5, -49.0)
    assert loop.tracker.phase is Phase.WAITING


def test_a_clock_set_forward_is_survived(plan: Trajectory) -> None:
    loop = Loop(make_tracker(), hanging())
    loop.run(0.05)
    loop.tracker.accept(plan, 0.1, loop.now)
    loop.run(0.2)
    assert not loop.tracker.command(1e6).control.any()
    loop.tracker.observe(hanging(), 1e6 + 0.01)
    command = loop.tracker.command(1e6 + 0.01)
    assert command.phase is Phase.STOPPED
    assert not command.control.any()


def test_a_state_that_has_left_before_the_start_stops_the_motion(plan: Trajectory) -> None:
    loop = Loop(make_tracker(), hanging())
    loop.run(0.05)
    loop.tracker.accept(plan, 0.2, loop.now)
    loop.plant.push(lambda x: x + np.array([0.0, 0.0, 10.0, 0.0]))
    loop.run(0.3)
    assert loop.tracker.phase is Phase.STOPPED
    assert 'tolerance.start' in loop.commands[-1].problem


def test_changed_parameters_act_without_a_jump(plan: Trajectory) -> None:
    loop = Loop(make_tracker(), hanging())
    loop.run(0.05)
    loop.tracker.accept(plan, 0.1, loop.now)
    loop.run(0.3)
    changed = make_tracker(weights__torque=1.0)
    changed.adopt(loop.tracker)
    loop.tracker = changed
    loop.run(2.0)
    assert loop.tracker.phase is Phase.HOLDING
    assert loop.held(1.0)


def test_a_recovery_ends_when_it_is_not_wanted_any_more() -> None:
    swinging = make_tracker(replan__on_deviation=True)
    swinging.observe(np.array([math.pi - 1.0, 0.0, 4.0, 0.0]), 0.0)
    swinging.give_up('it was pushed')
    assert swinging.command(0.005).phase is Phase.RECOVERING
    changed = make_tracker(replan__on_deviation=False)
    changed.adopt(swinging)
    command = changed.command(0.01)
    assert command.phase is Phase.STOPPED
    assert command.control == 0.0
    assert command.problem == 'it was pushed'


def test_parameters_that_give_no_feedback_along_the_plan_are_refused(plan: Trajectory) -> None:
    tracker = make_tracker()
    tracker.observe(plan.states[0], 0.0)
    tracker.accept(plan, 0.1, 0.01)
    with pytest.raises(TrajectoryRefused, match='no feedback'):
        make_tracker(plant__com_distance=10.0).adopt(tracker)


def test_changed_parameters_leave_a_stuck_sensor_stuck() -> None:
    tracker = make_tracker(replan__on_deviation=True)
    tracker.phase = Phase.RECOVERING
    state = hanging() + np.array([0.0, 0.8, 0.0, 0.0])
    for k in range(60):
        tracker.observe(state, 0.005 * k)
        command = tracker.command(0.005 * k)
    assert 'sensor stuck' in command.problem
    changed = make_tracker(replan__on_deviation=True, weights__torque=2.0)
    changed.adopt(tracker)
    for k in range(60, 65):
        changed.observe(state, 0.005 * k)
        command = changed.command(0.005 * k)
        assert 'sensor stuck' in command.problem
        assert not command.control.any()


def test_a_trajectory_no_feedback_can_follow_is_refused(plan: Trajectory) -> None:
    wild = plan.states.copy()
    wild[5:, 2:] = 1e200
    tracker = make_tracker()
    tracker.observe(hanging(), 0.0)
    absurd = Trajectory(plan.times, wild, plan.controls, plan.state_names, plan.control_names)
    words = 'feedback along|must not be beyond'
    with np.errstate(all='ignore'), pytest.raises(TrajectoryRefused, match=words):
        tracker.accept(absurd, 0.1, 0.0)
    assert tracker.phase is Phase.IDLE


def test_parameters_are_checked() -> None:
    with pytest.raises(InvalidProblem, match=r'tolerance\.path'):
        make_tracker(tolerance__path=-1.0)
    with pytest.raises(InvalidProblem, match=r'weights\.torque'):
        make_tracker(weights__torque=0.0)


@pytest.mark.parametrize('push', [30.0, -60.0])
def test_where_a_new_plan_is_wanted_the_pendulum_is_brought_to_rest(
    plan: Trajectory, push: float
) -> None:
    tracker = PendulumTracker(
        build(
            PendulumTrackerParameters,
            {'limits.torque': LIMIT, 'replan.on_deviation': True},
        )
    )
    loop = Loop(tracker, hanging(), mismatch=0.05, noise=(0.0015, 0.1))
    loop.run(0.05)
    tracker.accept(plan, 0.1, loop.now)
    loop.run(1.5)
    loop.plant.push(lambda x: x + np.array([0.0, 0.0, push, 0.0]))
    loop.run(0.3)
    assert tracker.phase is Phase.RECOVERING
    assert not tracker.wants_plan
    assert 'away from the goal' in loop.commands[-1].problem
    while not tracker.wants_plan:
        loop.run(TICK)
        assert loop.now < 10.0
    assert not loop.commands[-1].control.any()
    # a plan from the state that is expected half a second later is accepted, and works
    start = tracker.estimator.predict(loop.now + 0.5)
    values = dict(zip(('theta', 'psi', 'theta_dot', 'psi_dot'), start.tolist(), strict=True))
    problem = build(
        PendulumSwingUp,
        {
            'limits.torque': LIMIT,
            'torque_reserve': 0.2,
            **{f'start.{name}': value for name, value in values.items()},
        },
    )
    tracker.accept(problem.solve(deadline=10.0).trajectory, loop.now + 0.5, loop.now)
    loop.run(3.0)
    assert tracker.phase is Phase.HOLDING
    assert loop.held(1.0)
