# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The swing-up from request to verified plan by each method: any state, limits, errors."""

from __future__ import annotations

from contextlib import suppress
import dataclasses
from time import process_time
from types import SimpleNamespace

from benchmark.rigs import rig as random_rig
from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from replays import faults
from tdm_planner.direct_method import nonlinear_program
from tdm_planner.exceptions import Infeasible
from tdm_planner.plan_files import plan_document
from tdm_planner.plants import PendulumInertia, RotaryPendulum
from tdm_planner.plants.base import runge_kutta_step
from tdm_planner.plants.rotary_pendulum import mechanics
from tdm_planner.problems import (
    PendulumGoal,
    PendulumLimits,
    PendulumStart,
    PendulumSwingUp,
    Solution,
)

ENOUGH = 1000.0  # [s], so that the deadline never decides on a busy machine


STATES = st.builds(
    PendulumStart,
    theta=st.floats(-np.pi, np.pi),
    psi=st.floats(-1.9, 1.9),
    theta_dot=st.floats(-10.0, 10.0),
    psi_dot=st.floats(-10.0, 10.0),
)


HANGING = PendulumStart()


def problem(torque: float = 0.09, start: PendulumStart = HANGING, **others) -> PendulumSwingUp:
    others.setdefault('torque_reserve', 0.0)
    return PendulumSwingUp(limits=PendulumLimits(torque=torque), start=start, **others)


def check(made: PendulumSwingUp, solution: Solution) -> None:
    assert solution.verification.ok
    assert faults(plan_document(made, solution)) == []
    trajectory = solution.trajectory
    start = made.start
    assert trajectory.states[0].tolist() == [
        start.theta,
        start.psi,
        start.theta_dot,
        start.psi_dot,
    ]
    if made.method == 'virtual_arc':
        way = np.sign(trajectory.states[-1, 0] - trajectory.states[0, 0])
        assert (way * np.diff(trajectory.state('theta')) > -1e-6).all()


@pytest.mark.parametrize(('torque', 'longest'), [(0.09, 0.387), (0.02, 1.06)])
def test_quick_from_hanging_in_samples_that_messages_can_carry(torque, longest):
    made = problem(torque)
    solution = made.solve(ENOUGH)
    check(made, solution)
    trajectory = solution.trajectory
    times, control = trajectory.times, trajectory.control('torque')
    assert solution.cost == trajectory.duration <= longest
    np.testing.assert_allclose(times * 1e9, np.round(times * 1e9), rtol=0, atol=1e-3)
    assert times[0] == 0.0
    assert np.diff(times).max() <= 5.0e-3 + 1e-9
    assert set(np.abs(control)) == {torque}
    switches = times[:-1][np.flatnonzero(np.diff(control[:-1])) + 1]
    np.testing.assert_allclose(switches, np.cumsum(solution.parameters)[:-1], atol=2e-9)
    assert trajectory.rates is not None
    assert trajectory.state_units == ('rad', 'rad', 'rad/s', 'rad/s')


@pytest.mark.parametrize('torque', [0.09, 0.02])
@given(start=STATES)
@example(start=PendulumStart(theta=1.0, theta_dot=5.0, psi_dot=2.0))  # the disk is driven on
@settings(max_examples=15)
def test_any_state_gets_a_verified_plan(torque, start):
    made = problem(torque, start)
    if max(made.task.least_peak(), made.task.least_reach) > made.limits.disk_angle:
        with pytest.raises(Infeasible, match='keeps the disk inside'):
            made.solve(0.2)
    else:
        check(made, made.solve(ENOUGH))


def test_the_goal_asked_for_is_reached_and_the_fastest_is_no_slower():
    start = PendulumStart(theta=2.0, theta_dot=3.0)
    quickest = problem(0.09, start).solve(ENOUGH).cost
    for turns in (0, 1, -1):
        solution = problem(0.09, start, goal=PendulumGoal(turns=turns)).solve(ENOUGH)
        assert solution.trajectory.states[-1, 0] == pytest.approx(2 * np.pi * turns, abs=1e-4)
        assert quickest <= 1.02 * solution.cost


@pytest.mark.parametrize('method', ['switching', 'smooth', 'virtual_arc'])
def test_at_the_goal_nothing_needs_to_be_done(method):
    solution = problem(start=PendulumStart(theta=0.0), method=method).solve(ENOUGH)
    assert solution.verification.ok
    assert solution.trajectory.times.size >= 2
    assert not solution.trajectory.controls.any()
    assert solution.duration < 0.01


