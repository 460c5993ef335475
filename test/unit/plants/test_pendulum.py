# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The rotary pendulum's equations, and what is compiled of them, against other computations."""

from __future__ import annotations

from itertools import pairwise
import math
import threading

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.plants import pendulum_steering, PendulumInertia, RotaryPendulum
from tdm_planner.plants.base import integrate
from tdm_planner.plants.pendulum_geometry import pendulum_points, RigShape
from tdm_planner.plants.pendulum_kernels import (
    FeedbackTable,
    roll_arcs,
    roll_feedback,
    roll_states,
    sine_and_cosine,
)
from tdm_planner.plants.pendulum_lanes import LANES, roll_lanes
from tdm_planner.plants.pendulum_pumping import NEAR, pump, Pumping
from tdm_planner.plants.pendulum_steering import ArcBatch, ARRIVED, steer
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_seeds import laws
from tdm_planner.tracking.motion import wrapped
from tdm_planner.verification import replay

PLANT = RotaryPendulum()


TORQUES = st.floats(-0.1, 0.1).map(lambda torque: np.array([torque]))


START = np.array([np.pi, 0.0, 0.0, 0.0])


NEVER = lambda: False  # noqa: E731


ARCS = st.lists(st.floats(0.0, 0.1), min_size=1, max_size=7).map(np.array)


STATES = st.tuples(
    st.floats(-4.0, 4.0), st.floats(-2.0, 2.0), st.floats(-8.0, 8.0), st.floats(-8.0, 8.0)
).map(np.array)


def test_the_picture_moves_as_the_equations_of_motion_say():
    """The centre of mass's velocity gives the kinetic energy that `energy` computes."""
    rng = np.random.default_rng(0)
    h = 1e-6
    for theta, psi, theta_dot, psi_dot in rng.normal(size=(20, 4)):
        times = np.array([-h, h])
        ends = pendulum_points(PLANT, theta + theta_dot * times, psi + psi_dot * times)
        centre = np.mean(ends, axis=0)
        velocity = (centre[1] - centre[0]) / (2 * h)
        state = np.array([theta, psi, theta_dot, psi_dot])
        rotation = 0.5 * (
            PLANT.inertia.disk * psi_dot**2
            + PLANT.inertia.z * theta_dot**2
            + PLANT.inertia.x * (math.sin(theta) * psi_dot) ** 2
            + PLANT.inertia.y * (math.cos(theta) * psi_dot) ** 2
        )
        height = PLANT.com_distance * math.cos(theta)
        energy = 0.5 * PLANT.mass * velocity @ velocity + rotation
        energy += PLANT.mass * PLANT.gravity * height
        assert PLANT.energy(state) == pytest.approx(energy, rel=1e-7)


def test_one_tip_is_where_the_vectorised_ones_are():
    shape = RigShape.of(RotaryPendulum(arm_length=0.3))
    angles = np.random.default_rng(1).normal(scale=3.0, size=(50, 2))
    _, tips = pendulum_points(RotaryPendulum(arm_length=0.3), angles[:, 0], angles[:, 1])
    np.testing.assert_allclose([shape.tip(*pair) for pair in angles], tips, atol=1e-12)


MODEL = """
    <mujoco>
      <option gravity="0 0 -{p.gravity}" integrator="RK4" timestep="1e-4"/>
      <worldbody>
        <body>
          <joint name="psi" axis="0 0 1"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{i.disk} {i.disk} {i.disk}"/>
          <body pos="{p.arm_length} 0 0">
            <joint name="theta" axis="-1 0 0"/>
            <inertial pos="0 0 {p.com_distance}" mass="{p.mass}" diaginertia="{i.z} {i.x} {i.y}"/>
          </body>
        </body>
      </worldbody>
      <actuator><motor joint="psi"/></actuator>
    </mujoco>"""


