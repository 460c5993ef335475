# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The swing-up: plans by each method from any state, limits, refusals; the programs beneath."""

from collections.abc import Iterator
from contextlib import suppress
import dataclasses
from dataclasses import replace
from functools import partial
from time import process_time
from types import SimpleNamespace

from benchmark.rigs import rig as random_rig
from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from replays import central, faults
from scipy.optimize import minimize
from tdm_planner.direct_method import Budget, nonlinear_program
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.exceptions import Infeasible
from tdm_planner.plan_files import plan_document
from tdm_planner.plants.pendulum_replay import replay_pendulum, roll_states
from tdm_planner.plants.rotary_pendulum import mechanics, PendulumInertia, RotaryPendulum
from tdm_planner.problems import PendulumGoal, PendulumLimits, PendulumStart, PendulumSwingUp
from tdm_planner.problems.pendulum import candidates, switching_program
from tdm_planner.problems.pendulum.candidates import Candidate, polish, with_new_arcs
from tdm_planner.problems.pendulum.shooting import Steps
from tdm_planner.problems.pendulum.smooth import collocated
from tdm_planner.problems.pendulum.switching_program import evaluate_arcs, SwitchingData
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

ENOUGH = 1000.0  # [s], so that the deadline never decides on a busy machine
HANGING, PLANT = PendulumStart(), RotaryPendulum()
W0 = PLANT.natural_frequency
START = np.array([np.pi, 0.2, 1.0, -2.0])
DURATIONS = st.lists(st.floats(0.02, 0.12), min_size=4, max_size=7).map(np.array)
OPTIONS = TrustRegionOptions((30.0,) * 2, radius=0.5, iterations=60, corrections=4)
OPTIONS = OPTIONS._replace(cost_tolerance=1e-6, feasibility=(1e-8,) * 2)


def states(*most: float) -> st.SearchStrategy[PendulumStart]:
    return st.builds(PendulumStart, *(st.floats(-each, each) for each in most))


def problem(torque: float = 0.09, start: PendulumStart = HANGING, **others) -> PendulumSwingUp:
    others = {'torque_reserve': 0.0, 'limits': PendulumLimits(torque=torque), **others}
    return PendulumSwingUp(start=start, **others)


def checked(made: PendulumSwingUp, seconds: float = ENOUGH) -> Solution:
    solution = made.solve(seconds)
    assert solution.verification.ok
    assert faults(plan_document(made, solution)) == []
    trajectory = solution.trajectory
    assert tuple(trajectory.states[0].tolist()) == dataclasses.astuple(made.start)[:4]
    if made.method == 'virtual_arc':
        steps = np.diff(trajectory.state('theta'))
        assert (np.sign(steps.sum()) * steps > -1e-6).all()
    return solution


@pytest.mark.parametrize(('torque', 'disk_angle'), [(0.02, 0.1), (0.004, 0.3), (0.004, 0.1)])
def test_weak_motors_and_narrow_disks_are_planned_for_from_near_upright(torque, disk_angle):
    """Pumping hardly ever arrives from there."""
    for start in (PendulumStart(0.003, 0.0), PendulumStart(0.02, 0.005), PendulumStart(0.0, 0.01)):
        made = problem(torque, start)
        checked(replace(made, limits=PendulumLimits(torque, disk_angle)), 10.0)


def test_some_of_the_range_of_the_disk_is_left_to_the_feedback_where_the_start_allows_it():
    narrow, outwards = PendulumLimits(0.02, 0.6), PendulumStart(0.3, 0.57, 0.0, 1.5)
    peaks = []
    for start, reserve in ((HANGING, 0.0), (HANGING, 0.2), (outwards, 0.2)):
        plan = checked(PendulumSwingUp(limits=narrow, start=start, torque_reserve=reserve))
        peaks.append(np.abs(plan.trajectory.state('psi')).max() / narrow.disk_angle)
    assert 0.99 < peaks[0] <= 1.0
    assert peaks[1] <= 0.98 + 1e-6
    assert 0.98 < peaks[2] <= 1.0


@pytest.mark.parametrize(('torque', 'longest'), [(0.09, 0.387), (0.02, 1.06)])
def test_quick_from_hanging_in_samples_that_messages_can_carry(torque, longest):
    made = problem(torque)
    trajectory = (solution := checked(made)).trajectory
    times, control = trajectory.times, trajectory.control('torque')
    assert solution.cost == trajectory.duration <= longest
    np.testing.assert_allclose(times * 1e9, np.round(times * 1e9), rtol=0, atol=1e-3)
    assert np.diff(times, prepend=0.0).max() <= 5.0e-3 + 1e-9
    assert set(np.abs(control)) == {torque}
    switches = times[:-1][np.flatnonzero(np.diff(control[:-1])) + 1]
    np.testing.assert_allclose(switches, np.cumsum(solution.parameters)[:-1], atol=2e-9)
    assert trajectory.rates is not None
    assert trajectory.state_units == ('rad', 'rad', 'rad/s', 'rad/s')


