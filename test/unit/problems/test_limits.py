# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Limits that jump, that hold in a small part of space, on one side, or at many places."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson, solve_ivp
from stated import Cart, changed, forced, noted, Quickest, refused
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.exceptions import Infeasible, VerificationFailed
from tdm_planner.problems import DirectSolverParameters
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.statement import limits_of

DRIVE = changed(
    Quickest,
    states={'x': 'm', 'v': 'm/s'},
    controls={'u': 'm/s^2'},
    outputs=lambda s: {'x': Output((0.0, 0.0), (10.0, 0.0), free=3)},
    invert=Cart.invert,
    derivative=Cart.derivative,
    control_limits=lambda s: {'u': (-1.0, 1.0)},
    guess=8.0,
)


def crossing(t, x, u):
    """Allow no more than .3 m/s in 10 cm of the way."""
    return np.where(np.abs(x[0] - 5.0) < 0.05, 0.3 - x[1], 1.0)


def gate(t, x, u):
    """Let nothing pass; it is 2 cm wide."""
    return np.clip(np.abs(x[0] - 5.0) - 0.01, -1.0, 0.03)


def pulse(t, x, u):
    """Allow next to no thrust for 40 ms."""
    return np.where(np.abs(t - 2.33) < 0.02, 0.1 - np.abs(u[0]), 1.0)


@pytest.mark.parametrize('limit', [crossing, gate, pulse])
def test_a_limit_that_holds_in_a_small_part_of_the_way_is_kept_or_the_plan_fails(limit):
    problem = changed(DRIVE, margins=lambda s, t, x, u: {'limit': limit(t, x, u)})()
    try:
        plan = problem.solve(counted=True).trajectory
    except VerificationFailed as failed:
        assert 'limit is violated by' in str(failed)
        assert limit is gate
        return
    assert limit is not gate
    plant = DirectPlant(problem)
    times = np.linspace(0.0, plan.duration, 200_001)
    left = limit(times, plant.replay(plan).states(times).T, plan.controls_at(times).T)
    assert left.min() > -1.1e-5


def test_many_limits_are_evaluated_at_once(monkeypatch):
    """A check takes as many calls for two hundred of them as for one."""

    def walls(s, t, x, u):
        return {f'wall {k}': 11.0 + k - x[0] for k in range(200)}

    problem = changed(DRIVE, margins=walls)()
    plan = problem.solve(counted=True).trajectory
    stated = CheckedFormulation(problem)
    calls = noted(monkeypatch, CheckedFormulation, 'margins')
    constraints = limits_of(stated, plan)
    given = plan.times, plan.states, plan.controls
    left = [constraint.margin(*given).min() for constraint in constraints]
    assert left[:200] == pytest.approx(1.0 + np.arange(200), abs=1e-3)
    assert calls.call_count == 2


def test_limits_of_controls_are_numbers():
    given = changed(Cart, control_limits=lambda s: {'u': ('-9', '9')})
    told = "control_limits gives 'u' = ('-9', '9'), expected a pair of numbers"
    assert refused(given().solve).startswith(told)


@pytest.mark.parametrize(('low', 'high'), [(-10.0, 10.0), (-np.inf, 10.0)])
def test_a_reserve_is_a_share_of_the_range_of_a_control_or_of_its_one_limit(low, high):
    problem = changed(
        DRIVE,
        reserve={'u': 0.3},
        control_limits=lambda s: {'u': (low, high)},
        margins=lambda s, t, x, u: {'brake': 1.0 + u[0] / 10.0},
    )()
    assert problem.solve(counted=True).trajectory.controls.max() == pytest.approx(7.0, rel=1e-3)


def test_a_limit_is_broken_at_an_end_only_where_nothing_free_has_a_part_in_it():
    """It is -1 for all of the ends that are likely, and kept from the start on."""
    room = changed(
        DRIVE,
        outputs=lambda s: {'x': Output((50.0, 0.0), (None, 0.0), free=3)},
        duration=lambda s: Duration(3.0, fixed=True),
        control_limits=lambda s: {'u': (-5.0, 5.0)},
        margins=lambda s, t, x, u: {'room': np.clip(1.0 - (x[0] - 50.0) ** 2 / 25.0, -1.0, 1.0)},
        final_cost=lambda s, t, x: -x[0],
    )
    assert room().solve(counted=True).cost == pytest.approx(-55.0, rel=1e-3)


@pytest.mark.parametrize(('refine', 'accuracy'), [(True, 2e-3), (False, 0.2)])
def test_a_start_on_a_limit_but_for_rounding_is_planned_from_in_any_unit(refine, accuracy):
    """On the ground of a planet, whose radius squared is rounded to .008 m^2."""
    radius, at = 6.378e6, 0.012981490745372685
    x, y = radius * np.cos(at), radius * np.sin(at)
    assert x**2 + y**2 - radius**2 == -0.0078125
    rocket = changed(
        Quickest,
        states={'x': 'm', 'y': 'm', 'vx': 'm/s', 'vy': 'm/s'},
        controls={'ax': 'm/s^2', 'ay': 'm/s^2'},
        outputs=lambda s: {
            'x': Output((x, 0.0), (x + 5e4, 0.0), free=3),
            'y': Output((y, 0.0), (y, 0.0), free=3),
        },
        invert=lambda s, y, z: (
            (y['x'][0], y['y'][0], y['x'][1], y['y'][1]),
            (y['x'][2] + 9.8, y['y'][2]),
        ),
        derivative=lambda s, x, u: (x[2], x[3], u[0] - 9.8, u[1]),
        control_limits=lambda s: {'ax': (0.0, 20.0), 'ay': (-1.0, 1.0)},
        margins=lambda s, t, x, u: {'ground': x[0] ** 2 + x[1] ** 2 - radius**2},
        guess=300.0,
    )
    # With 10.2 up and 9.8 down.
    best = (2 * 5e4 * (1 / 10.2 + 1 / 9.8)) ** 0.5
    solver = DirectSolverParameters(refine=refine)
    plan = rocket(solver=solver).solve(counted=True)
    assert plan.duration == pytest.approx(best, rel=accuracy)


