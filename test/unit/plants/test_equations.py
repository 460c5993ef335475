# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plants' equations, what is compiled and derived of them, and the URDF, against others."""

from dataclasses import replace
import inspect
import math
import os
from pathlib import Path
import shutil
import threading
from typing import Any, NamedTuple

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from replays import by_scipy, central, pendulum_points, replayed, robot_rates
from scipy.integrate import solve_ivp
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plants import pendulum_kernels, robot_replay, slopes
from tdm_planner.plants.base import integrate
from tdm_planner.plants.compilation import sine_and_cosine
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.pendulum_kernels import LANES, roll_arcs, roll_ends, roll_lanes
from tdm_planner.plants.pendulum_replay import replay_pendulum, roll_states
from tdm_planner.plants.rotary_pendulum import (
    pendulum_urdf,
    PendulumDamping,
    PendulumInertia,
    RotaryPendulum,
)
from tdm_planner.problems.pendulum import shooting
from tdm_planner.problems.pendulum.shooting import ArcBatch, Effort, roll_to_ends, shoot, Steps
from tdm_planner.problems.pendulum.switching_program import mesh_of_arcs
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.tracking.pendulum_tracking import EstimatedPendulum
from tdm_planner.trajectory import to_nanoseconds, Trajectory

PLANT = RotaryPendulum()
TORQUES = st.floats(-0.1, 0.1).map(lambda torque: np.array([torque]))
START = np.array([np.pi, 0.0, 0.0, 0.0])
STATES = st.tuples(*(st.floats(-most, most) for most in (4.0, 2.0, 8.0, 8.0))).map(np.array)
# Unequal across the rod, to tell the axes apart.
INERTIA = PendulumInertia(disk=0.02, x=5e-3, y=1e-3, z=4.5e-3)
DAMPING = PendulumDamping(pivot=0.02, disk=0.1)
OTHER = RotaryPendulum(
    mass=0.3, com_distance=0.2, arm_length=0.15, inertia=INERTIA, damping=DAMPING
)
TASK = SwingUpTask(PLANT, START, 0.09, 0.09, 2.0, None)
ROBOT = FloatingRobot(mass=8.0, inertia=0.05, wheel_inertia=0.002)


@given(STATES, TORQUES)
def test_jacobians_match_finite_differences(state, torque):
    by_state, by_control = PLANT.jacobians(state, torque)
    difference = central(lambda x: PLANT.derivative(x, torque), state)
    np.testing.assert_allclose(by_state, difference, rtol=1e-6, atol=1e-4)
    difference = central(lambda u: PLANT.derivative(state, u), torque, 0.5)
    np.testing.assert_allclose(by_control, difference, rtol=1e-9, atol=1e-6)


def alternating(count: int, torque: float = 0.05) -> np.ndarray:
    return torque * (-1.0) ** np.arange(count)