@pytest.mark.parametrize('torque', [0.09, 0.02])
@given(start=states(np.pi, 1.9, 10.0, 10.0))
@example(start=PendulumStart(theta=1.0, theta_dot=5.0, psi_dot=2.0))  # the disk is driven on
@settings(max_examples=15)
def test_any_state_gets_a_verified_plan(torque, start):
    made = problem(torque, start)
    if max(made.task.least_peak(Budget(1.0)), made.task.least_reach) > made.limits.disk_angle:
        with pytest.raises(Infeasible, match=r'keeps the disk inside|none .* passes the check'):
            made.solve(0.2)
    else:
        checked(made)


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


def test_smooth_torque():
    state = np.random.default_rng(1).uniform(-1, 1, 4) * [np.pi, 1.0, 5.0, 5.0]
    made = problem(0.09, PendulumStart(*state.tolist()), method='smooth')
    solution = checked(made)
    trajectory = solution.trajectory
    assert trajectory.interpolation == 'linear'
    steps = np.abs(np.diff(trajectory.control('torque'))) / np.diff(trajectory.times)
    fine = np.linspace(0.0, trajectory.duration, 4001)
    between = np.abs(np.diff(trajectory.sample(fine).control[:, 0])) / np.diff(fine)
    assert between.max() <= 3.0 * steps.max()


def test_the_virtual_arc_is_as_quick_as_switching_where_it_goes_one_way():
    theta, torque = -1.2, 0.04
    made = problem(torque, PendulumStart(theta=theta), method='virtual_arc')
    solution = checked(made)
    # From here upright is reached without swinging back only once round.
    assert round(solution.trajectory.states[-1, 0] / (2 * np.pi)) == np.sign(theta)
    quickest = problem(torque, PendulumStart(theta=theta)).solve(ENOUGH)
    assert quickest.cost * (1 - 1e-3) < solution.cost < 1.03 * quickest.cost


@given(start=states(3.0, 0.5, 8.0, 3.0), disk_angle=st.sampled_from([2.0, 0.8]))
@settings(max_examples=8)
def test_any_plan_along_the_virtual_arc_lands_or_says_why_there_is_none(start, disk_angle):
    made = problem(start=start, method='virtual_arc')
    made = replace(made, limits=PendulumLimits(torque=0.09, disk_angle=disk_angle))
    try:
        checked(made, 1.0)
    except Infeasible as error:
        assert 'switching' in str(error) or 'passes the check' in str(error)


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
        (random_rig(3054), 20),  # a strong motor whose disk reaches its limit at once
    ],
)
def test_foreign_rigs_need_no_settings(made, fewest):
    solution = checked(made)
    assert solution.parameters.size >= fewest
    assert solution.trajectory.times.size < 30_000


def test_motions_of_thousands_of_arcs_are_replayed():
    task = random_rig(1070).task
    times = np.arange(7001) * 2.2 / task.plant.natural_frequency
    torques = task.planned_torque * (-1.0) ** np.arange(7001)
    states = roll_states(task.plant, task.start, np.diff(times), torques[:-1])
    motion = Trajectory.of(task.plant, times, states, torques[:, None])
    flown = replay_pendulum(task.plant, motion)
    assert flown.steps.size > 40_000
    np.testing.assert_allclose(flown.states(times), states, atol=1e-5)
    few = candidates.trajectory(task, Candidate(np.diff(times)[:2000], torques[:2000], 0))
    assert few.times.size < 45_000  # a message, and its check within the deadline
    np.testing.assert_allclose(few.states[-1], states[2000], atol=1e-5)
    between = 0.5 * (few.times[1:] + few.times[:-1])
    np.testing.assert_allclose(few.sample(between).state, flown.states(between), atol=2e-3)


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
AWAY, OUTWARD = PendulumStart(theta=2.0, theta_dot=1.0), PendulumStart(psi=2.0, psi_dot=0.1)
ARC = {'method': 'virtual_arc'}
NARROW = {'limits': PendulumLimits(torque=0.02, disk_angle=1e-3)}
AT_0 = {'goal': PendulumGoal(turns=0)}
BRAKING = r'limits\.disk_angle = 2 rad from start\.psi = .* rad, start\.psi_dot'
GIVEN_UP = r'limits\.disk_angle|gave no swing-up'


