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
    chebyshev_nodes,
    quadrature_weights,
    reciprocal,
    time_derivatives,
)
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation_program import FormationProgram
from tdm_planner.problems.formation_seeds import BowSeeds
from tdm_planner.problems.reference_motion import MotionForm, ReferenceMotion

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


def program_and_point(form, moving=False, task=None, seed=0):
    model = ReferenceMotion(task or crowded_task(moving), FORMS[form])
    program = FormationProgram(model)
    rng = np.random.default_rng(seed)
    xi = program.reduce(next(iter(BowSeeds(model, rng))))
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
    assert all(mask.any() for mask in near[::2])

    def margins(x):
        here = program.values(x)
        rows = (here.thrust, here.torque, here.walls)
        return np.concatenate([row[mask] for row, mask in zip(rows, near, strict=True)])

    count = margins(xi).size
    assert at.inequalities[:count] == pytest.approx(margins(xi))
    assert at.inequality_jacobian[:count] == pytest.approx(central(margins, xi), abs=1e-5)


def places(program, xi, t):
    """Positions (n, 2, K) at common instants, coasting before and parked after."""
    model, motion = program.model, program.motion(xi)
    early = np.minimum(t - model.task.coast[:, None], 0.0)
    found = motion.position @ np.swapaxes(model.values(model.arc_at(motion, t)), 1, 2)
    return found + model.task.velocity[..., None] * early[:, None]


def test_separations_against_differences(made):
    """At fixed instants, between robots and from what stands still."""
    program, xi = made
    pairs, task = program.values(xi).pairs, program.model.task
    first, second = program.pairs(program.values(xi))
    centres, clearances = task.circles()
    still = second >= task.n
    assert still.any()

    def margins(x):
        at = places(program, x, pairs.time)
        every = np.arange(pairs.time.size)
        beside = at[np.minimum(second, task.n - 1), :, every]
        beside[still] = centres[second[still] - task.n]
        wanted = task.pair_clearances(first, np.minimum(second, task.n - 1))
        wanted[still] = clearances[first[still], second[still] - task.n]
        return np.linalg.norm(at[first, :, every] - beside, axis=1) / wanted - 1.0

    rows = program.linearise(program.evaluate(xi), None).inequality_jacobian
    first_row = len(rows) - pairs.margins.size
    assert pairs.margins == pytest.approx(margins(xi), abs=1e-9)
    assert rows[first_row:] == pytest.approx(central(margins, xi), abs=1e-5)


@pytest.mark.parametrize('form', FORMS)
def test_nearest_approaches_are_those_of_a_dense_sampling(form):
    program, xi = program_and_point(form)
    near = program.values(xi).pairs
    dense = places(program, xi, np.linspace(0.0, 60.0, 6001))
    i, j = np.triu_indices(3, 1)
    distances = np.linalg.norm(dense[i] - dense[j], axis=1).min(axis=1)
    margins = distances / program.model.task.pair_clearances(i, j) - 1.0
    for k, margin in enumerate(margins):
        if margin < 0.5:
            assert near.margins[near.pair == k].min() == pytest.approx(margin, abs=5e-3)


@pytest.mark.parametrize('with_multipliers', [False, True])
def test_hessian_of_gas_and_thrust_rows(made, with_multipliers):
    """Against differences of the gradient of the Lagrangian, its eigenvalues lifted alike."""
    program, xi = made
    at = program.linearise(program.evaluate(xi), None)
    tags, values = at.tags, program.values(xi)
    dual = np.zeros(values.thrust.shape)
    if with_multipliers:
        dual = np.random.default_rng(0).uniform(0, 1, dual.shape) * (values.thrust < 0.34)
    inequalities = np.zeros(at.inequalities.size)
    inequalities[: tags[0].size] = dual[tags]
    hessian = program.linearise(
        program.evaluate(xi), Multipliers(np.zeros(0), inequalities, tags)
    ).hessian
    size = program.model.size

    def gradient(x):
        """Of the smooth part of J less the multipliers times the thrust rows."""
        here = program.linearise(program.evaluate(x), None)
        return here.gradient - dual[here.tags] @ here.inequality_jacobian[: here.tags[0].size]

    numeric = central(gradient, xi, 1e-5)
    blocks = np.zeros((3 * size,) * 2)
    blocks[np.ix_(program.free, program.free)] = 0.5 * (numeric + numeric.T)
    robot = np.arange(3)
    per_robot = blocks.reshape(3, size, 3, size)[robot, :, robot]
    expected = program.definite(per_robot)
    assert hessian == pytest.approx(expected, rel=1e-3, abs=2e-4 * np.abs(expected).max())


def test_thrust_torque_and_gas_are_those_of_the_virtual_domain(made):
    program, xi = made
    model, task, motion = program.model, program.model.task, program.motion(xi)
    s = chebyshev_nodes(model.form.points)
    weights = quadrature_weights(s)
    mu = motion.rates @ model.speed_basis(s, 0).T
    speed = reciprocal([mu[:, None], (motion.rates @ model.speed_basis(s, 1).T)[:, None]])
    path = [motion.position @ model.values(s, d).T for d in range(3)]
    turn = [(motion.yaw @ model.yaw_values(s, d).T)[:, None] for d in range(3)]
    force = np.linalg.norm(time_derivatives(path, speed)[2], axis=1)
    torque = np.abs(time_derivatives(turn, speed)[2][:, 0])
    values = program.values(xi)
    assert values.thrust == pytest.approx(1.0 - force / (0.99 * task.thrust), abs=2e-6)
    assert values.torque == pytest.approx(1.0 - torque / task.torque)
    gas = (mu * np.hypot(force, 0.03 * task.thrust)) @ weights
    assert values.gas == pytest.approx(gas)
    assert values.durations == pytest.approx(mu @ weights)


def test_minimiser_reaches_a_feasible_minimum():
    task = RobotFormation().task
    program = FormationProgram(ReferenceMotion(task))
    seeds = BowSeeds(program.model, np.random.default_rng(0))
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
        program, xi = program_and_point('default', task=replace(RobotFormation().task, **change))
        assert words in program.binding(program.evaluate(xi))


def test_held_motions_are_avoided_and_not_varied() -> None:
    task = RobotFormation().task
    model = ReferenceMotion(task)
    every = FormationProgram(model)
    guess = np.random.default_rng(3).normal(scale=0.05, size=(task.n, model.size))
    guess[:, 0] = 1.0
    held = np.full_like(guess, np.nan)
    held[1] = guess[1]
    program = FormationProgram(model, held=held)
    xi = program.reduce(guess)
    assert xi.size == every.reduce(guess).size - model.size
    np.testing.assert_array_equal(program.full(xi)[1], guess[1])
    np.testing.assert_allclose(program.full(xi), guess)
    with_it, without = program.values(xi), every.values(guess.ravel())
    np.testing.assert_allclose(with_it.gas, without.gas)
    np.testing.assert_allclose(with_it.pairs.margins, without.pairs.margins)
    assert (with_it.thrust[1] > 1.0).all()
    np.testing.assert_array_equal(with_it.thrust[[0, 2]], without.thrust[[0, 2]])
    rows = program.linearise(program.evaluate(xi), None).inequality_jacobian
    assert rows.shape[1] == xi.size
    held[0] = guess[0]  # two kept robots leave the third all the room there is
    program = FormationProgram(model, held=held)
    values = program.values(program.reduce(guess))
    first, second = program.pairs(values)
    assert (values.pairs.margins[(first < 2) & (second < 2)] > 1.0).all()
