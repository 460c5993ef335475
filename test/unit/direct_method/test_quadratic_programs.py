# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The compiled quadratic programs and the library's against the optimality conditions."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.direct_method.dual_active_set import solve_compiled
from tdm_planner.direct_method.quadratic_program import solve_quadratic_program


def solved(hessian, gradient, rows, least, lower, upper):
    x, multipliers = np.empty(gradient.size), np.empty(least.size)
    ok = solve_compiled(hessian, gradient, rows, least, lower, upper, x, multipliers)
    return (x, multipliers) if ok else None


def random_program(seed, feasible=True):
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 9), rng.integers(0, 15)
    root = rng.normal(size=(n, n))
    hessian = root @ root.T + 10.0 ** rng.uniform(-4, 0) * np.eye(n)
    rows, inside = rng.normal(size=(m, n)), rng.normal(size=n)
    if m > 4:
        rows[1] = -rows[0]  # both sides of one
        rows[3] = rows[2]
    slack = rng.uniform(0.0, 1.0, size=m) * rng.integers(0, 2, size=m)
    least = rows @ inside - slack
    if not feasible:
        rows, least = np.vstack([rows, rows[:1], -rows[:1]]), np.append(least, [1.0, 1.0])
    wide = rng.uniform(0.0, 2.0, size=(2, n))
    lower, upper = inside - wide[0], inside + wide[1]
    lower[rng.uniform(size=n) < 0.3], upper[rng.uniform(size=n) < 0.3] = -1e12, 1e12
    return hessian, 3.0 * rng.normal(size=n), rows, least, lower, upper


@given(st.integers(0, 10**6))
@settings(deadline=None, derandomize=True, max_examples=200)
def test_minimum_is_that_of_the_library_and_optimal(seed):
    program = random_program(seed)
    hessian, gradient, rows, least, lower, upper = program
    library = solve_quadratic_program(*program)
    found = solved(*program), (library.step, library.multipliers)
    for x, multipliers in found:
        scale = 1.0 + np.abs(x).max()
        assert (rows @ x >= least - 1e-8 * scale).all()
        assert (x >= lower - 1e-8 * scale).all()
        assert (x <= upper + 1e-8 * scale).all()
        assert (multipliers >= 0.0).all()
        size = 1.0 + np.abs(multipliers).max(initial=0.0)
        assert np.abs(multipliers * (rows @ x - least)).max(initial=0.0) < 1e-7 * scale * size
        # What is left of the gradient is the bounds' share, of the right sign, at the bounds only.
        left = hessian @ x + gradient - rows.T @ multipliers
        at_lower, at_upper = x < lower + 1e-7 * scale, x > upper - 1e-7 * scale
        assert (left[~at_upper] > -1e-6 * size * scale).all()
        assert (left[~at_lower] < 1e-6 * size * scale).all()
    cost = lambda d: 0.5 * d @ hessian @ d + gradient @ d  # noqa: E731
    assert cost(found[0][0]) == pytest.approx(cost(found[1][0]), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize('seed', range(20))
def test_contradictions_are_noticed(seed):
    program = random_program(seed, feasible=False)
    if len(program[2]) > 2:
        assert solved(*program) is None
        assert solve_quadratic_program(*program) is None


def test_an_indefinite_hessian_is_refused():
    n = 2
    empty, wide = np.zeros((0, n)), np.full(n, 1e12)
    assert solved(np.diag([1.0, -1.0]), np.ones(n), empty, np.zeros(0), -wide, wide) is None


def test_a_projection_with_multipliers_by_hand():
    """The nearest point to (2, 2) with x + y <= 1 and x <= .2 is (.2, .8)."""
    rows, least = np.array([[-1.0, -1.0], [-1.0, 0.0]]), np.array([-1.0, -0.2])
    wide = np.full(2, 1e12)
    x, multipliers = solved(np.eye(2), np.array([-2.0, -2.0]), rows, least, -wide, wide)
    np.testing.assert_allclose(x, [0.2, 0.8], atol=1e-12)
    np.testing.assert_allclose(multipliers, [1.2, 0.6], atol=1e-12)