def even(arcs: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(arcs, steps), np.full(arcs * steps, 1.0 / steps)


def roll(start, durations, torques, steps):
    arcs, k = durations.size, PLANT.coefficients
    derivatives = np.zeros((arcs * steps + 1, 4, arcs))
    states, within, begins = roll_arcs(k, start, durations, torques, *even(arcs, steps))
    for node, m, p in np.ndindex(arcs * steps, 4, arcs):
        at = node + 1, node // steps, m, p
        derivatives[node + 1, m, p] = pendulum_kernels.derivative(within, begins, *at)
    np.testing.assert_allclose(derivatives[steps::steps], begins[1:], rtol=1e-9, atol=1e-9)
    return states, derivatives


def random_batch(count):
    rng = np.random.default_rng(3)
    durations = rng.dirichlet(np.full(5, 2.0), size=count) * rng.uniform(0.2, 1.0, (count, 1))
    torques = np.tile(alternating(5, 0.09), (count, 1))
    return ArcBatch(durations, torques, np.full(count, 5))


@given(STATES, TORQUES)
def test_energy_comes_from_the_torque_and_goes_into_damping(state, torque):
    speed, step = OTHER.derivative(state, torque), 1e-4
    change = OTHER.energy(state + step * speed) - OTHER.energy(state - step * speed)
    lost = DAMPING.pivot * state[2] ** 2 + DAMPING.disk * state[3] ** 2
    assert change / (2.0 * step) == pytest.approx(torque[0] * state[3] - lost, rel=1e-3, abs=1e-4)


def test_damping_that_stops_every_motion_at_once_is_refused():
    with pytest.raises(
        InvalidProblem, match=r"'plant.damping.\*' stop a motion within .* or more"
    ):
        replace(PLANT, damping=PendulumDamping(pivot=1.0))


@pytest.mark.parametrize(
    ('across', 'damping'), [(5.0, 0.0), (10.0, 0.0), (20.0, 0.0), (0.3, 60.0)]
)
def test_steps_are_shorter_where_the_disk_turns_with_a_heavy_pendulum(across, damping):
    """Or damping is strong."""
    inertia = PendulumInertia(disk=0.05, x=across, y=0.01, z=across)
    plant = RotaryPendulum(1.0, com_distance=1.0, arm_length=0.8, inertia=inertia)
    plant = replace(plant, damping=PendulumDamping(disk=damping))
    w0, fall = plant.natural_frequency, np.array([0.3, 0.0, 0.0, 0.0])
    durations, torques = np.full(8, 1.0 / w0), np.zeros(8)
    rates, exactly = lambda t, x: plant.derivative(x, np.zeros(1)), {'rtol': 1e-12, 'atol': 1e-13}
    fine = solve_ivp(rates, (0.0, 8.0 / w0), fall, method='DOP853', **exactly).y[:, -1]
    arcs = np.full(1, 8, np.intp)
    given = durations[None], torques[None], arcs, 1.0 / 12.0, np.inf
    ends, _ = roll_ends(plant.coefficients, fall, *given)
    exact = roll_states(plant, fall, durations, torques)[-1]
    counts, mesh = mesh_of_arcs(plant.coefficients, fall, durations, torques, 4, 1.0 / 12.0)
    assert counts.max() > 2 * counts.min()  # many where it passes upright or hangs
    assert mesh.max() > 3.0 * mesh.min() > 0.0
    np.testing.assert_allclose(np.add.reduceat(mesh, np.cumsum(counts) - counts), 1.0)
    states, _, _ = roll_arcs(plant.coefficients, fall, durations, torques, counts, mesh)
    state, other = np.repeat(fall, LANES), np.empty((8, LANES))
    lanes = np.tile(durations[:, None], LANES), np.zeros((8, LANES))
    given = 8, *even(8, 4), 1.0 / 12.0, state, np.empty((8, 4 * LANES)), other
    roll_lanes(plant.coefficients, *lanes, *given, np.empty((8, 8, LANES)))
    scale = np.array([1, 1, w0, w0])
    for found in (ends[0], states[-1], state[::LANES]):
        np.testing.assert_allclose(found / scale, fine / scale, 0, 1e-3)
    np.testing.assert_allclose(exact / scale, fine / scale, 0, 1e-8)


@given(STATES, st.integers(4, 7), st.integers(0, 100))
@settings(max_examples=20)
def test_motions_side_by_side_are_those_one_by_one(start, arcs, seed):
    steps, k = 24, PLANT.coefficients
    durations = np.random.default_rng(seed).uniform(0.0, 0.1, size=(arcs, LANES))
    torques = np.tile(alternating(arcs)[:, None], LANES)
    state, derivatives = np.repeat(start, LANES), np.empty((arcs, 4 * LANES))
    peaks, peak_slopes = np.empty((arcs, LANES)), np.zeros((arcs, arcs, LANES))
    found = state, derivatives, peaks, peak_slopes
    roll_lanes(k, durations, torques, arcs, *even(arcs, steps), np.inf, *found)
    for lane in range(LANES):
        one = durations[:, lane].copy(), torques[:, lane].copy()
        states, exact = roll(start, *one, steps)
        np.testing.assert_allclose(state.reshape(4, LANES)[:, lane], states[-1], atol=1e-9)
        scale = 1.0 + np.abs(exact).max()
        found = derivatives.reshape(arcs, 4, LANES)[:, :, lane]
        np.testing.assert_allclose(found.T, exact[-1], atol=1e-3 * scale)
        disk = states[1:, 1].reshape(arcs, steps)
        nodes = np.abs(disk).argmax(axis=1) + steps * np.arange(arcs) + 1
        np.testing.assert_allclose(peaks[:, lane], states[nodes, 1], atol=1e-9)
        slopes = np.tril(peak_slopes[:, :, lane])
        np.testing.assert_allclose(slopes, exact[nodes, 1], atol=1e-3 * scale)


@given(st.integers(0, 100))
@settings(max_examples=10)
def test_ends_of_many_motions_are_those_one_by_one(seed):
    rng = np.random.default_rng(seed)
    durations = rng.uniform(0.0, 0.2, size=(20, 12))
    torques = np.tile(alternating(12), (20, 1))
    arcs = rng.integers(0, 13, size=20).astype(np.intp)
    ends, peaks = roll_to_ends(TASK, ArcBatch(durations, torques, arcs), 0.02, np.inf)
    for row, n in enumerate(arcs):
        states = roll_states(PLANT, START, durations[row, :n], torques[row, :n])
        np.testing.assert_allclose(ends[row], states[-1], rtol=0, atol=1e-4)
        assert peaks[row] >= np.abs(states[:, 1]).max() - 1e-4
    _, cut = roll_to_ends(TASK, ArcBatch(durations, torques, arcs), 0.02, 0.3)
    np.testing.assert_array_equal(cut > 0.3, peaks > 0.3)


@given(st.floats(-1e6, 1e6))
@settings(max_examples=200)
def test_sine_and_cosine(angle):
    sine, cosine = sine_and_cosine(angle)
    assert abs(sine - np.sin(angle)) < 3e-16
    assert abs(cosine - np.cos(angle)) < 3e-16


@pytest.mark.parametrize(('cores', 'threads'), [(1, 1), (2, 2), (3, 3), (16, 4)])
def test_all_cores_help_and_their_number_does_not_matter(monkeypatch, cores, threads):
    one, many = random_batch(170), random_batch(170)  # four chunks
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0})
    alone, together = Budget(math.inf), Budget(math.inf)
    starts = np.tile(START, (170, 1))
    costs = shoot(TASK, starts, one, Steps(12), alone, Effort())
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: range(cores))
    shoot_arcs, used, all_started = shooting.shoot_arcs, set(), threading.Barrier(threads)

    def noted(*arguments):
        if threading.get_ident() not in used:
            used.add(threading.get_ident())
            all_started.wait(60.0)
        return shoot_arcs(*arguments)

    monkeypatch.setattr(shooting, 'shoot_arcs', noted)
    again = shoot(TASK, starts, many, Steps(12), together, Effort())
    assert together.evaluations == alone.evaluations
    assert len(used) == threads
    np.testing.assert_array_equal(one.durations, many.durations)
    np.testing.assert_array_equal(costs, again)


