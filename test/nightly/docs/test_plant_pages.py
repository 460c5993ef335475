# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The worked plants, each against what is known of its optimum."""

from dataclasses import replace

import numpy as np
import pytest
from tdm_planner.problems import DirectSolverParameters

DIRECT = DirectSolverParameters(deadline=120.0, refine=False)
REFINED = DirectSolverParameters(deadline=120.0)


def check_plan(solution):
    assert solution.verification.ok
    assert min(solution.verification.worst.values(), default=0.0) > -1e-4


def test_double_integrator_approaches_the_optimum_with_every_parameter():
    from double_integrator import table

    times = table((0, 2, 4, 8, 20))
    assert times[0] == pytest.approx(np.sqrt(6.0), rel=1e-4)  # the cubic
    assert all(b < a for a, b in zip(list(times.values()), list(times.values())[1:], strict=False))
    assert 2.0 < times[20] < 2.02
    assert times[4] < 1.05 * 2.0


def test_brachistochrone_is_the_cycloid():
    from brachistochrone import Brachistochrone, cycloid_time

    for across, down in ((2.0, 1.0), (0.5, 1.0)):
        problem = Brachistochrone(across=across, down=down, solver=DIRECT)
        solution = problem.solve()
        check_plan(solution)
        best = cycloid_time(across, down, 9.81)
        assert solution.cost == pytest.approx(best, rel=1e-4)
        straight = replace(problem, free=1).solve()
        slide = np.sqrt(2 * (across**2 + down**2) / (9.81 * down))
        assert straight.cost == pytest.approx(slide, rel=1e-4)


def test_round_the_obstacle():
    from obstacle import RoundTheObstacle, shortest_time

    best = shortest_time(2.0, 1.0, 1.0)
    problem = RoundTheObstacle(solver=DIRECT)
    plain = problem.solve()
    quicker = replace(problem, speed_factor_order=3).solve()
    for solution in (plain, quicker):
        check_plan(solution)
        x, y = solution.trajectory.states.T
        assert np.hypot(x, y).min() > 1.0 - 1e-3
    assert best * (1 - 1e-4) < quicker.cost < plain.cost
    assert quicker.cost < 1.005 * best
    refined = replace(problem, solver=REFINED).solve()
    check_plan(refined)
    assert best * (1 - 1e-4) < refined.cost < 1.0005 * best


def test_landing_against_collocation():
    pytest.importorskip('casadi')
    from landing import Landing
    from landing_reference import collocation

    problem = Landing(solver=DIRECT)
    solution = problem.solve()
    check_plan(solution)
    start, end = solution.trajectory.states[[0, -1]]
    np.testing.assert_allclose(start, [0, 0, 60, 25, 0, 0], atol=1e-6)
    np.testing.assert_allclose(end, [500, 300, 2, 16, -0.06, 2.2], atol=1e-6)
    assert solution.parameters.size == 21
    best, finer = (collocation(problem, solution.trajectory, n).cost for n in (40, 80))
    assert best == pytest.approx(finer, rel=1e-4)  # the optimum of the problem, not of the grid
    assert finer * (1 - 1e-4) < solution.cost < 1.01 * finer
    refined = replace(problem, solver=REFINED).solve()
    check_plan(refined)
    assert refined.cost == pytest.approx(finer, rel=1e-3)
    quicker, plain = (
        replace(problem, free=3, speed_factor_order=order).solve().cost
        for order in (problem.speed_factor_order, 0)
    )
    assert quicker < 0.999 * plain
