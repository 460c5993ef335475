# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math

import numpy as np
import pytest
from tdm_planner.plants.pendulum_geometry import pendulum_points, RigShape
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

PLANT = RotaryPendulum()


def test_the_picture_moves_as_the_equations_of_motion_say() -> None:
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


def test_one_tip_is_where_the_vectorised_ones_are() -> None:
    shape = RigShape.of(RotaryPendulum(arm_length=0.3))
    angles = np.random.default_rng(1).normal(scale=3.0, size=(50, 2))
    _, tips = pendulum_points(RotaryPendulum(arm_length=0.3), angles[:, 0], angles[:, 1])
    np.testing.assert_allclose([shape.tip(*pair) for pair in angles], tips, atol=1e-12)


def test_the_base_stands_clear_of_the_hanging_rod() -> None:
    shape = RigShape.of(PLANT)
    assert shape.base_radius < shape.disk_radius - 2 * shape.rod_radius
    assert shape.base_height > shape.rod_length
