# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip('rclpy')

from visualization_msgs.msg import Marker

from tdm_planner.nodes.markers import LONGEST_PATH, pendulum_markers, pendulum_points
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.trajectory import Trajectory

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


def test_without_a_plan_there_is_only_the_rig() -> None:
    markers = pendulum_markers(PLANT, np.array([0.0, 0.0, 0.0, 0.0]), None).markers
    assert [marker.ns for marker in markers] == ['base', 'disk', 'arm', 'rod']
    tip = markers[-1].points[1]
    assert (tip.x, tip.y, tip.z) == pytest.approx((0.085, 0.0, 0.129))
    assert {marker.header.frame_id for marker in markers} == {'world'}


def test_the_path_is_thinned_but_keeps_its_ends() -> None:
    count = 5000
    theta = np.linspace(math.pi, 0.0, count)
    plan = Trajectory(
        times=np.linspace(0.0, 1.0, count),
        states=np.stack([theta, 0.1 * theta, 0 * theta, 0 * theta], axis=1),
        controls=np.zeros((count, 1)),
        state_names=('theta', 'psi', 'theta_dot', 'psi_dot'),
        control_names=('torque',),
    )
    markers = pendulum_markers(PLANT, plan.states[0], plan).markers
    path = next(marker for marker in markers if marker.type == Marker.LINE_STRIP)
    assert len(path.points) == LONGEST_PATH
    _, tips = pendulum_points(PLANT, plan.states[[0, -1], 0], plan.states[[0, -1], 1])
    ends = [[point.x, point.y, point.z] for point in (path.points[0], path.points[-1])]
    assert np.allclose(ends, tips)
