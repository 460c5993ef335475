# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The URDF against other readers of it: ROS's own parser, and MuJoCo's dynamics."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from tdm_planner.plants.pendulum_geometry import pendulum_points
from tdm_planner.plants.rotary_pendulum import PendulumInertia, RotaryPendulum
from tdm_planner.views.pendulum_urdf import pendulum_urdf

PLANTS = {
    'default': RotaryPendulum(),
    'other': RotaryPendulum(
        mass=0.3,
        com_distance=0.2,
        arm_length=0.15,
        # Unequal across the rod, to tell the axes apart.
        inertia=PendulumInertia(disk=0.02, x=5e-3, y=1e-3, z=4.5e-3),
    ),
}


@pytest.fixture(params=PLANTS)
def plant(request: pytest.FixtureRequest) -> RotaryPendulum:
    return PLANTS[request.param]


@pytest.fixture
def mujoco() -> ModuleType:
    return pytest.importorskip('mujoco')


def test_ros_reads_links_and_joints(plant: RotaryPendulum) -> None:
    parser = pytest.importorskip('urdf_parser_py.urdf')
    robot = parser.URDF.from_xml_string(pendulum_urdf(plant))
    robot.check_valid()
    assert robot.get_root() == 'world'
    assert robot.get_chain('world', 'rod', links=False) == ['base', 'disk', 'pendulum']
    for name in ('pendulum', 'disk'):  # the names in joint_states
        assert robot.joint_map[name].type == 'continuous'
    assert robot.link_map['rod'].inertial.mass == plant.mass
    for link in robot.links:
        for visual in link.visuals:
            assert visual.geometry.radius > 0
            assert visual.geometry.length > 0
            assert visual.material.name in {material.name for material in robot.materials}


def load(mujoco: Any, plant: RotaryPendulum) -> tuple[Any, Any]:
    model = mujoco.MjModel.from_xml_string(pendulum_urdf(plant))
    model.opt.gravity[:] = (0.0, 0.0, -plant.gravity)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    assert [model.joint(k).name for k in range(model.njnt)] == ['disk', 'pendulum']
    return model, mujoco.MjData(model)


@pytest.mark.parametrize('seed', range(5))
def test_the_tip_is_where_markers_have_it_and_it_moves_as_the_plant_does(
    mujoco: Any, plant: RotaryPendulum, seed: int
) -> None:
    model, data = load(mujoco, plant)
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
