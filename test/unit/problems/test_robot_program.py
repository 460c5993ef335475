# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The nonlinear program over robots' motions: derivatives, nearest approaches, minimum."""

from dataclasses import replace
import itertools

import numpy as np
import pytest
from tdm_planner.direct_method.nonlinear_program import Multipliers
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.direct_method.virtual_arc import (
    bernstein_basis,
    chebyshev_nodes,
    quadrature_weights,
    reciprocal,
    time_derivatives,
)
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation.approaches import CLOSENESS, scaled, TIME
from tdm_planner.problems.formation.polynomial_search import guesses
from tdm_planner.problems.formation.program import PolynomialProgram
from tdm_planner.problems.formation.reference_motion import MotionForm, ReferenceMotion

FORMS = {
    'default': MotionForm(7, 5, 0, True),
    'paper': MotionForm(7, 7, 0, False),
    'speed factor': MotionForm(7, 5, 2, False),
    'both': MotionForm(9, 7, 1, True),
}


@pytest.fixture(params=[(form, case) for form in FORMS for case in ('rest', 'stays')], ids=str)
def made(request):
    form, case = request.param
    task = crowded_task(case != 'rest')
    if case == 'stays':
        still = np.concatenate([np.zeros((1, 2)), task.velocity[1:]])
        goal = np.concatenate([task.start[:1], task.goal[1:]])
        task = replace(task, goal=goal, velocity=still)
    return program_and_point(form, task=task)


def crowded_task(moving):
    task = RobotFormation().task
    zones = np.array([[2.0, 1.5, 0.2]])
    if not moving:
        return replace(task, obstacles=zones, separation=0.8)
    rng = np.random.default_rng(4)
    return replace(
        task,
        obstacles=zones,
        separation=0.8,
        velocity=rng.normal(0, 0.05, (3, 2)),
        acceleration=rng.normal(0, 0.02, (3, 2)),
        yaw_rate=rng.normal(0, 0.05, 3),
        coast=np.array([0.5, 0.0, 0.3]),
    )


def program_and_point(form, moving=False, task=None, seed=0, hurry=0.7):
    model = ReferenceMotion(task or crowded_task(moving), FORMS[form])
    program = PolynomialProgram(model)
    rng = np.random.default_rng(seed)
    x = next(guesses(program, rng))
    x[:, : model.nb] *= hurry  # so little time that thrust is near its limit
    xi = program.reduce(x)
    return program, np.clip(xi + rng.normal(0, 0.1, xi.size), program.lower, program.upper)


def central(function, xi, step=1e-6):
    columns = []
    for k in range(xi.size):
        change = np.zeros(xi.size)
        change[k] = step
        columns.append((function(xi + change) - function(xi - change)) / (2 * step))
    return np.stack(columns, axis=-1)


def test_gradient_and_rows_against_differences(made):
    program, xi = made
    point = program.evaluate(xi)
    at = program.linearise(point, None)
    gradient = at.gradient + (at.term_weights * np.sign(at.terms)) @ at.terms_jacobian
    numeric = central(lambda x: np.array(program.evaluate(x).cost), xi)
    assert gradient == pytest.approx(numeric, abs=1e-6)
    values = point.cache
    near = [values.thrust < 0.35, values.torque < 0.5, values.walls < 1.0]
    assert near[0].any()
    assert near[2].any()

    def margins(x):
        """Margins near active: thrust of all robots, then torque and walls of one by one."""
        here = program.evaluate(x).cache
        thrust = [here.thrust[near[0]]]
        rest = [
            row[i][mask[i]]
            for i in range(program.task.n)
            for row, mask in zip((here.torque, here.walls), near[1:], strict=True)
        ]
        return np.concatenate(thrust + rest)

    count = margins(xi).size
    assert at.inequalities[:count] == pytest.approx(margins(xi))
    assert at.inequality_jacobian[:count] == pytest.approx(
        central(margins, xi), rel=1e-6, abs=1e-5
    )


def places(program, xi, t):
    """Positions (n, 2, K) at common instants, coasting before and parked after."""
    model, motion = program.model, program.motion(xi)
    early = np.minimum(t - model.task.coast[:, None], 0.0)
    arcs = np.stack([model.arcs_at(motion, i, t) for i in range(model.task.n)])
    found = motion.position @ np.swapaxes(model.basis.basis.values(arcs), 1, 2)
    return found + model.task.velocity[..., None] * early[:, None]


def test_separations_against_differences(made):
    """At fixed instants, between robots and from what stands still."""
    program, xi = made
    task, point = program.task, program.evaluate(xi)
    found = point.cache.approaches
    first, second = found[:, :2].astype(int).T
    centres, _ = task.circles()
    every = np.arange(len(found))
    assert (second >= task.n).any()

    def margins(x):
        at = places(program, x, found[:, TIME])
        still = np.repeat(centres[..., None], len(found), axis=2)
        at = np.concatenate([at, still])
        away = np.linalg.norm(at[first, :, every] - at[second, :, every], axis=1)
        return away / program.clearances[first, second] - 1.0

    rows = program.linearise(point, None).inequality_jacobian
    assert found[:, CLOSENESS] == pytest.approx(margins(xi), abs=1e-9)
    last = len(found)
    assert rows[-last:] == pytest.approx(central(margins, xi), abs=1e-5)