@given(psi=st.floats(-1.9, 1.9), speed=st.floats(0.0, 40.0))
@settings(max_examples=30)
def test_the_least_peak_is_that_of_braking_where_nothing_else_helps(psi, speed):
    start, limit = np.array([np.pi, psi, 0.0, speed]), 2.0
    task = SwingUpTask(PLANT, start, 0.09, 0.09, limit, None)
    found = task.least_peak(Budget(60.0))
    braked = roll_states(PLANT, start, np.full(400, 1e-3), np.full(400, -0.09))
    standing = np.flatnonzero(braked[:, 3] <= 0.0)
    peak = np.abs(braked[: standing[0] + 1, 1]).max()
    assert abs(psi) <= found
    assert found <= max(peak, limit) + 0.01
    if peak > limit + 0.5:
        assert found > limit


def test_the_least_peak_is_not_looked_for_beyond_the_time() -> None:
    """So heavy across the disk's axis it takes a million steps a motion, and all are hopeless."""
    plant = replace(PLANT, inertia=replace(PLANT.inertia, x=1e6))
    task = SwingUpTask(plant, np.array([np.pi, 0.0, 0.0, 0.0]), 0.035, 0.05, 2.0, None)
    assert math.isnan(task.least_peak(Budget(0.0)))
    start, hours = np.array([np.pi, 0.0, 0.0, 5.0]), np.full((1, 1), 1e4)
    one = hours, np.zeros((1, 1)), np.ones(1, np.intp)
    assert roll_ends(plant.coefficients, start, *one, 0.1, 1e9)[1] == np.inf


