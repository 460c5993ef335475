# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Ways round what is stated by a maximum, where formulas have no value; what J a plan tells."""

from __future__ import annotations

import re
from unittest.mock import Mock

from auv import Auv
from brachistochrone import Brachistochrone, cycloid_time
import casadi as ca
from crane import Crane
import numpy as np
from overtaking import Overtaking
import pytest
from stated import Cart, changed, LONG, QUICKEST, Quickest, solve
from tdm_planner.direct_method import Budget, Duration, Integrated, Output
from tdm_planner.direct_method.collocation import CollocatedMotion
from tdm_planner.direct_method.graphs import Bends, Rounded
from tdm_planner.exceptions import NotFinite, VerificationFailed
from tdm_planner.problems import DirectProblem, DirectSolverParameters
from tdm_planner.problems.direct.guesses import Guesses
from tdm_planner.problems.direct.minima import DirectMinima
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import COARSE, Refinement

DIRECT = DirectSolverParameters(deadline=60.0, refine=False)


def upright(self, y, z):
    (x, vx, ax, jx), (h, vz, az, jz) = y['x'], y['z']
    up = az + 9.81
    square = ax**2 + up**2
    return (x, h, vx, vz, np.arctan2(ax, up)), (np.sqrt(square), (jx * up - ax * jz) / square)


def beside_or_within(self, t, x, u):
    beside, within = np.abs(x[0] - self.wall) - self.half, self.width - np.abs(x[1] - self.gap)
    return {'wall': np.maximum(beside, within)}


REST, SHAPE = (0.0, 0.0, 0.0), {'free': 8, 'derivatives': 3}
WINDOW = changed(
    Quickest,
    __doc__='A planar quadrotor through a gap in a thin wall: beside the wall, or within the gap.',
    states={'x': 'm', 'z': 'm', 'vx': 'm/s', 'vz': 'm/s', 'pitch': 'rad'},
    controls={'thrust': 'm/s^2', 'rate': 'rad/s'},
    outputs=lambda s: {
        'x': Output(start=REST, end=(6.0, 0.0, 0.0), scale=3.0, **SHAPE),
        'z': Output(start=REST, end=REST, scale=2.0, **SHAPE),
    },
    invert=upright,
    derivative=lambda s, x, u: (*x[2:4], u[0] * np.sin(x[4]), u[0] * np.cos(x[4]) - 9.81, u[1]),
    control_limits=lambda s: {'thrust': (3.0, 18.0), 'rate': (-6.0, 6.0)},
    margins=beside_or_within,
    **{'wall': 2.5, 'half': 0.4, 'gap': -1.5, 'width': 0.4},  # [m]
)


@pytest.mark.parametrize(
    ('wall', 'half', 'gap', 'width', 'best'),
    [(2.5, 0.4, -1.5, 0.4, 1.70), (3.4, 0.35, 1.0, 0.5, 1.50), (2.2, 0.2, 1.6, 0.7, 1.66)],
)
def test_a_gap_in_a_wall_is_found_from_the_straight_line(wall, half, gap, width, best) -> None:
    """The line leads through the wall: with a sharp kink there is no slope towards the gap."""
    problem = changed(WINDOW, wall=wall, half=half, gap=gap, width=width)()
    budget = Budget(60.0)
    refinement = Refinement(plant := DirectPlant(problem), budget)
    line = Guesses(plant, refinement.ends, budget, 0).line(straight=True, screen=False)
    eased = refinement.from_guess(line, budget, eased=True, patient=False)
    assert eased is not None
    finer = refinement.finer(eased, COARSE)
    assert finer is not None
    assert finer.cost < best


def test_a_thin_wall_that_first_motions_leap_over_is_planned_for() -> None:
    """Between two nodes; what is dearer than such a motion goes round it."""
    problem = changed(WINDOW, wall=4.0, half=0.15, gap=-2.0, width=0.4)(solver=LONG)
    assert problem.solve(counted=True).cost < 1.9


def test_ways_round_are_looked_for_until_three_agree_not_for_as_long_as_there_is_time() -> None:
    """A longer deadline is for harder problems: it costs nothing where the best way is found."""
    short, long = (Overtaking(solver=DirectSolverParameters(deadline=s)) for s in (6.0, 60.0))
    plans = [problem.solve(counted=True) for problem in (short, long)]
    assert plans[0].evaluations == plans[1].evaluations
    assert plans[0].cost == plans[1].cost


