# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker of stated plants: which plans it takes, and by what it measures deviations."""

from collections.abc import Sequence
from dataclasses import replace
import re

from ball_and_beam import BallAndBeam
from brachistochrone import Brachistochrone
from double_integrator import CartStart, DoubleIntegrator
from moon_lander import MoonLander
import numpy as np
import pytest
from stated import Cart, changed
from tdm_planner.direct_method import Integrated
from tdm_planner.plants.base import integrate
from tdm_planner.problems import DirectProblem
from tdm_planner.tracking.estimator import STUCK
from tdm_planner.tracking.motion import Phase, TrajectoryRejected
from tdm_planner.tracking.stated_tracking import StatedTracker, StatedTrackerParameters
from tdm_planner.trajectory import Trajectory


def solved(problem: DirectProblem) -> Trajectory:
    return problem.solve(deadline=10.0).trajectory


class Rig:
    """
    A tracker and its plant, without delay, `off` the start of the problem's plan.

    Plans, the problem's unless another is given, are accepted `ahead` s before they start.
    """

    def __init__(self, problem: DirectProblem, off: Sequence[float] = (0.0,)) -> None:
        self.plan = solved(problem)
        self.tracker = StatedTracker(problem, StatedTrackerParameters())
        self.state, self.now = self.plan.states[0] + off, 0.0
        self.tracker.observe(self.state, self.now)

    def accept(self, plan: Trajectory | None = None, ahead: float = 0.0) -> None:
        self.tracker.accept(plan or self.plan, self.now + ahead, self.now)

    def follow(self, longer: float) -> None:
        """Let the plan be followed from now on, and held for so much `longer` [s]."""
        self.accept()
        self.run(self.plan.duration + longer)

    def run(self, duration: float) -> None:
        step = self.tracker.parameters.interval
        for _ in range(round(duration / step)):
            control = self.tracker.command(self.now).control
            self.state = integrate(self.tracker.plant, self.state, control, step, 1e-3)
            self.show(self.state)

    def show(self, state: np.ndarray) -> None:
        self.now += self.tracker.parameters.interval
        self.tracker.observe(state, self.now)


@pytest.mark.parametrize('kind', [BallAndBeam, DoubleIntegrator])
def test_a_plan_from_the_goal_to_the_goal_does_not_make_deviations_large(kind) -> None:
    rig = Rig(kind())
    rig.follow(2.0)
    assert rig.tracker.phase is Phase.HOLDING
    start = type(kind().start)(*rig.state.tolist())
    again = solved(kind(start=start))
    assert np.ptp(again.states[:, 0]) < 1e-3
    for _ in range(3):
        rig.accept(again, 0.5)
        rig.run(1.0)
        rig.state[0] += 2e-4
        rig.run(1.0)
        assert rig.tracker.phase is Phase.HOLDING
        assert np.abs(rig.state - rig.plan.states[-1]).max() < 1e-3


def test_a_plant_that_is_thrown_back_to_the_start_gets_no_control() -> None:
    rig = Rig(DoubleIntegrator())
    rig.follow(1.0)
    assert rig.tracker.phase is Phase.HOLDING
    rig.show(rig.plan.states[0])
    assert not rig.tracker.command(rig.now).control.any()
    assert rig.tracker.phase is Phase.STOPPED
    reason = rig.tracker.reason
    assert re.search(r'goal by more than tolerance.path = 0.5: x is off by .* m$', reason)


def test_a_plan_that_was_not_flown_leaves_the_ranges_of_others_as_they_are() -> None:
    rig = Rig(DoubleIntegrator(), [1.0, 0.0])
    states = rig.plan.states
    large = replace(rig.plan, states=1000.0 * states + rig.state - 1000.0 * states[0])
    for _ in range(2):
        with pytest.raises(TrajectoryRejected, match='x is off by 1 m'):
            rig.accept(ahead=1.0)
        rig.accept(large, 900.0)


def test_a_start_that_was_missed_is_told_once() -> None:
    rig = Rig(DoubleIntegrator())
    rig.follow(1.0)
    rig.accept(replace(rig.plan, states=rig.plan.states - rig.plan.states[0]), 0.05)
    rig.state[0] += 0.4
    rig.run(0.06)
    told = rig.tracker.command(rig.now)
    assert told.phase is Phase.HOLDING
    assert 'kept the active trajectory: the state is' in told.problem
    rig.run(0.2)
    assert rig.tracker.command(rig.now).problem == ''