def test_an_earlier_plan_is_a_start():
    # One random start hardly ever arrives; the earlier plan next to it does.
    before = problem(0.02).solve(ENOUGH)
    moved = problem(0.02, PendulumStart(theta=np.pi - 0.02, psi=0.01))
    after = moved.solve(ENOUGH, warm_start=before)
    assert after.verification.ok
    assert after.cost <= 1.05 * before.cost


def test_smooth_torque():
    state = np.random.default_rng(1).uniform(-1, 1, 4) * [np.pi, 1.0, 5.0, 5.0]
    made = problem(0.09, PendulumStart(*state.tolist()), method='smooth')
    solution = made.solve(ENOUGH)
    check(made, solution)
    trajectory = solution.trajectory
    assert trajectory.interpolation == 'linear'
    steps = np.abs(np.diff(trajectory.control('torque'))) / np.diff(trajectory.times)
    fine = np.linspace(0.0, trajectory.duration, 4001)
    between = np.abs(np.diff(trajectory.sample(fine).control[:, 0])) / np.diff(fine)
    assert between.max() <= 3.0 * steps.max()


def test_the_virtual_arc_is_as_quick_as_switching_where_it_goes_one_way():
    theta, torque = -1.2, 0.04
    made = problem(torque, PendulumStart(theta=theta), method='virtual_arc')
    solution = made.solve(ENOUGH)
    check(made, solution)
    # From here upright is reached without swinging back only once round.
    assert round(solution.trajectory.states[-1, 0] / (2 * np.pi)) == np.sign(theta)
    quickest = problem(torque, PendulumStart(theta=theta)).solve(ENOUGH)
    assert quickest.cost * (1 - 1e-3) < solution.cost < 1.03 * quickest.cost


@given(
    theta=st.floats(-3.0, 3.0),
    psi=st.floats(-0.5, 0.5),
    speed=st.floats(-8.0, 8.0),
    psi_dot=st.floats(-3.0, 3.0),
    disk_angle=st.sampled_from([2.0, 0.8]),
)
@settings(max_examples=8)
def test_along_the_virtual_arc_any_plan_lands_and_any_failure_has_a_reason(
    theta, psi, speed, psi_dot, disk_angle
):
    made = PendulumSwingUp(
        limits=PendulumLimits(torque=0.09, disk_angle=disk_angle),
        start=PendulumStart(theta=theta, psi=psi, theta_dot=speed, psi_dot=psi_dot),
        torque_reserve=0.0,
        method='virtual_arc',
    )
    try:
        solution = made.solve(1.0)
    except Infeasible as error:
        assert 'switching' in str(error) or 'passes the check' in str(error)
        return
    check(made, solution)


def rig(size: float, arm: float, disk: float, across: float, torque: float, angle: float):
    """Return a swing-up of a rig of 1 kg; inertias in units of m l^2, the torque of m g l."""
    parts = {'disk': disk, 'x': across, 'y': 0.01, 'z': across}
    inertia = PendulumInertia(**{axis: size**2 * value for axis, value in parts.items()})
    plant = RotaryPendulum(1.0, com_distance=size, arm_length=arm * size, inertia=inertia)
    limits = PendulumLimits(torque=torque * 9.81 * size, disk_angle=angle)
    return PendulumSwingUp(plant=plant, limits=limits, torque_reserve=0.0)


@pytest.mark.parametrize(
    ('made', 'fewest'),
    [
        (rig(0.5, 1.0, 2.0, 0.3, 0.06, 3.0), 20),  # weak: more swings than anybody would guess
        (rig(0.1, 1.0, 0.1, 0.1, 0.3, 2.5), 5),  # swings are quick where the disk is free
        (rig(2.0, 0.6, 0.5, 4.0, 0.4, 2.5), 5),  # slow
        (rig(2.0, 1.95, 0.043, 0.049, 0.14, 1.0), 20),  # the disk turns with the pendulum
        (rig(0.3, 0.5, 20.0, 0.3, 0.3, 2.0), 256),  # weaker still
        (rig(0.127, 1.6, 0.02, 0.034, 0.066, 1.15), 20),  # it takes nearly all of the inertia
        (rig(0.09, 1.2, 0.09, 0.06, 0.04, 0.835), 20),
    ],
)
def test_foreign_rigs_need_no_settings(made, fewest):
    solution = made.solve(ENOUGH)
    check(made, solution)
    assert solution.parameters.size >= fewest
    assert solution.trajectory.times.size < 30_000