def test_a_control_beyond_its_limit_is_told_in_its_unit():
    heavy = changed(
        DRIVE,
        controls={'force': 'N'},
        invert=lambda s, y, z: (y['x'][:2], (1e3 * y['x'][2],)),
        derivative=lambda s, x, u: (x[1], 1e-3 * u[0]),
        control_limits=lambda s: {'force': (-1000.0, 1000.0)},
    )()
    plan = heavy.solve(counted=True).trajectory
    with pytest.raises(Infeasible, match=r'force, lowest is violated by 0\.5 x 1000 N at t ='):
        heavy.recovered({heavy.name: replace(plan, controls=1.5 * plan.controls)})


@pytest.mark.parametrize('refine', [True, False])
def test_a_reserve_is_kept_to_an_end_that_is_free(refine):
    dash = changed(
        DRIVE,
        reserve={'speed': 0.2},
        outputs=lambda s: {'x': Output((0.0, 0.0), (3.0,), free=6)},
        control_limits=lambda s: {'u': (-20.0, 20.0)},
        margins=lambda s, t, x, u: {'speed': 1.0 - x[1]},
        guess=4.0,
    )()
    solver = replace(dash.solver, refine=refine)
    plan = replace(dash, solver=solver).solve(counted=True).trajectory
    assert plan.state('v').max() == pytest.approx(0.8, abs=2e-3)
    assert plan.state('v')[-1] < 0.8 + 1e-4


@pytest.mark.parametrize(('half', 'force'), [(0.02, 2.0), (0.005, 8.0), (0.002, 10.0)])
def test_a_narrow_part_of_the_way_with_other_rates_is_not_stepped_over(half, force):
    """What a plan says of its end is where its controls lead, or there is no plan."""

    def rough(x):
        return np.where(np.abs(x - 1.03) < half, force, 0.0)

    patch = changed(
        DRIVE,
        outputs=lambda s: {'x': Output((0.0, 0.0), (2.0, 0.0), free=6)},
        **forced(lambda x, v: -rough(x)),
        margins=lambda s, t, x, u: {'slow': 1.0 - x[1] ** 2},
        guess=4.0,
    )()
    try:
        plan = patch.solve(counted=True).trajectory
    except VerificationFailed:
        assert half < 0.02
        return
    flown = solve_ivp(
        lambda t, x: patch.derivative(x, plan.controls_at(t)),
        (0.0, plan.duration),
        plan.states[0],
        max_step=1e-3,
        rtol=1e-9,
        atol=1e-9,
    )
    assert flown.y[:, -1] == pytest.approx([2.0, 0.0], abs=2e-3)


def test_rates_with_a_kink_on_one_side_of_which_a_plan_stays_are_no_fault_of_the_program():
    """Such as drag by the square of a speed that never changes its sign."""
    boat = changed(
        DRIVE,
        outputs=lambda s: {'x': Output((0.0, 0.1), (10.0, 0.1), free=3)},
        **forced(lambda x, v: -0.1 * v * np.abs(v)),
    )
    assert boat().solve(counted=True).trajectory.state('v').min() > 0.0


def test_what_a_plan_of_the_direct_method_costs_is_what_its_replay_costs():
    """A state that decides the cost of the end is integrated at nodes, across a jump at x = 1."""
    problem = changed(
        DRIVE,
        states={'x': 'm', 'v': 'm/s', 'y': 'm'},
        outputs=lambda s: {'x': Output((0.0, 0.0), (2.0, 0.0), free=6)},
        integrated=lambda s: {'y': Integrated(0.0)},
        duration=lambda s: Duration(4.0, fixed=True),
        invert=lambda s, y, z: ((*y['x'][:2], z['y']), y['x'][2:]),
        derivative=lambda s, x, u: (
            x[1],
            u[0],
            np.abs(np.sin(2.0 * x[0])) * x[1] - np.sign(x[0] - 1.0) * x[2],
        ),
        control_limits=lambda s: {'u': (-4.0, 4.0)},
        running_cost=lambda s, t, x, u: u[0] ** 2,
        final_cost=lambda s, t, x: 1e6 * (x[2] - 0.3) ** 2,
    )()
    plan = replace(problem, solver=replace(problem.solver, refine=False)).solve(counted=True)
    times = np.linspace(0.0, plan.duration, 40_001)
    flown = DirectPlant(problem).replay(plan.trajectory).states(times).T
    controls = plan.trajectory.controls_at(times).T
    j = simpson(problem.running_cost(times, flown, controls), x=times)
    assert plan.cost == pytest.approx(j + problem.final_cost(4.0, flown[:, -1]), rel=1e-4)