def test_a_motion_whose_replay_goes_elsewhere_is_left_for_another(monkeypatch):
    """With twice the intervals it goes elsewhere as soon; more than that would take seconds."""
    asked, solve = [], Refinement.solve
    monkeypatch.setattr(Refinement, 'solve', lambda *a, **k: asked.append(a[1]) or solve(*a, **k))
    found, repaired = [], Refinement.repaired
    monkeypatch.setattr(Refinement, 'repaired', lambda *a: found.append(repaired(*a)) or found[-1])
    bead = Brachistochrone(across=6.0, solver=DirectSolverParameters())
    assert bead.solve(counted=True).cost == pytest.approx(cycloid_time(6.0, 1.0, 9.81), rel=1e-4)
    assert any(motion.diverged for motion in found[:-1])
    assert max(asked) == 80


def test_a_motion_that_more_intervals_do_not_confirm_waits_for_the_others(monkeypatch):
    """It has no solution near: it was the plan."""
    finer, tried = Refinement.finer, []

    def unconfirmed(self, motion, intervals):
        found = finer(self, motion, intervals)
        tried.append(intervals)
        return found if len(tried) > 1 else None

    monkeypatch.setattr(Refinement, 'finer', unconfirmed)
    plan = WINDOW(solver=LONG).solve()
    assert plan.verification.ok
    assert tried[:3] == [20, 20, 40]  # another motion, at once


def test_a_maximum_of_plane_limits_is_an_obstacle_and_a_minimum_is_none() -> None:
    """Neither has a curvature beside its kink."""
    t, x, u, p = (ca.SX.sym(name, size) for name, size in zip('txup', (1, 2, 1, 0), strict=True))
    sides = ca.fabs(x) - 1.0
    limits = ca.vertcat(ca.fmax(sides[0], sides[1]), ca.fmin(-sides[0], -sides[1]), 2.0 - x[0])
    margins = ca.Function('margins', [t, x, u, p], [limits])
    assert Bends(margins, 'x')(np.zeros(0)).tolist() == [True, False, False]
    assert DirectPlant(WINDOW()).obstacles.any()


def test_only_kinks_between_two_limits_are_eased() -> None:
    x = ca.SX.sym('x', 2)
    stated = ca.fmax(ca.fabs(x[0]), ca.sqrt(x[1] ** 2 + x[0] ** 2))
    rounded = Rounded(ca.Function('stated', [x], [stated]))
    assert rounded.count == 3
    assert rounded.either.sum() == 1
    assert not Rounded(ca.Function('smooth', [x], [x[0] * x[1]])).either.any()


def test_a_motion_on_more_intervals_keeps_to_its_range() -> None:
    """A cubic through a sharp peak overshot to below zero, where its logarithm is no number."""
    states = np.array([[1.0], [0.1], [1.0], [1.0]])
    motion = CollocatedMotion(states, 0.5 * (states[1:] + states[:-1]), np.zeros((4, 1)), 3.0)
    finer = motion.on(12, rates=np.array([[-4.0], [-4.0], [4.0], [0.0]]))
    assert min(finer.states.min(), finer.middles.min()) == pytest.approx(0.1)
    assert finer.states[0] == states[0]
    assert finer.states[-1] == states[-1]


STIFF = changed(
    Cart,
    __doc__='A fast lag that the steps between the nodes are too long for.',
    state_names=('y', 'lag'),
    outputs=lambda s: {'y': Output(start=(0.0,), end=(1.0,), free=4, derivatives=1)},
    integrated=lambda s: {'lag': Integrated(0.0)},
    invert=lambda s, y, z: ((y['y'][0], z['lag']), (y['y'][1],)),
    derivative=lambda s, x, u: (u[0], 60.0 * (x[0] - x[1])),
    margins=lambda s, t, x, u: {'speed': 4.0 - u[0] ** 2},
    running_cost=DirectProblem.running_cost,
    final_cost=lambda s, t, x: -x[1],
)


def test_the_cost_is_that_of_the_plan_not_that_of_a_coarse_integration() -> None:
    """J of -1e137 was told of a verified plan whose own states gave -23."""
    plan = STIFF(solver=DirectSolverParameters(deadline=20.0, refine=False)).solve()
    assert plan.cost == pytest.approx(-plan.trajectory.states[-1, 1], rel=1e-9)


