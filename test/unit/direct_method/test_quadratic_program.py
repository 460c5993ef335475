# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from tdm_planner.direct_method.quadratic_program import solve_quadratic_program


def random_program(seed, n, m):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(n, n))
    hessian = factor @ factor.T + 0.1 * np.eye(n)
    return (
        hessian,
        rng.normal(size=n),
        rng.normal(size=(m, n)),
        rng.normal(size=m) - 1.0,
        np.full(n, -2.0),
        np.full(n, 2.0),
    )


def optimality(program, solution):
    """Largest residual of the Karush-Kuhn-Tucker conditions, bounds by projection."""
    hessian, gradient, rows, least, lower, upper = program
    d, dual = solution.step, solution.multipliers
    reduced = hessian @ d + gradient - rows.T @ dual
    at_lower, at_upper = d <= lower + 1e-7, d >= upper - 1e-7
    stationary = np.where(
        at_lower, np.minimum(reduced, 0), np.where(at_upper, np.maximum(reduced, 0), reduced)
    )
    return max(
        np.abs(stationary).max(),
        (least - rows @ d).max(initial=0.0),
        np.abs(dual * (rows @ d - least)).max(initial=0.0),
        (-dual).max(initial=0.0),
    )


@given(seed=st.integers(0, 10**6), n=st.integers(1, 12), m=st.integers(0, 20))
@settings(deadline=None, max_examples=60, derandomize=True)
def test_a_solution_satisfies_the_optimality_conditions(seed, n, m):
    program = random_program(seed, n, m)
    solution = solve_quadratic_program(*program)
    if solution is None:  # then no point satisfies the rows: ask a linear program
        from scipy.optimize import linprog

        _, _, rows, least, lower, upper = program
        bounds = list(zip(lower, upper, strict=True))
        assert linprog(np.zeros(n), -rows, -least, bounds=bounds).status == 2
    else:
        assert optimality(program, solution) < 1e-5


def test_contradictory_rows_give_none():
    rows, least = np.array([[1.0], [-1.0]]), np.array([1.0, 1.0])
    bounds = np.full(1, -5.0), np.full(1, 5.0)
    assert solve_quadratic_program(np.eye(1), np.zeros(1), rows, least, *bounds) is None