@pytest.mark.parametrize('form', FORMS)
def test_nearest_approaches_are_those_of_a_dense_sampling(form):
    program, xi = program_and_point(form)
    near = program.evaluate(xi).cache.approaches
    dense = places(program, xi, np.linspace(0.0, 60.0, 6001))
    i, j = np.triu_indices(3, 1)
    distances = np.linalg.norm(dense[i] - dense[j], axis=1).min(axis=1)
    margins = distances / program.task.pair_clearances(i, j) - 1.0
    for one, other, margin in zip(i, j, margins, strict=True):
        if margin < 0.24:
            pair = (near[:, 0] == one) & (near[:, 1] == other)
            assert near[pair, CLOSENESS].min() == pytest.approx(margin, abs=1e-4)


@pytest.mark.parametrize('with_multipliers', [False, True])
def test_hessian_of_gas_and_thrust_rows(made, with_multipliers):
    """Against differences of the gradient of the Lagrangian, its eigenvalues lifted alike."""
    program, xi = made
    at = program.linearise(program.evaluate(xi), None)
    tags, values = at.tags, program.evaluate(xi).cache
    dual = np.zeros(values.thrust.shape)
    if with_multipliers:
        dual = np.random.default_rng(0).uniform(0, 1, dual.shape) * (values.thrust < 0.34)
    inequalities = np.zeros(at.inequalities.size)
    inequalities[: tags[0].size] = dual[tags]
    hessian = program.linearise(
        program.evaluate(xi), Multipliers(np.zeros(0), inequalities, tags)
    ).hessian

    def gradient(x):
        """Of the smooth part of J less the multipliers times the thrust rows."""
        here = program.linearise(program.evaluate(x), None)
        return here.gradient - dual[here.tags] @ here.inequality_jacobian[: here.tags[0].size]

    numeric = central(gradient, xi, 1e-5)
    n, size = program.units.shape
    blocks = np.zeros((n * size,) * 2)
    blocks[np.ix_(program.free, program.free)] = 0.5 * (numeric + numeric.T)
    robot = np.arange(n)
    blocks = blocks.reshape(n, size, n, size)[robot, :, robot]
    expected = scaled(np.ones((n, size)), blocks, *program.curvature, np.zeros((0, n, size)))
    expected = expected[np.ix_(program.free, program.free)]
    assert hessian == pytest.approx(expected, rel=1e-3, abs=2e-4 * np.abs(expected).max())


def test_thrust_torque_and_gas_are_those_of_the_virtual_domain(made):
    program, xi = made
    model, task, motion = program.model, program.model.task, program.motion(xi)
    s = chebyshev_nodes(model.form.points)
    weights = quadrature_weights(s)
    mu, mu_s = (motion.rates @ bernstein_basis(model.form.degree, s, d).T for d in range(2))
    speed = reciprocal([mu[:, None], mu_s[:, None]])
    path = [motion.position @ model.basis.basis.values(s, d).T for d in range(3)]
    turn = [(motion.yaw @ model.yaw_basis.basis.values(s, d).T)[:, None] for d in range(3)]
    force = np.linalg.norm(time_derivatives(path, speed)[2], axis=1)
    torque = np.abs(time_derivatives(turn, speed)[2][:, 0])
    values = program.evaluate(xi).cache
    assert values.thrust == pytest.approx(1.0 - force / (0.99 * task.thrust), abs=2e-6)
    assert values.torque == pytest.approx(1.0 - torque / task.torque)
    gas = (mu * np.hypot(force, 0.03 * task.thrust)) @ weights
    assert values.gas == pytest.approx(gas)
    assert program.durations(values.x) == pytest.approx(mu @ weights)


def test_minimiser_reaches_a_feasible_minimum():
    task = RobotFormation().task
    program = PolynomialProgram(ReferenceMotion(task))
    seeds = guesses(program, np.random.default_rng(0))
    options = TrustRegionOptions(radius=0.15)
    costs = []
    for guess in itertools.islice(seeds, 2):
        minimum = minimise(program, program.reduce(guess), options)
        assert minimum.converged
        assert minimum.point.violation < 2e-3
        costs.append(minimum.point.cost * program.scale)
    assert min(costs) == pytest.approx(1.86, rel=0.05)


def test_names_the_constraint_that_is_violated_most():
    for change, words in (({'torque': 1e-5}, 'limits.torque'), ({'separation': 2.5}, 'arena.')):
        program, xi = program_and_point(
            'default', task=replace(RobotFormation().task, **change), hurry=1.0
        )
        assert words in program.binding(program.evaluate(xi))


def test_held_motions_are_avoided_and_not_varied() -> None:
    task = RobotFormation().task
    model = ReferenceMotion(task)
    every = PolynomialProgram(model)
    x = np.random.default_rng(3).normal(scale=0.05, size=(task.n, model.size)) * model.units
    x[:, 0] = model.time
    held = np.full_like(x, np.nan)
    held[1] = x[1]
    program = PolynomialProgram(model, held=held)
    xi = program.reduce(x)
    assert xi.size == every.reduce(x).size - model.size
    np.testing.assert_array_equal(program.full(xi)[1], x[1])
    np.testing.assert_allclose(program.full(xi), x)
    with_it, without = (p.evaluate(p.reduce(x)).cache for p in (program, every))
    np.testing.assert_allclose(with_it.approaches, without.approaches)
    assert (with_it.thrust[1] > 1.0).all()
    np.testing.assert_array_equal(with_it.thrust[[0, 2]], without.thrust[[0, 2]])
    rows = program.linearise(program.evaluate(xi), None).inequality_jacobian
    assert rows.shape[1] == xi.size
    held[0] = x[0]  # two kept robots leave the third all the room there is
    program = PolynomialProgram(model, held=held)
    found = program.evaluate(program.reduce(x)).cache.approaches
    assert (found[:, 1] >= 2).all()