def pumped(self, y, z):
    level, rate, change = y['lower']
    flow = 60.0 * rate + 0.7 * np.sqrt(level)
    slope = 60.0 * change + 0.35 * rate / np.sqrt(level)
    upper = flow**2 / 0.64  # of a flow below zero, too, which is none of this plant
    return (upper, level), (flow + 125.0 * flow * slope,)


def flowing(self, x, u):
    down = 0.8 * np.sqrt(x[0])
    return (u[0] - down) / 40.0, (down - 0.7 * np.sqrt(x[1])) / 60.0


TANKS = changed(
    Quickest,
    __doc__="The lower of two tanks is emptied to a level, in least time, by the upper's pump.",
    states={'upper': 'm', 'lower': 'm'},
    controls={'pump': 'L/s'},
    guess=60.0,
    outputs=lambda s: {'lower': Output(start=(0.3, 0.0), end=(0.12, 0.0), free=6)},
    invert=pumped,
    derivative=flowing,
    control_limits=lambda s: {'pump': (0.0, 0.6)},
    margins=lambda s, t, x, u: {'upper': 1.0 - x[0] / 0.45, 'dry': x[0] / 0.01 - 1.0},
)


@pytest.mark.parametrize('seed', [3, 5, 8, 13])
def test_a_motion_beyond_the_plant_does_not_accuse_the_statement(seed) -> None:
    """Of a random flow below zero invert and derivative differ, and of no motion of the plant."""
    assert TANKS(solver=LONG).solve(seed=seed).verification.ok


@pytest.mark.parametrize(('solver', 'best'), [(LONG, 2.0), (DIRECT, 2.156)])
@pytest.mark.parametrize(('unit', 'constant'), [(1.0, 1e6), (1.0, -1e4), (1e-12, 0.0), (1e9, 1.0)])
def test_neither_unit_nor_constant_of_the_cost_changes_the_plan(unit, constant, solver, best):
    def cost(s, t, x):
        return unit * t + constant

    plan = solve(solver, **QUICKEST | {'final_cost': cost})
    assert plan.duration == pytest.approx(best, rel=1e-3)
    assert plan.cost == pytest.approx(cost(None, plan.duration, None))


@pytest.mark.parametrize(
    ('sign', 'words'), [(1, 'at its shortest allowed value, 0.03 s'), (-1, 'longest')]
)
def test_a_duration_that_nothing_but_its_bounds_limits(sign, words):
    unlimited = {'margins': lambda s, t, x, u: {}, 'final_cost': lambda s, t, x: sign * t}
    assert words in solve(**QUICKEST | unlimited).summary
    made, quickest = changed(Cart, **QUICKEST)(), solve(**QUICKEST)
    assert 'allowed value' not in quickest.summary
    assert 2.0 < quickest.cost == pytest.approx(quickest.duration)
    assert made.cost_to_go(quickest, 0.0) == pytest.approx(quickest.cost)


def test_the_summary_tells_what_the_deadline_cut_short():
    hurried, patient = (Auv().solve(deadline=seconds, counted=True) for seconds in (0.15, 3.0))
    told = re.search(r', on (\d+) intervals: J may be lower with a longer', hurried.summary)
    assert int(told[1]) == hurried.trajectory.times.size - 1 < patient.trajectory.times.size - 1
    assert patient.cost < hurried.cost
    assert 'intervals' not in patient.summary


@pytest.mark.parametrize('finite', [True, False])
def test_the_summary_tells_that_more_intervals_lead_to_no_solution(finite, monkeypatch):
    """Also where the direct method cannot be tried, as its guess is not finite."""
    if not finite:
        monkeypatch.setattr(DirectMinima, '__init__', Mock(side_effect=NotFinite('no rates')))
    solve = Refinement.solve
    few = lambda s, n, *a, **k: solve(s, n, *a, **k) if n < 40 else None  # noqa: E731
    monkeypatch.setattr(Refinement, 'solve', few)
    plan = Crane(solver=LONG).solve(counted=True)
    assert plan.trajectory.times.size == 21
    assert ', on 20 intervals, as more lead to no solution: J may be lower' in plan.summary