@pytest.mark.parametrize('seconds', [0.03, 0.5, 1.0])
def test_the_deadline_is_kept_where_it_takes_very_many_arcs(monkeypatch, seconds):
    made = rig(0.76, 0.237, 25.7, 0.155, 0.372, 3.6)
    made.prepare()
    # The deadline counts processor time, too: the machine may be busy.
    monkeypatch.setattr(nonlinear_program, 'time', SimpleNamespace(perf_counter=process_time))
    began = process_time()
    with suppress(Infeasible):
        assert made.solve(seconds).parameters.size > 256
    assert process_time() - began < seconds + 0.05


BRAKED = PendulumStart(theta=2.0, psi=1.5, psi_dot=9.5)
OTHER_WAY = PendulumStart(theta=2.0, psi=-1.5, psi_dot=-9.5)
FAST = PendulumStart(psi=1.9, psi_dot=200.0)
AWAY = PendulumStart(theta=2.0, theta_dot=1.0)
ARC = {'method': 'virtual_arc'}
AT_0 = {'goal': PendulumGoal(turns=0)}


BRAKING = r'limits\.disk_angle = 2 rad from start\.psi_dot'
GIVEN_UP = r'limits\.disk_angle|gave no swing-up'


@pytest.mark.parametrize(
    ('torque', 'start', 'others', 'seconds', 'words', 'code'),
    [
        (1e-4, HANGING, {}, 0.2, r'limits\.torque', ''),
        (1e-12, HANGING, {}, 0.2, r'limits\.torque', ''),
        (0.02, HANGING, {}, 1e-5, 'in 1e-05 s', ''),
        (0.02, BRAKED, {}, 0.3, BRAKING, 'INFEASIBLE'),
        (0.02, OTHER_WAY, {}, 0.3, BRAKING, 'INFEASIBLE'),
        (0.02, FAST, {}, 0.1, GIVEN_UP, ''),
        (0.02, FAST, {'method': 'smooth'}, 0.1, GIVEN_UP, ''),
        (0.02, HANGING, ARC | AT_0, ENOUGH, r"one way all.*method 'switching'", 'INFEASIBLE'),
        (0.09, AWAY, ARC | AT_0, ENOUGH, 'away from goal.turns = 0', ''),
        (0.09, HANGING, ARC, 1e-6, 'in 1e-06 s', 'DEADLINE'),
    ],
)
def test_what_cannot_be_done_is_said_so(torque, start, others, seconds, words, code):
    with pytest.raises(Infeasible, match=words) as caught:
        problem(torque, start, **others).solve(seconds)
    assert code in caught.value.code


@pytest.mark.parametrize('method', ['switching', 'smooth'])
def test_a_disk_that_the_torque_cannot_stop_is_infeasible_at_once(method):
    made = dataclasses.replace(random_rig(1067, hanging=False), method=method)
    with pytest.raises(Infeasible, match=r'it turns to 7\.47 rad at least') as caught:
        made.solve(ENOUGH)
    assert caught.value.code == 'INFEASIBLE'


@given(st.integers(0, 10_000))
@settings(max_examples=12)
def test_no_torque_stops_the_disk_within_its_least_reach(seed):
    """Torques that brake, and some that switch at random first, until the momentum is gone."""
    made, count = random_rig(seed, hanging=False), 32
    task, w0 = made.task, made.plant.natural_frequency
    rng, step = np.random.default_rng(seed), 0.03 / w0 / made.plant.quickness
    x = np.tile(task.start, (count, 1))
    peak, going, turning = np.abs(x[:, 1]), np.full(count, True), None
    until = rng.uniform(0.0, 6.0, count) * (np.arange(count) > 0) / w0
    for number in range(2000):
        b, j, _, _ = mechanics(made.plant.coefficients, x[:, 0], x[:, 2], x[:, 3])
        momentum = j * x[:, 3] + b * x[:, 2]
        turning = np.sign(momentum) if turning is None else turning
        going &= momentum * turning > 0.0
        peak = np.where(going, np.maximum(peak, np.abs(x[:, 1])), peak)
        random = np.sin(number * step * w0 * np.arange(count)) * (number * step < until)
        torque = np.where(random > 0.0, task.torque, -task.torque) * turning
        moved = runge_kutta_step(made.plant, x, torque[:, None], step)
        x = np.where(going[:, None], moved, x)
    stopped = peak[~going]
    assert (stopped >= task.least_reach - 1e-3).all()
    assert stopped.size or task.least_reach > abs(task.start[1])