def test_the_feedback_table_is_what_a_tracker_does_tick_by_tick() -> None:
    rng = np.random.default_rng(0)
    references = rng.normal(size=(20, 4))
    torques, gains = 0.02 * rng.normal(size=20), 0.02 * rng.normal(size=(20, 4))
    table = pendulum_kernels.FeedbackTable(references, torques, gains, 5e-3, 0.03)
    states = pendulum_kernels.roll_feedback(PLANT, np.array([3.0, 0.1, 1.0, -1.0]), table)
    state = states[0]
    for k in range(20):
        error = state - references[k]
        error[0] = (error[0] + np.pi) % (2 * np.pi) - np.pi
        torque = np.clip(torques[k] - gains[k] @ error, -0.03, 0.03)
        state = integrate(PLANT, state, np.array([torque]), 5e-3)
        np.testing.assert_allclose(states[k + 1], state, atol=1e-6)


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('plant', [PLANT, OTHER], ids=['default', 'other'])
def test_the_tip_is_where_markers_have_it_and_it_moves_as_the_plant_does(plant, seed):
    mujoco = pytest.importorskip('mujoco')
    model = mujoco.MjModel.from_xml_string(pendulum_urdf(plant))
    model.opt.gravity[:] = (0.0, 0.0, -plant.gravity)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    assert [model.joint(k).name for k in range(model.njnt)] == ['disk', 'pendulum']
    data = mujoco.MjData(model)
    state = np.random.default_rng(seed).normal(scale=3.0, size=4)
    theta, psi, theta_dot, psi_dot = state
    torque = 0.1 * plant.coefficients.gravity
    data.qpos[:], data.qvel[:] = (psi, theta), (psi_dot, theta_dot)
    data.qfrc_applied[:] = torque, 0.0
    mujoco.mj_forward(model, data)
    rod = data.body('rod')
    along = rod.xmat.reshape(3, 3) @ [0.0, 0.0, 2 * plant.com_distance]
    pivot, tip = pendulum_points(plant, theta, psi)
    np.testing.assert_allclose(rod.xpos, pivot, atol=1e-12)
    np.testing.assert_allclose(rod.xpos + along, tip, atol=1e-12)
    rates = plant.derivative(state, np.array([torque]))
    np.testing.assert_allclose(data.qacc, [rates[3], rates[2]], rtol=1e-9)
    assert data.energy.sum() == pytest.approx(float(plant.energy(state)), rel=1e-9)


@pytest.mark.parametrize('interpolation', ['linear', 'zero_order_hold', 'cubic'])
@pytest.mark.parametrize(('plant', 'pieces'), [(PLANT, 5), (PLANT, 40), (OTHER, 700)])
def test_a_pendulum_is_replayed_as_scipy_does(plant, pieces, interpolation):
    rng = np.random.default_rng(4)
    times = to_nanoseconds(np.append(0.0, np.cumsum(rng.uniform(0.5, 1.5, pieces) * 2.0 / pieces)))
    torques = 0.1 * plant.coefficients.gravity * rng.normal(size=(pieces + 1, 1))
    states = np.tile(START, (pieces + 1, 1))
    plan = Trajectory.of(plant, times, states, torques, interpolation)
    compiled, plain = replay_pendulum(plant, plan), by_scipy(plant, plan)
    assert set(times) <= set(compiled.steps)
    at = np.linspace(0.0, times[-1], 999)
    np.testing.assert_allclose(compiled.states(at), plain.states(at), rtol=0, atol=2e-6)


def test_what_cannot_be_replayed_is_no_number():
    states = np.tile(START, (2, 1))
    plan = Trajectory.of(PLANT, np.array([0.0, 1.0]), states, np.full((2, 1), 1e300))
    assert np.isnan(replay_pendulum(PLANT, plan).states(plan.times)).all()


def trajectory(times, controls, start, interpolation='linear'):
    states = np.tile(np.asarray(start, dtype=float), (len(times), 1))
    return Trajectory.of(ROBOT, times, states, controls, interpolation)


