# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The rotary pendulum's equations against MuJoCo, differences, and the picture's energy."""

from __future__ import annotations

import dataclasses
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plants import PendulumInertia, RotaryPendulum
from tdm_planner.plants.pendulum_geometry import pendulum_points, RigShape

PLANT = RotaryPendulum()


STATES = st.tuples(
    st.floats(-7.0, 7.0), st.floats(-3.0, 3.0), st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)
).map(np.array)


TORQUES = st.floats(-0.1, 0.1).map(lambda torque: np.array([torque]))


def random_states(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, size=(count, 4)) * [np.pi, 2.0, 8.0, 8.0]


def integrate(plant: RotaryPendulum, state: np.ndarray, torque: float, times: np.ndarray):
    control = np.array([torque])
    result = solve_ivp(
        lambda t, x: plant.derivative(x, control),
        (times[0], times[-1]),
        state,
        method='DOP853',
        rtol=1e-12,
        atol=1e-12,
        t_eval=times,
    )
    return result.y.T


@given(STATES, TORQUES)
@settings(deadline=None, derandomize=True)
def test_power_of_the_torque_is_the_rate_of_energy(state, torque):
    step = 1e-6
    rate = PLANT.derivative(state, torque)
    change = (PLANT.energy(state + step * rate) - PLANT.energy(state - step * rate)) / (2 * step)
    power = torque[0] * state[3]
    assert change == pytest.approx(power, rel=1e-5, abs=1e-6)


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


def mujoco_model(plant: RotaryPendulum) -> str:
    """Return a disk about the vertical, the pendulum hinged to its rim; x is radial."""
    inertia = plant.inertia
    return f"""
    <mujoco>
      <option gravity="0 0 -{plant.gravity}" integrator="RK4" timestep="1e-4"/>
      <worldbody>
        <body>
          <joint name="psi" axis="0 0 1"/>
          <inertial pos="0 0 0" mass="1"
            diaginertia="{inertia.disk} {inertia.disk} {inertia.disk}"/>
          <body pos="{plant.arm_length} 0 0">
            <joint name="theta" axis="-1 0 0"/>
            <inertial pos="0 0 {plant.com_distance}" mass="{plant.mass}"
              diaginertia="{inertia.z} {inertia.x} {inertia.y}"/>
          </body>
        </body>
      </worldbody>
      <actuator><motor joint="psi"/></actuator>
    </mujoco>"""


@pytest.mark.parametrize('seed', range(3))
def test_agrees_with_mujoco(seed):
    mujoco = pytest.importorskip('mujoco')
    rng = np.random.default_rng(seed)
    plant = RotaryPendulum(
        mass=rng.uniform(0.01, 0.2),
        com_distance=rng.uniform(0.05, 0.2),
        arm_length=rng.uniform(0.05, 0.2),
        inertia=PendulumInertia(
            disk=rng.uniform(1e-4, 1e-3), x=6e-5 * rng.uniform(0.9, 1.1), y=1e-5, z=6e-5
        ),
    )
    (state,) = random_states(1, seed)
    torque = rng.uniform(-0.05, 0.05)
    model = mujoco.MjModel.from_xml_string(mujoco_model(plant))
    data = mujoco.MjData(model)
    # In the model's joints psi comes first.
    data.qpos[:], data.qvel[:], data.ctrl[0] = state[[1, 0]], state[[3, 2]], torque
    for _ in range(5_000):
        mujoco.mj_step(model, data)
    expected = np.array([data.qpos[1], data.qpos[0], data.qvel[1], data.qvel[0]])
    found = integrate(plant, state, torque, np.array([0.0, 0.5]))[-1]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@given(STATES, TORQUES)
@settings(deadline=None, derandomize=True)
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
    states = random_states(6).reshape(2, 3, 4)
    controls = np.linspace(-0.1, 0.1, 6).reshape(2, 3, 1)
    together = PLANT.derivative(states, controls), *PLANT.jacobians(states, controls)
    assert [found.shape for found in together] == [(2, 3, 4), (2, 3, 4, 4), (2, 3, 4, 1)]
    for index in np.ndindex(2, 3):
        one = states[index], controls[index]
        alone = PLANT.derivative(*one), *PLANT.jacobians(*one)
        for all_of_them, single in zip(together, alone, strict=True):
            np.testing.assert_allclose(all_of_them[index], single, rtol=1e-12)


def test_upright_is_a_saddle_and_hanging_is_stable():
    upright, by_torque = PLANT.linearise('upright')
    hanging, _ = PLANT.linearise('hanging')
    # A theta'' + B psi'' = m g l theta, B theta'' + J psi'' = T, solved by hand at theta = 0.
    k = PLANT.coefficients
    j = k.disk + k.disk_cosine
    determinant = k.pendulum * j - k.arm**2
    assert upright[2, 0] == pytest.approx(j * k.gravity / determinant, rel=1e-12)
    assert upright[3, 0] == pytest.approx(-k.arm * k.gravity / determinant, rel=1e-12)
    assert by_torque[2, 0] == pytest.approx(-k.arm / determinant, rel=1e-12)
    assert by_torque[3, 0] == pytest.approx(k.pendulum / determinant, rel=1e-12)
    assert np.linalg.eigvals(upright).real.max() > 1.0
    assert np.linalg.eigvals(hanging).real.max() < 1e-6


@given(STATES, TORQUES)
@settings(deadline=None, derandomize=True)
def test_inverse_dynamics_invert(state, torque):
    rate = PLANT.derivative(state, torque)
    found, theta_ddot = PLANT.torque_for(state, rate[3])
    assert found == pytest.approx(torque[0], rel=1e-9, abs=1e-9)
    assert theta_ddot == pytest.approx(rate[2], rel=1e-9, abs=1e-6)


def test_natural_frequency_is_that_of_small_swings_with_the_disk_held():
    heavy_disk = dataclasses.replace(PLANT, inertia=PendulumInertia(disk=1e3))
    hanging, _ = heavy_disk.linearise('hanging')
    frequency = np.abs(np.linalg.eigvals(hanging).imag).max()
    assert frequency == pytest.approx(PLANT.natural_frequency, rel=1e-6)


@pytest.mark.parametrize('name', ['mass', 'com_distance', 'arm_length', 'gravity'])
@pytest.mark.parametrize('value', [0.0, -1.0, float('nan'), float('inf'), 'much', None])
def test_values_that_are_not_physical_are_refused(name, value):
    with pytest.raises(InvalidProblem, match=name):
        RotaryPendulum(**{name: value})


def test_inertias_that_make_the_equations_singular_are_refused():
    for axis in ('disk', 'x', 'y', 'z'):
        with pytest.raises(InvalidProblem, match=axis):
            PendulumInertia(**{axis: 0.0})
    with pytest.raises(InvalidProblem, match='plant'):
        RotaryPendulum(inertia=PendulumInertia(disk=1e-300, x=1e-300, y=1e-300, z=1e-300))
    with pytest.raises(InvalidProblem, match='plant'):
        RotaryPendulum(mass=1e-300)