@pytest.mark.parametrize(
    ('torque', 'start', 'others', 'seconds', 'words', 'code'),
    [
        (1e-12, HANGING, {}, 0.2, r'try a limits\.torque above 4\.7e-05', ''),
        (0.02, HANGING, {'goal': PendulumGoal(turns=99)}, 0.2, '99 is 98.5 turns away', ''),
        (0.02, HANGING, {'switching_arcs': 5}, 0.2, r'and 5 arcs \(switching_arcs\)', ''),
        (0.02, OUTWARD, {}, ENOUGH, BRAKING, 'INFEASIBLE'),
        (0.02, HANGING, {}, 1e-5, 'in 1e-05 s', ''),
        (0.02, BRAKED, {}, 0.3, BRAKING, 'INFEASIBLE'),
        (0.02, OTHER_WAY, {}, 0.3, BRAKING, 'INFEASIBLE'),
        (1e-4, HANGING, {}, 0.2, r'drive of .* more limits\.torque or limits\.disk_angle', ''),
        (0.02, HANGING, NARROW, 0.2, r'more limits\.disk_angle', ''),
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
    made = replace(random_rig(1067, hanging=False), method=method)
    with pytest.raises(Infeasible, match=r'it turns to 7\.47 rad at least'):
        made.solve(ENOUGH)


@given(st.integers(0, 10_000))
@settings(max_examples=12)
def test_the_torque_that_brakes_stops_the_disk_beyond_its_least_reach(seed):
    made = random_rig(seed, hanging=False)
    task, step = made.task, 0.03 / made.plant.natural_frequency / made.plant.quickness
    b, j, _, _ = mechanics(made.plant.coefficients, task.start[0], *task.start[2:])
    turning = np.sign(j * task.start[3] + b * task.start[2])
    torques = np.full(2000, -task.planned_torque * turning)
    states = roll_states(made.plant, task.start, np.full(2000, step), torques)
    b, j, _, _ = mechanics(made.plant.coefficients, states[:, 0], *states[:, 2:].T)
    (stopped,) = np.nonzero((j * states[:, 3] + b * states[:, 2]) * turning <= 0.0)
    moving = states[: stopped[0]] if stopped.size else states
    assert np.abs(moving[:, 1]).max() >= task.least_reach - 1e-3
    assert stopped.size or task.least_reach > abs(task.start[1])


def program(arcs: int, disk_angle: float = 2.0, torques=None) -> SwitchingData:
    torques = 0.09 * (-1.0) ** np.arange(arcs) if torques is None else torques
    mesh = np.full(arcs, 12), np.full(12 * arcs, 1.0 / 12.0)
    return SwitchingData(PLANT.coefficients, START, torques, 0.0, disk_angle, W0, *mesh)


@given(DURATIONS, st.integers(0, 100))
@settings(max_examples=20)
def test_derivatives_of_arcs_match_finite_differences(durations, seed):
    made, xi = program(durations.size, 0.3), durations * W0
    point = evaluate_arcs(made, xi)
    expected = central(lambda x: evaluate_arcs(made, x).residual, xi)
    np.testing.assert_allclose(point.jacobian, expected, atol=1e-5 * (1 + np.abs(expected).max()))
    for i, change in enumerate(1e-6 * np.eye(xi.size)):
        ahead, behind = (evaluate_arcs(made, x).margins for x in (xi + change, xi - change))
        # Where the peak changes its node or its side the margin has a kink: not differentiable.
        smooth = np.abs(ahead - 2 * point.margins + behind) < 1e-9
        slopes = (ahead - behind)[smooth] / 2e-6
        np.testing.assert_allclose(point.slopes[smooth, i], slopes, atol=1e-4, rtol=1e-4)
    duals = np.random.default_rng(seed).normal(size=4)
    found = switching_program.curvature(made, point, duals)
    least = switching_program.SMALLEST_CURVATURE
    basis = np.linalg.svd(point.jacobian)[2]
    across, along = basis[:4], basis[4:]
    second = central(lambda x: duals @ evaluate_arcs(made, x).jacobian, xi, 1e-5)
    values = np.linalg.eigvalsh(along @ (0.5 * (second + second.T)) @ along.T)
    expected = np.sort(np.maximum(np.abs(values), least))
    reduced = np.linalg.eigvalsh(along @ found @ along.T)
    np.testing.assert_allclose(reduced, expected, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(across @ found, least * across, atol=1e-9)


def arrivals(disk_angle: float) -> Iterator[tuple[SwitchingData, np.ndarray]]:
    """Programs with a motion each that arrives, the quickest first."""
    task = SwingUpTask(PLANT, START, 0.09, 0.09, disk_angle, 0)
    guesses = candidates.starts(task, np.random.default_rng(0), 200, 6)
    given = Steps(12), Budget(ENOUGH)
    found = candidates.shoot_upright(task, guesses, *given, rounds=candidates.ONE_ROUND)
    for arcs in sorted(found, key=lambda each: each.total)[:5]:
        yield program(arcs.durations.size, disk_angle, arcs.torques), arcs.durations * W0


def local_minimum(program: SwitchingData, xi: np.ndarray) -> float:
    at = partial(evaluate_arcs, program)
    ends = {'type': 'eq', 'fun': lambda x: at(x).residual, 'jac': lambda x: at(x).jacobian}
    limits = {'type': 'ineq', 'fun': lambda x: np.minimum(at(x).margins, 1.0)}
    limits['jac'] = lambda x: at(x).slopes
    task = {'bounds': [(0.0, None)] * xi.size, 'constraints': [ends, limits]}
    return float(minimize(np.sum, xi, jac=np.ones_like, method='SLSQP', tol=1e-10, **task).fun)


@pytest.mark.parametrize('disk_angle', [2.0, 0.9])
def test_minimum_is_feasible_and_the_best_around(disk_angle):
    converged = 0
    for program, xi in arrivals(disk_angle):
        found = minimise(switching_program.SwitchingProgram(program), xi, OPTIONS, Budget(60.0))
        if not found.converged:
            continue
        converged += 1
        # Steering looks at |psi| at nodes only: within the limit between them takes longer.
        assert found.point.cost <= xi.sum() * (1 + 2e-3)
        assert found.point.cost <= local_minimum(program, found.point.xi) * (1 + 1e-4)
        durations = found.point.xi / W0
        assert evaluate_arcs(program, found.point.xi).ends < 1e-6 / W0
        fine = np.repeat(durations / 200, 200), np.repeat(program.torques, 200)
        assert np.abs(roll_states(PLANT, START, *fine)[:, 1]).max() <= disk_angle + 1e-3
    assert converged >= 3


def test_a_motor_far_too_strong_for_the_rig_is_no_hang():
    """Swings leave the disk's range where they are integrated again, however fast."""
    strong, absurd = PendulumLimits(torque=200.0), PendulumLimits(torque=1e5)
    assert PendulumSwingUp(limits=strong).solve(deadline=1.0, counted=True).verification.ok
    with pytest.raises(Infeasible):
        PendulumSwingUp(limits=absurd).solve(deadline=1.0, counted=True)


def test_new_arcs_shorten_a_minimum_to_that_of_collocation():
    scaled, collocation = [0.61, 1.798, 2.336, 2.498, 2.689, 2.019, 0.681], 8.699
    task = replace(random_rig(1079).task, whole_range=True)
    budget = Budget(ENOUGH)
    w0, steps = task.plant.natural_frequency, 24
    torques = task.planned_torque * (-1.0) ** np.arange(len(scaled))
    first = Candidate(np.array(scaled) / w0, torques, 1)
    best, violation = polish(task, first, steps, 1e-8, budget)
    assert violation < 1e-8
    assert w0 * best.total > 1.4 * collocation
    for _ in range(12):
        further = with_new_arcs(task, best, steps, 60)
        if further is None:
            break
        assert further.total == pytest.approx(best.total)
        ends = [roll_states(task.plant, task.start, *a.tail)[-1] for a in (best, further)]
        np.testing.assert_allclose(*ends, atol=1e-5)
        better, violation = polish(task, further, steps, 1e-8, budget)
        best = candidates.without_short_arcs(task, better)
    assert further is None
    assert violation < 1e-8
    assert w0 * best.total == pytest.approx(collocation, rel=5e-3)
    away = replace(first, durations=1e4 * first.durations)
    assert with_new_arcs(task, away, steps, 60) is None


def test_collocation_leads_from_many_arcs_to_a_quicker_swing_up():
    scaled = [0.189, 1.379, 1.74, 0.674, 0.302, 0.086, 0.756, 0.313, 0.129, 0.141, 0.097]
    scaled += [0.191, 0.11, 0.705, 0.167]
    task, budget = random_rig(2020).task, Budget(ENOUGH)
    durations = np.array(scaled) / task.plant.natural_frequency
    first = Candidate(durations, -task.planned_torque * (-1.0) ** np.arange(len(scaled)), 0)
    read = list(collocated(task, first, budget))
    assert np.abs(np.concatenate([arcs.torques for arcs in read])).max() <= task.planned_torque
    assert read[0].total == pytest.approx(read[1].total)  # the same motion, finely and coarsely
    assert read[0].durations.size > read[1].durations.size
    torques = [float(arcs.durations @ arcs.torques) for arcs in read]
    assert torques[0] == pytest.approx(torques[1], abs=0.05 * read[0].total * task.planned_torque)
    best, violation = min((polish(task, a, 384, 1e-8, budget) for a in read), key=lambda b: b[1])
    assert violation < 1e-8
    assert task.plan(candidates.trajectory(task, best), best.durations, violation).verification.ok
    assert best.total < 0.7 * first.total
    unfinished = next(collocated(task, first, Budget(0.0)))
    assert unfinished.total == pytest.approx(first.total, rel=0.05)
