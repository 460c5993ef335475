# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The gallery of docs/plants: statements that are short, right, and planned at the optimum."""

import importlib
import inspect
from pathlib import Path
import sys

import numpy as np
import pytest

PLANTS = Path(__file__).resolve().parents[3] / 'docs' / 'plants'
sys.path.insert(0, str(PLANTS))
table = importlib.import_module('table')

STEP = 1e-5  # s


@pytest.fixture(params=table.GALLERY, scope='module')
def page(request):
    return importlib.import_module(request.param)


@pytest.fixture
def cls(page):
    return getattr(page, table.GALLERY[page.__name__])


@pytest.fixture
def problems(page, cls):
    return {
        case: cls.from_parameters(given) for case, given in table.cases(page.VARIATIONS).items()
    }


def taylor(values, time):
    """Return a function and its derivatives at `time` from those at zero, one row each."""
    rows = range(len(values))
    return [
        sum(values[j] * time ** (j - k) / np.prod(np.arange(1.0, j - k + 1)) for j in rows[k:])
        for k in rows[:-1]
    ]


def random_nodes(problem, rng, size):
    """Return derivatives of the outputs, one more than stated, and integrated states."""
    y = {}
    for name, output in problem.outputs().items():
        given, count = output.conditions('start'), output.derivatives + 2
        near = [given.get(k, 0.0) for k in range(count)]
        y[name] = np.array(near)[:, None] + 0.2 * (output.scale or 1.0) * rng.normal(
            size=(count, size)
        )
    z = {
        name: state.start + 0.2 * state.scale * rng.normal(size=size)
        for name, state in problem.integrated().items()
    }
    return y, z


def states_at_start(problem):
    return np.array([getattr(problem.start, name) for name in problem.state_names])


def test_a_statement_is_short(cls):
    parts = cls, type(cls().start)
    lines = [line for part in parts for line in inspect.getsource(part).splitlines()]
    assert sum(bool(line.strip()) for line in lines) < 60


def test_every_plant_has_five_variations_and_best_known_optima(page, cls, problems):
    known = table.best_known()[cls.__name__]
    assert len(page.VARIATIONS) == 5
    assert set(known) == set(problems)
    assert set(page.PUBLISHED) <= set(problems)


def test_the_best_known_optima_are_the_published_ones(page, cls):
    for case, (value, _) in page.PUBLISHED.items():
        cost = table.best_known()[cls.__name__][case]['cost']
        # the vehicle's inertia costs what the literature leaves out
        allowed = 2e-2 if cls.__name__ == 'Auv' else 1e-3
        assert -1e-3 * abs(value) <= cost - value <= allowed * abs(value)


def test_the_rates_of_the_inverted_states_are_the_derivatives(problems):
    rng = np.random.default_rng(5)
    for problem in problems.values():
        y, z = random_nodes(problem, rng, 20)
        x, u = problem.invert({name: taylor(values, 0.0) for name, values in y.items()}, z)
        rates = problem.derivative(x, u)
        ends = []
        for time in (-STEP, STEP):
            moved = {n: v + time * rates[problem.state_names.index(n)] for n, v in z.items()}
            shifted = {name: taylor(values, time) for name, values in y.items()}
            ends.append(problem.invert(shifted, moved)[0])
        for name, a, b, rate in zip(problem.state_names, *ends, rates, strict=True):
            largest = 1.0 + np.abs(rate).max()
            assert np.abs((b - a) / (2 * STEP) - rate).max() < 1e-5 * largest, name


def test_the_boundary_conditions_are_the_start_and_it_keeps_the_limits(problems):
    rng = np.random.default_rng(6)
    for problem in problems.values():
        y, z = random_nodes(problem, rng, 3)
        for name, output in problem.outputs().items():
            for order, value in output.conditions('start').items():
                y[name][order] = value
        z = {name: np.full(3, state.start) for name, state in problem.integrated().items()}
        states, _ = problem.invert({name: values[:-1] for name, values in y.items()}, z)
        start = states_at_start(problem)
        for name, values, wanted in zip(problem.state_names, states, start, strict=True):
            np.testing.assert_allclose(values, wanted, atol=1e-12, err_msg=name)
        columns = [np.full(3, value) for value in start]
        controls = rng.normal(size=(len(problem.control_names), 3))
        for name, margin in problem.margins(np.zeros(3), columns, controls).items():
            if np.ptp(margin) == 0.0:  # of the state alone
                assert margin[0] >= 0.0, name


def test_the_default_is_planned_near_the_best_known_optimum(cls):
    solution = cls().solve()
    best = table.best_known()[cls.__name__]['default']['cost']
    assert solution.verification.ok
    assert solution.cost - best < 0.03 * abs(best)