LIMITED = changed(Cart, control_limits=lambda s: {'u': (-s.limit, s.limit)})


@pytest.mark.parametrize('off', [0.0, 0.05])
@pytest.mark.parametrize('time', [0.02, 0.05, 0.1])
def test_a_plan_of_few_commands_is_followed(time: float, off: float) -> None:
    """Gains for commands held for a hundredth of it threw the plant off by 20 times its way."""
    rig = Rig(LIMITED(time=time, limit=12.0 / time**2), [off, 0.0])
    plan = rig.plan
    rig.accept()
    while rig.now < plan.duration + 1e-9:
        rig.run(rig.tracker.parameters.interval)
        away = np.abs(rig.state - plan.sample(rig.now).state) / np.ptp(plan.states, axis=0)
        assert away.max() < 0.06
    rig.run(0.2)
    assert rig.tracker.phase is Phase.HOLDING
    assert np.abs(rig.state[0]) < 1e-3


@pytest.mark.parametrize('ahead', [0.1, 0.5, 0.9])
def test_a_plan_that_ends_between_two_commands_ends_at_rest(ahead: float) -> None:
    rig = Rig(LIMITED(time=0.2, limit=300.0))
    interval = rig.tracker.parameters.interval
    rig.accept(ahead=(4.0 - ahead) * interval)
    rig.run(4.0 * interval + rig.plan.duration)
    assert np.abs(rig.state / np.ptp(rig.plan.states, axis=0)).max() < 1e-3


def test_an_end_that_nothing_holds_is_passed_under_the_last_control() -> None:
    """The control is an angle, of which a mean with 0 is another way: a tick later 42 mm off."""
    rig = Rig(Brachistochrone())
    plan = rig.plan
    rig.accept()
    while rig.now < plan.duration:
        rig.run(rig.tracker.parameters.interval)
    rate = rig.tracker.plant.derivative(plan.states[-1], plan.controls[-1])
    away = rig.state - plan.states[-1] - (rig.now - plan.duration) * rate
    assert np.abs(away / np.ptp(plan.states, axis=0)).max() < 1e-3


def test_a_plan_beyond_the_limits_of_the_tracker_is_told() -> None:
    rig = Rig(LIMITED())
    rig.accept(ahead=1.0)
    assert rig.tracker.warning == ''
    rig.tracker = StatedTracker(LIMITED(limit=1.0), StatedTrackerParameters())
    rig.tracker.observe(rig.state, rig.now)
    rig.accept(ahead=1.0)
    assert re.search(r'u from -1.5\d* to 1.5\d* \(limits -1, 1\)$', rig.tracker.warning)


def test_a_state_that_no_control_changes_does_not_keep_the_end_from_being_held() -> None:
    """Energy that is counted: it changes with the control squared, not at rest."""
    cart = changed(
        Cart,
        states={'x': 'm', 'v': 'm/s', 'spent': 'm^2/s^3'},
        integrated=lambda s: {'spent': Integrated(0.0, None)},
        invert=lambda s, y, z: ((*y['x'][:2], z['spent']), y['x'][2:]),
        derivative=lambda s, x, u: (x[1], u[0], u[0] ** 2),
    )()
    rig = Rig(cart)
    rig.follow(0.0)
    for spent in (0.0, 1e3):  # so much more does not end the motion
        rig.state += [0.05, 0.0, spent]
        rig.run(4.0)
        assert rig.tracker.phase is Phase.HOLDING
        assert abs(rig.state[0]) < 5e-3


def test_ranges_stay_those_of_the_plans_that_were_flown() -> None:
    """Replans from near the goal are short: ordinary noise must not look large beside them."""
    rig = Rig(DoubleIntegrator())
    rig.follow(1.0)
    rng = np.random.default_rng(0)
    for _ in range(4):
        start = CartStart(*(rig.state + rng.normal(size=2) * [2e-4, 2e-3]).tolist())
        rig.accept(solved(DoubleIntegrator(start=start)), 0.2)
        rig.run(1.0)
        assert not rig.tracker.reason
        assert not rig.tracker.newest.start < rig.now - 1.0
        other = StatedTracker(DoubleIntegrator(), StatedTrackerParameters())
        other.adopt(rig.tracker)
        rig.tracker = other


