# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reference motions of robots: ends, derivatives by time and by what is varied; kept ones."""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.direct_method import arc_derivatives, time_derivatives, TimeFactor
from tdm_planner.direct_method.virtual_domain import reciprocal
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.inverse_dynamics import InverseDynamics
from tdm_planner.problems.reference_motion import end_derivatives, ReferenceMotion

TASK = RobotFormation().task


FORMS = [(5, 5, 0, True), (7, 7, 0, False), (9, 5, 0, True), (7, 5, 2, False), (7, 7, 3, True)]


def moving_task(seed):
    rng = np.random.default_rng(seed)
    return replace(
        TASK,
        velocity=rng.normal(0, 0.05, (3, 2)),
        acceleration=rng.normal(0, 0.02, (3, 2)),
        yaw_rate=rng.normal(0, 0.1, 3),
        yaw_acceleration=rng.normal(0, 0.05, 3),
        coast=rng.uniform(0, 2, 3),
    )


def random_parameters(model, seed):
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 0.3, (3, model.size))
    z[:, : model.nb] = rng.uniform(0.6, 1.4, (3, model.nb))
    return z


def in_time(model, motion, s, derivative):
    """Positions and attitudes (n, 3) at arc s, differentiated with respect to time."""
    speed = reciprocal([(motion.rates @ model.speed_basis(s, d))[:, None] for d in range(2)])

    def along(d):
        position = motion.position @ model.values(s, d)
        yaw = motion.yaw @ model.yaw_values(s, d)
        return np.concatenate([position, yaw[:, None]], axis=1)

    return time_derivatives([along(d) for d in range(derivative + 1)], speed)[derivative]


@given(form=st.sampled_from(FORMS), seed=st.integers(0, 1000))
@settings(deadline=None, max_examples=40, derandomize=True)
def test_boundary_conditions_hold_whatever_is_varied(form, seed):
    task = moving_task(seed)
    model = ReferenceMotion(task, *form)
    motion = model.unpack(random_parameters(model, seed))
    start = np.concatenate([task.departure, task.departure_yaw[:, None]], axis=1)
    assert in_time(model, motion, 0.0, 0) == pytest.approx(start, abs=1e-9)
    goal = np.concatenate([task.goal, task.goal_yaw[:, None]], axis=1)
    assert in_time(model, motion, 1.0, 0) == pytest.approx(goal, abs=1e-9)
    rates = np.concatenate([task.velocity, task.yaw_rate[:, None]], axis=1)
    assert in_time(model, motion, 0.0, 1) == pytest.approx(rates, abs=1e-9)
    assert in_time(model, motion, 1.0, 1) == pytest.approx(np.zeros((3, 3)), abs=1e-9)
    given_axes = slice(0, 3) if not model.vary_ends else slice(2, 3)
    bends = np.concatenate([task.acceleration, task.yaw_acceleration[:, None]], axis=1)
    assert in_time(model, motion, 0.0, 2)[:, given_axes] == pytest.approx(
        bends[:, given_axes], abs=1e-9
    )
    assert in_time(model, motion, 1.0, 2)[:, given_axes] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('form', FORMS)
def test_initial_rates_become_derivatives_along_the_arc_as_everywhere(form):
    task = moving_task(11)
    model = ReferenceMotion(task, *form)
    motion = model.unpack(random_parameters(model, 11))
    speed = reciprocal([(motion.rates @ model.speed_basis(0.0, d))[:, None] for d in range(2)])
    expected = arc_derivatives([task.departure, task.velocity, task.acceleration], speed)
    given = 2 if model.vary_ends else 3
    assert np.moveaxis(motion.position, -1, 0)[:given] == pytest.approx(np.array(expected[:given]))
    yaw = [task.departure_yaw, task.yaw_rate, task.yaw_acceleration]
    expected = arc_derivatives([value[:, None] for value in yaw], speed)
    assert motion.yaw.T[:3] == pytest.approx(np.array(expected)[..., 0])


@pytest.mark.parametrize('form', FORMS)
def test_inverse_dynamics_are_those_of_the_virtual_domain(form):
    model = ReferenceMotion(moving_task(13), *form)
    motion = model.unpack(random_parameters(model, 13))
    nodes = np.linspace(0.0, 1.0, 7)
    values = InverseDynamics(model, nodes).at(motion)
    expected = [in_time(model, motion, s, 2) for s in nodes]
    found = values.y / values.mu[:, None]
    assert found == pytest.approx(np.moveaxis(np.array(expected), 0, -1))


def test_time_along_the_arc_is_that_of_a_time_factor():
    model = ReferenceMotion(moving_task(17), 7, 5, 2)
    motion = model.unpack(random_parameters(model, 17))
    t = np.linspace(0.0, 40.0, 41)
    expected = [
        TimeFactor(rates, 1.0).arc_at(t - coast)
        for rates, coast in zip(motion.rates, model.task.coast, strict=True)
    ]
    assert model.arc_at(motion, t) == pytest.approx(np.array(expected), abs=1e-12)
    robots = np.arange(t.size) % 3
    chosen = np.array(expected)[robots, np.arange(t.size)]
    assert model.arcs(motion, robots, t) == pytest.approx(chosen, abs=1e-12)


@pytest.mark.parametrize('order', [7, 9, 11])
@pytest.mark.parametrize('vary', [True, False])
def test_free_shapes_are_orthonormal_in_their_curvature(order, vary):
    polynomials = end_derivatives(order, vary)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    curvature = polynomials.basis.values((nodes + 1) / 2, 2) @ polynomials.free
    gram = curvature.T @ (weights[:, None] / 2 * curvature)
    assert gram == pytest.approx(np.eye(len(gram)), abs=1e-8)


def test_robots_coast_before_and_are_parked_after():
    task = moving_task(5)
    model = ReferenceMotion(task)
    motion = model.unpack(random_parameters(model, 5))
    places = model.position_at(motion, np.array([0.0, 1e4]))
    assert places[:, :, 0] == pytest.approx(task.start)
    assert places[:, :, 1] == pytest.approx(task.goal)


@pytest.mark.parametrize('form', FORMS)
@pytest.mark.parametrize('at_fixed_time', [True, False])
def test_derivatives_of_points(form, at_fixed_time):
    model = ReferenceMotion(moving_task(7), *form)
    z = random_parameters(model, 7)
    robots = np.array([0, 1, 2])
    t = model.unpack(z).durations * [0.3, 0.5, 0.8] + model.task.coast
    arcs = np.diagonal(model.arc_at(model.unpack(z), t)).copy()

    def places(z):
        motion = model.unpack(z)
        s = np.diagonal(model.arc_at(motion, t)).copy() if at_fixed_time else arcs
        return model.points(motion, robots, s, at_fixed_time)[0]

    _, jacobian = model.points(model.unpack(z), robots, arcs, at_fixed_time)
    for column in range(model.size):
        step = np.zeros_like(z)
        step[:, column] = 1e-6
        numeric = (places(z + step) - places(z - step)) / 2e-6
        assert jacobian[:, :, column] == pytest.approx(numeric, abs=1e-5)