@pytest.mark.parametrize('seed', range(3))
def test_agrees_with_mujoco(seed):
    """A disk about the vertical, the pendulum hinged to its rim; x is radial."""
    mujoco = pytest.importorskip('mujoco')
    rng = np.random.default_rng(seed)
    inertia = PendulumInertia(
        disk=rng.uniform(1e-4, 1e-3), x=6e-5 * rng.uniform(0.9, 1.1), y=1e-5, z=6e-5
    )
    mass, *lengths = rng.uniform([0.01, 0.05, 0.05], [0.2, 0.2, 0.2])
    plant = RotaryPendulum(mass, *lengths, inertia=inertia)
    state = rng.uniform(-1, 1, 4) * [np.pi, 2.0, 8.0, 8.0]
    torque = rng.uniform(-0.05, 0.05, 1)
    model = mujoco.MjModel.from_xml_string(MODEL.format(p=plant, i=inertia))
    data = mujoco.MjData(model)
    # In the model's joints psi comes first.
    data.qpos[:], data.qvel[:], data.ctrl[0] = state[[1, 0]], state[[3, 2]], torque[0]
    for _ in range(5_000):
        mujoco.mj_step(model, data)
    expected = np.array([*data.qpos[::-1], *data.qvel[::-1]])
    found = solve_ivp(
        lambda t, x: plant.derivative(x, torque),
        (0.0, 0.5),
        state,
        'DOP853',
        rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@given(STATES, TORQUES)
def test_jacobians_match_finite_differences(state, torque):
    by_state, by_control = PLANT.jacobians(state, torque)
    for column in range(4):
        step = np.zeros(4)
        step[column] = 1e-6
        difference = (
            PLANT.derivative(state + step, torque) - PLANT.derivative(state - step, torque)
        ) / 2e-6
        np.testing.assert_allclose(by_state[:, column], difference, rtol=1e-6, atol=1e-4)
    difference = PLANT.derivative(state, torque + 0.5) - PLANT.derivative(state, torque - 0.5)
    np.testing.assert_allclose(by_control[:, 0], difference, rtol=1e-9, atol=1e-6)


def test_many_states_at_once_as_one_by_one():
    states = np.random.default_rng(0).normal(size=(2, 3, 4))
    controls = np.linspace(-0.1, 0.1, 6).reshape(2, 3, 1)
    together = PLANT.derivative(states, controls), *PLANT.jacobians(states, controls)
    assert [found.shape for found in together] == [(2, 3, 4), (2, 3, 4, 4), (2, 3, 4, 1)]
    for index in np.ndindex(2, 3):
        one = states[index], controls[index]
        alone = PLANT.derivative(*one), *PLANT.jacobians(*one)
        for all_of_them, single in zip(together, alone, strict=True):
            np.testing.assert_allclose(all_of_them[index], single, rtol=1e-12)


def test_upright_and_hanging():
    for angle, name in ((0.0, 'upright'), (np.pi, 'hanging')):
        at_rest = PLANT.jacobians(np.array([angle, 0.0, 0.0, 0.0]), np.zeros(1))
        for found, expected in zip(PLANT.linearise(name), at_rest, strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.linalg.eigvals(PLANT.linearise('upright')[0]).real.max() > 1.0
    assert np.linalg.eigvals(PLANT.linearise('hanging')[0]).real.max() < 1e-6


def test_values_that_are_not_physical_are_refused():
    for name in ('mass', 'com_distance', 'arm_length', 'gravity'):
        for value in (0.0, -1.0, float('nan'), float('inf'), 'much', None):
            with pytest.raises(InvalidProblem, match=name):
                RotaryPendulum(**{name: value})
    for axis in ('disk', 'x', 'y', 'z'):
        with pytest.raises(InvalidProblem, match=axis):
            PendulumInertia(**{axis: 0.0})
    with pytest.raises(InvalidProblem, match='plant'):
        RotaryPendulum(mass=1e12)  # beside which the inertias are nothing


def alternating(count: int, torque: float = 0.05) -> np.ndarray:
    return torque * (-1.0) ** np.arange(count)


def roll(
    start: np.ndarray, durations: np.ndarray, torques: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    nodes = durations.size * steps + 1
    states, derivatives = np.empty((nodes, 4)), np.empty((nodes, 4, durations.size))
    k = PLANT.coefficients
    roll_arcs(k, start, durations, torques, steps, states, derivatives, True)
    return states, derivatives


def random_batch(count: int) -> ArcBatch:
    rng = np.random.default_rng(3)
    durations = rng.dirichlet(np.full(5, 2.0), size=count) * rng.uniform(0.2, 1.0, (count, 1))
    torques = np.tile(alternating(5, 0.09), (count, 1))
    unknown = np.full(count, np.nan), np.full(count, np.inf)
    return ArcBatch(durations, np.full(count, 5), torques, *unknown)


@given(STATES, ARCS)
@settings(max_examples=30)
def test_derivatives_are_those_of_the_discrete_motion(start, durations):
    torques = alternating(durations.size)
    states, derivatives = roll(start, durations, torques, 6)
    assert states.shape == (6 * durations.size + 1, 4)
    step = 1e-6
    for arc in range(durations.size):
        change = step * (np.arange(durations.size) == arc)
        ahead, _ = roll(start, durations + change, torques, 6)
        behind, _ = roll(start, durations - change, torques, 6)
        difference = (ahead - behind) / (2 * step)
        scale = 1.0 + np.abs(difference).max()
        np.testing.assert_allclose(derivatives[:, :, arc], difference, atol=1e-6 * scale)


@pytest.mark.parametrize('across', [5.0, 10.0, 20.0])
def test_steps_are_shorter_where_the_disk_turns_with_a_heavy_pendulum(across):
    inertia = PendulumInertia(disk=0.05, x=across, y=0.01, z=across)
    plant = RotaryPendulum(1.0, com_distance=1.0, arm_length=0.8, inertia=inertia)
    w0, fall = plant.natural_frequency, np.array([0.3, 0.0, 0.0, 0.0])
    durations, torques = np.full(8, 1.0 / w0), np.zeros(8)
    usual, fine = (
        roll_states(plant, fall, durations, torques, steps)[-1]
        for steps in (math.ceil(12 * plant.quickness), 2000)
    )
    np.testing.assert_allclose(usual / [1, 1, w0, w0], fine / [1, 1, w0, w0], rtol=0, atol=1e-3)


def test_states_are_accurate():
    intervals, torques = np.full(30, 5e-3), alternating(30, 0.09)
    states = roll_states(PLANT, START, intervals, torques, 20)
    expected = START
    for index, torque in enumerate(torques):
        control = np.array([torque])
        expected = solve_ivp(
            lambda t, x, u=control: PLANT.derivative(x, u),
            (0.0, intervals[index]),
            expected,
            method='DOP853',
            rtol=1e-12,
            atol=1e-13,
        ).y[:, -1]
        np.testing.assert_allclose(states[index + 1], expected, rtol=0, atol=1e-9)


def test_steering_arrives_upright_within_the_limit():
    batch = random_batch(60)
    steer(PLANT, START, batch, 2.0, 12, NEVER)
    arrived = np.flatnonzero(batch.costs < ARRIVED)
    assert arrived.size >= 3
    for index in arrived:
        states, _ = roll(START, batch.durations[index], batch.torques[index], 12)
        turns = np.round(states[-1, 0] / (2 * np.pi))
        goal = np.array([2 * np.pi * turns, 0.0, 0.0, 0.0])
        assert np.abs(states[-1] - goal).max() < 1e-4
        assert np.abs(states[:, 1]).max() <= 2.0 + 1e-6
        assert (batch.durations[index] >= 0).all()


@given(STATES, st.integers(4, 7), st.integers(0, 100))
@settings(max_examples=20)
def test_motions_side_by_side_are_those_one_by_one(start, arcs, seed):
    steps, k = 24, PLANT.coefficients
    durations = np.random.default_rng(seed).uniform(0.0, 0.1, size=(arcs, LANES))
    torques = np.tile(alternating(arcs)[:, None], LANES)
    state, derivatives = np.repeat(start, LANES), np.empty((arcs, 4 * LANES))
    disk_slopes = np.zeros((arcs * steps + 1, arcs, LANES))
    peaks, nodes = np.empty((arcs, LANES)), np.empty((arcs, LANES))
    roll_lanes(
        k,
        durations,
        torques,
        arcs,
        steps,
        state,
        derivatives,
        disk_slopes,
        peaks,
        nodes,
    )
    for lane in range(LANES):
        one = durations[:, lane].copy(), torques[:, lane].copy()
        states, exact = roll(start, *one, steps)
        np.testing.assert_allclose(state.reshape(4, LANES)[:, lane], states[-1], atol=1e-9)
        scale = 1.0 + np.abs(exact).max()
        found = derivatives.reshape(arcs, 4, LANES)[:, :, lane]
        np.testing.assert_allclose(found.T, exact[-1], atol=1e-3 * scale)
        np.testing.assert_allclose(disk_slopes[1:, :, lane], exact[1:, 1], atol=1e-3 * scale)
        sizes = np.abs(states[1:, 1]).reshape(arcs, steps)
        np.testing.assert_allclose(np.abs(peaks[:, lane]), sizes.max(axis=1), atol=1e-9)
        at_peaks = states[nodes[:, lane].astype(int), 1]
        np.testing.assert_allclose(at_peaks, peaks[:, lane], atol=1e-9)


@given(st.floats(-1e6, 1e6))
@settings(max_examples=200)
def test_sine_and_cosine(angle):
    sine, cosine = sine_and_cosine(angle)
    assert abs(sine - np.sin(angle)) < 3e-16
    assert abs(cosine - np.cos(angle)) < 3e-16


@pytest.mark.parametrize(('cores', 'threads'), [(1, 1), (2, 1), (3, 2), (16, 4)])
def test_one_core_is_left_and_the_number_of_cores_does_not_matter(monkeypatch, cores, threads):
    one, many = random_batch(170), random_batch(170)  # four chunks
    monkeypatch.setattr(pendulum_steering, '_cores', lambda: 1)
    count = steer(PLANT, START, one, 2.0, 12, NEVER)
    monkeypatch.setattr(pendulum_steering, '_cores', lambda: cores)
    steer_arcs, used, all_started = pendulum_steering.steer_arcs, set(), threading.Barrier(threads)

    def noted(*arguments):
        if threading.get_ident() not in used:
            used.add(threading.get_ident())
            all_started.wait(60.0)
        return steer_arcs(*arguments)

    monkeypatch.setattr(pendulum_steering, 'steer_arcs', noted)
    assert steer(PLANT, START, many, 2.0, 12, NEVER) == count
    assert len(used) == threads
    np.testing.assert_array_equal(one.durations, many.durations)
    np.testing.assert_array_equal(one.costs, many.costs)


def test_steering_stops_when_told():
    batch = random_batch(170)
    before = batch.durations.copy()
    assert steer(PLANT, START, batch, 2.0, 12, lambda: True) == 0
    np.testing.assert_array_equal(batch.durations, before)


def test_pumping_goes_where_it_says():
    k, count, most = PLANT.coefficients, 24, 64
    hanging = np.array([np.pi, 0.0, 0.0, 0.0])
    pumping = Pumping(0.01, 2.0, PLANT.natural_frequency, math.nan, 400.0, 0.01)
    task = SwingUpTask(PLANT, hanging, 0.01, 0.01, 2.0, None)
    variants = laws(task, np.random.default_rng(1), count)
    durations, torques = np.zeros((count, most)), np.zeros((count, most))
    arcs, distances = np.zeros(count, np.intp), np.zeros(count)
    pump(k, hanging, pumping, variants, durations, torques, arcs, distances)
    near = np.flatnonzero(arcs)
    assert near.size >= 10
    assert (distances[near] < NEAR).all()
    for row in near:
        n = arcs[row]
        states = roll_states(PLANT, hanging, durations[row, :n], torques[row, :n], 200)
        scaled = states[-1] / [1.0, 1.0, pumping.w0, pumping.w0]
        scaled[0] = wrapped(scaled[0])
        assert scaled @ scaled == pytest.approx(distances[row], abs=0.05)
        assert np.abs(torques[row]).max() <= 0.01


@given(psi=st.floats(-1.9, 1.9), speed=st.floats(0.0, 40.0))
@settings(max_examples=30)
def test_the_least_peak_is_that_of_braking_where_nothing_else_helps(psi, speed):
    start, limit = np.array([np.pi, psi, 0.0, speed]), 2.0
    task = SwingUpTask(PLANT, start, 0.09, 0.09, limit, None)
    found = task.least_peak()
    braked = roll_states(PLANT, start, np.full(400, 1e-3), np.full(400, -0.09), 4)
    standing = np.flatnonzero(braked[:, 3] <= 0.0)
    peak = np.abs(braked[: standing[0] + 1, 1]).max()
    assert abs(psi) <= found
    assert found <= max(peak, limit) + 0.01
    if peak > limit + 0.5:
        assert found > limit


@pytest.mark.parametrize(('torque', 'method'), [(0.02, 'switching'), (0.09, 'smooth')])
def test_the_replay_agrees_with_scipy(torque: float, method: str) -> None:
    problem = build(PendulumSwingUp, {'limits.torque': torque, 'method': method})
    trajectory = problem.solve(deadline=60.0).trajectory
    times, found = trajectory.times, replay(PLANT, trajectory, trajectory.times)
    control, state = trajectory.controls_at, trajectory.states[0]
    for index, (first, last) in enumerate(pairwise(times)):
        np.testing.assert_allclose(found[index], state, atol=1e-7)
        held = control(first) if method == 'switching' else None
        state = solve_ivp(
            lambda t, x, u=held: PLANT.derivative(x, control(t) if u is None else u),
            (first, last),
            state,
            method='DOP853',
            rtol=1e-12,
            atol=1e-13,
        ).y[:, -1]


def test_the_feedback_table_is_what_a_tracker_does_tick_by_tick() -> None:
    rng = np.random.default_rng(0)
    references = rng.normal(size=(20, 4))
    torques, gains = 0.02 * rng.normal(size=20), 0.02 * rng.normal(size=(20, 4))
    table = FeedbackTable(references, torques, gains, 5e-3, 0.03)
    states = roll_feedback(PLANT, np.array([3.0, 0.1, 1.0, -1.0]), table)
    state = states[0]
    for k in range(20):
        error = state - references[k]
        error[0] = (error[0] + np.pi) % (2 * np.pi) - np.pi
        torque = np.clip(torques[k] - gains[k] @ error, -0.03, 0.03)
        state = integrate(PLANT, state, np.array([torque]), 5e-3)
        np.testing.assert_allclose(states[k + 1], state, atol=1e-6)