def test_gains_are_computed_anew_only_where_they_change() -> None:
    """Of a plan of a minute it takes longer than a plant waits for a command."""
    rig = Rig(DoubleIntegrator())
    rig.accept()
    rig.run(0.5)
    law, given = rig.tracker.current.law, rig.tracker.parameters
    tolerance = replace(given.tolerance, path=0.4)
    for changed_to, kept in (({'tolerance': tolerance}, True), ({'state_timeout': 0.2}, False)):
        other = StatedTracker(DoubleIntegrator(), replace(given, **changed_to))
        other.adopt(rig.tracker)
        assert (other.current.law is law) == kept
        assert other.growth_rate == rig.tracker.growth_rate


def test_a_plant_that_was_held_fast_seems_stuck_until_the_next_plan() -> None:
    rig = Rig(MoonLander())
    plan = rig.plan
    rig.follow(-1.0)
    for _ in range(5):
        rig.show(plan.states[0])  # noticed late
    for _ in range(200):
        rig.show(plan.states[0])
        told = rig.tracker.command(rig.now)
    assert (told.phase, told.problem) == (Phase.STOPPED, STUCK)
    rig.state = plan.states[0].copy()
    rig.accept(plan, 0.2)
    while rig.tracker.phase is not Phase.TRACKING:
        assert not rig.tracker.command(rig.now).problem
        rig.show(plan.states[0])
    rig.run(plan.duration + 1.0)
    assert rig.tracker.phase is Phase.HOLDING


@pytest.mark.parametrize('off', [1e-3, 8e-3])
def test_a_plant_that_dry_friction_holds_is_not_taken_for_a_stuck_sensor(off) -> None:
    """Before its plan and beside its goal: an encoder shows the same, whatever the model does."""
    rig = Rig(DoubleIntegrator(), [off, 0.0])
    rig.accept(ahead=2.0)

    def rest(place: np.ndarray, seconds: float) -> None:
        for _ in range(round(seconds / rig.tracker.parameters.interval)):
            rig.show(place)
            told = rig.tracker.command(rig.now)
            assert not told.problem
        assert told.control.any()

    rest(rig.state, 1.9)
    rig.run(rig.plan.duration + 1.0)
    rest(rig.plan.states[-1] + [off, 0.0], 3.0)
    assert rig.tracker.phase is Phase.HOLDING


@pytest.mark.parametrize('time', [2.0, 60.0])
@pytest.mark.parametrize('share', [0.02, 0.3, 0.8])
def test_a_sensor_that_is_stuck_on_the_way_is_found_however_slow_the_plant(time, share) -> None:
    rig = Rig(LIMITED(time=time, limit=6.3 / time**2))  # hardly more than it takes
    rig.accept()
    rig.run(share * rig.plan.duration)
    stuck = rig.state
    while not (told := rig.tracker.command(rig.now)).problem:
        rig.show(stuck)
        assert rig.now < share * rig.plan.duration + 0.3
    assert (told.phase, told.problem) == (Phase.TRACKING, STUCK)


def test_a_plan_that_starts_elsewhere_is_rejected_at_once() -> None:
    rig = Rig(DoubleIntegrator(), [1.9, 0.0])
    with pytest.raises(TrajectoryRejected, match=r'from the trajectory at its start.*tolerance'):
        rig.accept(ahead=0.7)
    assert rig.tracker.phase is Phase.IDLE
    assert not rig.tracker.command(rig.now).control.any()


def test_a_start_that_cannot_be_held_is_compared_when_it_has_come() -> None:
    rig = Rig(DoubleIntegrator(start=CartStart(-2.0, 1.0)), [-0.5, 0.0])
    rig.accept(ahead=0.5)
    rig.run(0.5 + rig.plan.duration + 1.0)
    assert rig.tracker.phase is Phase.HOLDING
    assert np.abs(rig.state).max() < 1e-2