@pytest.mark.parametrize('interpolation', ['linear', 'zero_order_hold'])
@pytest.mark.parametrize('turning', [0.0, 1.0, 20.0])
def test_replay_agrees_with_an_independent_integrator(interpolation, turning):
    rng = np.random.default_rng(2)
    times = np.concatenate([[0.0], np.sort(rng.uniform(0.1, 6.0, 28)), [6.1]])
    controls = rng.uniform(-1, 1, (30, 3)) * [0.4, turning, 0.01 * turning] + [0.4, 0.0, 0.0]
    start = rng.uniform(-1, 1, 7) * [1, 1, 1, 1, 1, turning, 1]
    plan = trajectory(times, controls, start, interpolation)
    rates = robot_rates({'plant.mass': ROBOT.mass, 'plant.inertia': ROBOT.inertia})
    at, states, _ = zip(*replayed(plan.to_dict(), rates, 2e-3), strict=True)
    found = robot_replay.replay(ROBOT, plan, np.array(at))
    assert found == pytest.approx(np.array(states), abs=2e-7)


def test_one_kernel_replays_arrays_of_any_kind_but_no_splines():
    plan = trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)), np.zeros(7))
    assert not plan.times.flags.writeable
    by_columns = replace(plan, controls=np.asfortranarray(plan.controls))
    for known in (plan, by_columns):
        for times in (plan.times, np.array(plan.times)):
            robot_replay.replay(ROBOT, known, times)
    assert len(robot_replay.replayed.signatures) == 1
    with pytest.raises(InvalidProblem, match='held or linear'):
        robot_replay.replay(ROBOT, replace(plan, interpolation='cubic'), plan.times)


def test_kernels_are_recompiled_where_the_sources_of_this_version_change_only(tmp_path):
    """Not for files that an earlier version left; an estimator's equations once were kept."""
    installed = tmp_path / 'tdm_planner'
    shutil.copytree(Path(slopes.__file__).parents[1], installed)
    sources = slopes._sources(installed)
    assert len(sources) > 15
    assert Path(inspect.getfile(EstimatedPendulum)).read_bytes() in sources
    (installed / 'problems' / 'stale.py').write_text('@compiled\ndef stale(): ...\n')
    assert slopes._sources(installed) == sources
    with (installed / 'problems/formation/polynomial_kernels.py').open('a') as kernel:
        kernel.write('# changed\n')
    assert slopes._sources(installed) != sources


class Pair(NamedTuple):
    first: float
    second: float


def stated(k: Pair, states: list[Any], x: Any) -> tuple[Any, ...]:
    a, b = states
    first = k.first * np.sin(a * b) - x / (2.0 + np.cos(b)) ** 2
    return first, 1.0 / (k.second + a * a) + 2.0 * b, b


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    slopes.with_slopes.cache_clear()
    monkeypatch.setattr(slopes, 'FOLDER', tmp_path)
    return tmp_path


def derived() -> Any:
    return slopes.with_slopes(stated, ('states', 'x'), k=Pair, states=2)


def test_values_and_slopes_are_those_of_the_function_for_numbers_and_arrays() -> None:
    k, at = Pair(0.7, 1.3), np.array([0.4, -0.8, 2.0])
    found = np.array(derived()(k, at[:2], at[2])).reshape(4, 3)
    np.testing.assert_allclose(found[0], stated(k, list(at[:2]), at[2]), rtol=1e-14)
    slopes = central(lambda x: stated(k, list(x[:2]), x[2]), at)
    np.testing.assert_allclose(found[1:].T, slopes, atol=1e-8)
    many = derived()(k, np.tile(at[:2, None], 5), np.full(5, at[2]))
    np.testing.assert_allclose(many[0], np.full(5, found[0, 0]), rtol=1e-14)


@pytest.mark.parametrize('writable', [True, False])
def test_the_text_is_written_once_where_that_is_allowed(folder, monkeypatch, writable):
    if not writable:
        monkeypatch.setattr(slopes, 'FOLDER', folder / 'none')
    before = derived()(Pair(0.7, 1.3), [0.4, -0.8], 2.0)
    assert len(list(folder.iterdir())) == writable
    slopes.with_slopes.cache_clear()
    if writable:
        monkeypatch.setattr(slopes, '_text', None)
    assert derived()(Pair(0.7, 1.3), [0.4, -0.8], 2.0) == before
