# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The worked plants against what is known of their optima; what the pages on the paper claim."""

from dataclasses import replace
import itertools

from brachistochrone import Brachistochrone, cycloid_time
import double_integrator
from landing import Landing
from landing_reference import collocation
import misprints
import numpy as np
from obstacle import RoundTheObstacle, shortest_time
import pendulum_scheme as scheme
import pytest
import robots_scheme as robots
from tdm_planner.plants import RotaryPendulum
from tdm_planner.problems import DirectSolverParameters

DIRECT = DirectSolverParameters(deadline=120.0, refine=False)
REFINED = DirectSolverParameters(deadline=120.0)


def check_plan(solution):
    assert solution.verification.ok
    assert min(solution.verification.worst.values(), default=0.0) > -1e-4


def test_double_integrator_approaches_the_optimum_with_every_parameter():
    times = double_integrator.table((0, 2, 4, 8, 20))
    assert times[0] == pytest.approx(np.sqrt(6.0), rel=1e-4)  # the cubic
    assert all(b < a for a, b in itertools.pairwise(times.values()))
    assert 2.0 < times[20] < 2.02
    assert times[4] < 1.05 * 2.0


def test_brachistochrone_is_the_cycloid():
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
    best = shortest_time(2.0, 1.0, 1.0)
    problem = RoundTheObstacle(solver=DIRECT)
    plain, quicker = problem.solve(), replace(problem, speed_factor_order=3).solve()
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
    quicker = replace(problem, free=3).solve().cost
    assert quicker < 0.999 * replace(problem, free=3, speed_factor_order=0).solve().cost


PLANT = RotaryPendulum()


def test_every_misprint_breaks_the_energy_balance_and_the_right_equations_are_the_plants():
    state = np.array([0.7, 0.2, -3.0, 5.0])
    expected = PLANT.derivative(state, np.array([0.01]))[2:]
    np.testing.assert_allclose(misprints.accelerations(PLANT, state, 0.01, ()), expected)
    assert misprints.energy_error(()) < 1e-9
    for name in misprints.MISPRINTS:
        assert misprints.energy_error((name,)) > 0.1, name


def test_orders_of_the_pendulums_schemes():
    switches = np.array([1.2])
    right = scheme.truth(switches)
    assert np.isnan(scheme.printed(101, switches).time)
    mended = [abs(scheme.mended(n, 1.2).time / right.time - 1) for n in (101, 401)]
    completed = [abs(scheme.printed(n, switches, True).time / right.time - 1) for n in (101, 401)]
    assert mended[1] < 1e-4
    assert mended[0] / mended[1] > 12  # second order
    assert completed[1] > 100 * mended[1]


def test_the_plant_follows_the_mended_scheme_ever_closer():
    errors = list(scheme.landing_errors(0.4, 0.063, (80, 160, 320)).values())
    assert errors[0] / errors[1] > 3  # second order
    assert errors[1] / errors[2] > 3


def test_virtual_arc_works_from_above_the_horizontal_not_from_hanging_with_weak_torque():
    ratios = scheme.transfers(np.array([0.8, np.pi]), np.array([0.02, 0.04]))
    assert np.isnan(ratios[:, 1]).all()
    assert (ratios[:, 0] < 1.05).all()
    assert (ratios[:, 0] > 1 - 1e-3).all()


def test_robots_scheme_misses_and_the_exact_inverse_does_not():
    for nodes in (101, 401):
        moving, resting = robots.move(velocity=0.2), robots.move()
        printed = robots.printed(moving, nodes)
        assert printed.speed_factor[1:-3] == pytest.approx(1.0, abs=0.05)
        printed = robots.printed(resting, nodes)
        assert printed.speed_factor[nodes // 2] > 1.5
        assert robots.open_loop_miss(resting, printed) > 0.5
        assert robots.open_loop_miss(resting, robots.exact(resting, nodes)) < 2e-3
    assert robots.yaw_rate_ripple(101) == pytest.approx(1.0)