def test_the_summary_tells_where_rates_without_a_value_keep_collocation_from_a_motion():
    """The level of a tank is to be low, and no limit keeps it from below 0."""
    tank = {
        'states': {'level': 'm'},
        'controls': {'inflow': 'm/s'},
        'outputs': lambda s: {'level': Output((1.0,), (1.0,), free=8, derivatives=1, scale=1.0)},
        'duration': lambda s: Duration(6.0, fixed=True),
        'invert': lambda s, y, z: ((y['level'][0],), (y['level'][1] + np.sqrt(y['level'][0]),)),
        'derivative': lambda s, x, u: (u[0] - np.sqrt(x[0]),),
        'margins': lambda s, t, x, u: {'closed': u[0], 'open': 3.0 - u[0]},
        'running_cost': lambda s, t, x, u: x[0],
        'final_cost': DirectProblem.final_cost,
    }
    plan = changed(Cart, **tank)(solver=LONG).solve(counted=True)
    assert 'attempts: limit the states)' in plan.summary
    kept = tank | {'margins': lambda s, t, x, u: tank['margins'](s, t, x, u) | {'empty': x[0]}}
    better = changed(Cart, **kept)(solver=LONG).solve(counted=True)
    assert 'refined' not in better.summary
    assert better.cost < plan.cost


def test_a_formula_that_has_no_value_somewhere_only_bars_the_way_and_is_named_where_all_fail():
    """The integrand exists only for |u| < 1.7; the least effort of 1.5 is found all the same."""
    logarithm = {'running_cost': lambda s, t, x, u: u[0] ** 2 - 1e-9 * np.log(1.7 - u[0])}
    assert solve(**logarithm).cost == pytest.approx(12 / 2.0**3, rel=1e-5)

    def invert(self, y, z):
        x, v, u = y['x']
        return (x, v), (u + 0 * np.sqrt(0.8 - u),)

    # The cheapest at the nodes goes to where the formula ends, and beyond between them.
    solution = solve(**QUICKEST | {'invert': invert})
    assert np.isfinite(solution.trajectory.controls).all()
    assert 'allowed value' not in solution.summary
    ending = {'derivative': lambda s, x, u: (x[1], u[0] + 0 * np.sqrt(0.9 - u[0]))}
    with pytest.raises(VerificationFailed, match="derivative gives the rate of 'v' = nan"):
        solve(**QUICKEST | ending)


@pytest.mark.parametrize(
    ('change', 'cost', 'constant'),
    [
        (  # chosen once: the gain of the control, J = 1.5 / p^2 + p^2
            {
                'invert': lambda s, y, z: ((*y['x'][:2], y['p'][0]), (y['x'][2] / y['p'][0],)),
                'derivative': lambda s, x, u: (x[1], x[2] * u[0], 0.0),
                'final_cost': lambda s, t, x: x[2] ** 2,
                'margins': lambda s, t, x, u: {'p': x[2] - 0.1},
                'ends': Output((1.0, 0.0), (0.0, 0.0), free=3),
            },
            2.0 * 1.5**0.5,
            1.5**0.25,
        ),
        (  # the same place at both ends, J = 4 / T
            {
                'invert': lambda s, y, z: ((*y['x'][:2], y['p'][0]), y['x'][2:]),
                'derivative': lambda s, x, u: (x[1], u[0], 0.0),
                'final_cost': lambda s, t, x: (x[2] - 0.3) ** 2,
                'start_conditions': lambda s, t, x: [x[0] - x[2]],
                'end_conditions': lambda s, t, x: [x[0] - x[2]],
                'ends': Output({1: 1.0}, {1: 0.0}, free=5, scale=1.0),
            },
            2.0,
            0.3,
        ),
    ],
)
def test_a_constant_may_be_chosen_and_links_both_ends(change, cost, constant):
    states, p = {'x': 'm', 'v': 'm/s', 'p': '1'}, Output(free=1, derivatives=0, scale=1.0)
    made = changed(Cart, states=states, outputs=lambda s: {'x': s.ends, 'p': p}, **change)
    plan = made(solver=DirectSolverParameters()).solve()
    assert plan.cost == pytest.approx(cost, rel=1e-3)
    assert plan.trajectory.states[:, 2] == pytest.approx(constant, abs=2e-3)


@pytest.mark.parametrize('solver', [LONG, DIRECT])
def test_a_condition_of_infinite_slope_along_the_guess_is_met_all_the_same(solver):
    """The root of the place of its end, which is 0 along the initial guess."""
    end = {'outputs': lambda s: {'x': Output((0.0, 0.0), {1: 0.0}, free=4, scale=1.0)}}
    plan = solve(solver, **QUICKEST | end, end_conditions=lambda s, t, x: [np.sqrt(x[0]) - 1.0])
    assert plan.trajectory.states[-1, 0] == pytest.approx(1.0, abs=1e-5)
    assert plan.cost < 2.2
