# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""How far the search for a plan of a stated problem goes, on problems known from elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stated import Cart, changed, forced, noted, Quickest
from tdm_planner.direct_method import Budget, Duration, Integrated, Output
from tdm_planner.direct_method.trust_region import Minimum
from tdm_planner.exceptions import Infeasible
from tdm_planner.problems.direct.guesses import Guesses
from tdm_planner.problems.direct.minima import DirectMinima
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import Refinement
from tdm_planner.problems.direct.search import DirectSearch

GRAVITY = 9.81  # [m/s^2]


# Rayleigh's problem with a limit on state and control (Betts, 2010), with other numbers: 28.381 by
# Hermite and Simpson on 120 intervals.
RAYLEIGH = changed(
    Cart,
    states={'x': '1', 'v': '1/s'},
    controls={'u': '1'},
    outputs=lambda s: {'x': Output(start=(-3.2957, -4.2758), free=8, scale=5.0)},
    duration=lambda s: Duration(5.1382, fixed=True),
    invert=lambda s, y, z: (
        y['x'][:2],
        ((y['x'][2] + y['x'][0] - y['x'][1] * (1.4 - 0.14 * y['x'][1] ** 2)) / 4.0,),
    ),
    derivative=lambda s, x, u: (x[1], -x[0] + x[1] * (1.4 - 0.14 * x[1] ** 2) + 4.0 * u[0]),
    margins=lambda s, t, x, u: {'mixed': -(u[0] + 0.14979 * x[0])},
    running_cost=lambda s, t, x, u: u[0] ** 2 + x[0] ** 2,
)


def test_a_repair_that_raises_the_cost_asks_for_more_intervals():
    """On few intervals errors may cancel; a reserve at a limit then costs what they hid."""
    assert RAYLEIGH().solve(counted=True).cost == pytest.approx(28.381, rel=1e-3)


def test_a_repair_leaves_more_of_a_limit_at_a_free_end_too():
    """Van der Pol's oscillator: the replay is beyond a limit on the state when it ends."""
    oscillator = changed(
        Cart,
        states={'x': '1', 'v': '1/s'},
        controls={'u': '1'},
        outputs=lambda s: {'x': Output(start=(1.0, 0.0), free=10)},
        duration=lambda s: Duration(5.0, fixed=True),
        invert=lambda s, y, z: (
            y['x'][:2],
            (y['x'][2] - 3.0 * (1.0 - y['x'][0] ** 2) * y['x'][1] + y['x'][0],),
        ),
        derivative=lambda s, x, u: (x[1], 3.0 * (1.0 - x[0] ** 2) * x[1] - x[0] + u[0]),
        control_limits=lambda s: {'u': (-0.3, 1.0)},
        margins=lambda s, t, x, u: {'speed': x[1] + 0.4},
        running_cost=lambda s, t, x, u: x[0] ** 2 + x[1] ** 2 + u[0] ** 2,
    )
    assert oscillator().solve(counted=True).cost == pytest.approx(5.4129, rel=1e-3)


def test_what_ipopt_does_not_begin_counts_nothing():
    """A reserve beyond both limits of a control: CasADi has any number of iterations for that."""
    limited = changed(Cart, control_limits=lambda s: {'u': (-60.0, 60.0)})
    plant, budget = DirectPlant(limited()), Budget(3.0)
    refinement = Refinement(plant, budget)
    guess = Guesses(plant, plant.ends, budget, 0).line(straight=True, screen=False)
    assert refinement.solve(guess.intervals, guess) is not None
    counted = budget.evaluations
    assert refinement.solve(guess.intervals, guess, reserve=100.0) is None
    assert budget.evaluations == counted > 0


# Two links lift 3 kg with an elbow that is far too weak to hold it: they must swing.
LINKS, MASSES, LOAD = (0.5, 0.4), (3.0, 2.0), 3.0  # [m], [kg], [kg]
FIRST = (MASSES[0] / 3 + MASSES[1] + LOAD) * LINKS[0] ** 2
SECOND = (MASSES[1] / 3 + LOAD) * LINKS[1] ** 2
BOTH = (MASSES[1] / 2 + LOAD) * LINKS[0] * LINKS[1]


def inertia_and_loads(q1, q2, w1, w2):
    """Return m11, m12, m22 of an arm, and the torques of speed and weight on its joints."""
    m11, m12 = FIRST + SECOND + 2 * BOTH * np.cos(q2), SECOND + BOTH * np.cos(q2)
    weight = GRAVITY * (MASSES[1] / 2 + LOAD) * LINKS[1] * np.cos(q1 + q2)
    whole = GRAVITY * (MASSES[0] / 2 + MASSES[1] + LOAD) * LINKS[0] * np.cos(q1) + weight
    whirl = BOTH * np.sin(q2)
    return m11, m12, SECOND, whole - whirl * (2 * w1 * w2 + w2**2), weight + whirl * w1**2


def arm_rates(s, x, u):
    m11, m12, m22, n1, n2 = inertia_and_loads(*x)
    r1, r2, det = u[0] - n1, u[1] - n2, m11 * m22 - m12**2
    return x[2], x[3], (m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det


def arm_torques(s, y, z):
    (q1, w1, a1), (q2, w2, a2) = y['q1'], y['q2']
    m11, m12, m22, n1, n2 = inertia_and_loads(q1, q2, w1, w2)
    return (q1, q2, w1, w2), (m11 * a1 + m12 * a2 + n1, m12 * a1 + m22 * a2 + n2)


def arm(elbow):
    """Return the problem of lifting the load in the least time; `elbow` is its torque [N m]."""
    return changed(
        Quickest,
        states={'q1': 'rad', 'q2': 'rad', 'w1': 'rad/s', 'w2': 'rad/s'},
        controls={'t1': 'N m', 't2': 'N m'},
        outputs=lambda s: {
            'q1': Output((-1.4, 0.0), (1.0, 0.0), free=8),
            'q2': Output((0.1, 0.0), (0.6, 0.0), free=8),
        },
        duration=lambda s: Duration(1.5),
        invert=arm_torques,
        derivative=arm_rates,
        margins=lambda s, t, x, u: {
            'speed 1': 1.0 - (x[2] / 6.0) ** 2,
            'speed 2': 1.0 - (x[3] / 6.0) ** 2,
            'elbow': 1.0 - (x[1] / 2.6) ** 2,
        },
        control_limits=lambda s: {'t1': (-32.4, 32.4), 't2': (-elbow, elbow)},
    )


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_guesses_of_one_kind_that_agree_do_not_end_the_search(seed):
    """All motions of the direct method lead to one local minimum here, 1.77 s; lines do not."""
    assert arm(4.0)().solve(counted=True, seed=seed).cost < 1.01 * 1.2296


def test_a_reserve_is_as_large_as_it_takes_to_matter(monkeypatch):
    """Where a limit is violated between the points at which it is kept, little does nothing."""
    repairs = noted(monkeypatch, Refinement, '_landed')
    arm(2.7)().solve(counted=True, seed=0)
    assert repairs.call_count < 10


def test_an_unstable_robot_is_planned_for_over_many_of_its_time_constants():
    """
    A balancing robot drives 3.6 m: what its replay is off by at first grows by e^28.

    That is within the goal's tolerance by rounding, but not by steps with errors of 1e-11.
    """
    length = 0.12  # [m]: pitch'' = (g pitch - x'') / length
    robot = changed(
        Quickest,
        states={'x': 'm', 'v': 'm/s', 'pitch': 'rad', 'rate': 'rad/s'},
        controls={'a': 'm/s^2'},
        outputs=lambda s: {'pitch': Output((0.0, 0.0), (0.0, 0.0), free=10, scale=0.3)},
        integrated=lambda s: {'x': Integrated(0.0, 3.6, 2.0), 'v': Integrated(0.0, 0.0)},
        invert=lambda s, y, z: (
            (z['x'], z['v'], *y['pitch'][:2]),
            (GRAVITY * y['pitch'][0] - length * y['pitch'][2],),
        ),
        derivative=lambda s, x, u: (x[1], u[0], x[3], (GRAVITY * x[2] - u[0]) / length),
        control_limits=lambda s: {'a': (-4.0, 4.0)},
        margins=lambda s, t, x, u: {
            'lean': 1.0 - (x[2] / 0.3) ** 2,
            'speed': 1.0 - (x[1] / 1.5) ** 2,
        },
    )
    plan = robot().solve(3.0, counted=True)
    assert plan.duration == pytest.approx(3.146, rel=1e-3)


@pytest.mark.parametrize('seed', range(4))
def test_a_pole_of_the_cost_is_no_jump(seed):
    """The pace over a way has one where the speed is 0: changes of the guess cross it."""
    lap = changed(
        Cart,
        states={'v': 'm/s'},
        controls={'a': 'm/s^2'},
        outputs=lambda s: {'v': Output((5.0,), free=8, derivatives=1, scale=10.0)},
        duration=lambda s: Duration(100.0, fixed=True),
        invert=lambda s, y, z: ((y['v'][0],), (y['v'][0] * y['v'][1],)),
        derivative=lambda s, x, u: (u[0] / x[0],),
        control_limits=lambda s: {'a': (-5.0, 5.0)},
        margins=lambda s, t, x, u: {'speed': x[0] - 1.0},
        running_cost=lambda s, t, x, u: 1.0 / x[0],
    )
    plan = lap().solve(counted=True, seed=seed)
    assert plan.cost == pytest.approx((np.sqrt(25.0 + 1000.0) - 5.0) / 5.0, rel=1e-3)


def test_rollouts_are_tried_where_nothing_else_leads_anywhere(monkeypatch):
    """However long the first guesses took; the direct method is for what is in sight."""

    def in_vain(self, guess, until, **how):
        self._budget.evaluations += 250  # of 3000

    monkeypatch.setattr(Refinement, 'from_guess', in_vain)
    monkeypatch.setattr(DirectMinima, 'minimise_roughly', lambda *given: None)
    monkeypatch.setattr(DirectMinima, 'minimise_fully', lambda *given: None)
    rollouts = noted(monkeypatch, Guesses, 'rollout')
    with pytest.raises(Infeasible):
        Cart().solve(3.0, counted=True)
    assert rollouts.call_count > 0


def test_what_the_direct_method_has_in_sight_is_given_time_where_no_check_passes(monkeypatch):
    """However many motions are solved by collocation."""
    solve, plans = Refinement.from_guess, DirectSearch.plans

    def slowly(self, *given, **how):
        self._budget.evaluations += 250  # of 3000
        return solve(self, *given, **how)

    def unconfirmed(self, candidate):
        return plans(self, candidate) if isinstance(candidate, Minimum) else iter(())

    monkeypatch.setattr(Refinement, 'from_guess', slowly)
    monkeypatch.setattr(DirectSearch, 'plans', unconfirmed)
    assert 'not refined by collocation' in Cart().solve(3.0, counted=True).summary


def test_the_summary_tells_that_what_is_beyond_a_limit_is_allowed():
    plan = Cart().solve()
    close = replace(plan.verification, worst={'force': -1e-6, 'speed': 1.0})
    told = Cart().describe(replace(plan, verification=close))
    assert told.endswith('closest limit force (margin -1e-06, which is allowed)')


@pytest.mark.parametrize('gain', [0.0, 1.8])
def test_a_plant_too_unstable_for_any_replay_is_planned_for_with_a_feedback_in_it(gain):
    """What the feedback does is a part of the control, and of its limits."""
    rate, duration = 8.0, 10.0  # 1/s, s

    def push(x, v):
        return -gain * (rate**2 * x + rate * v)

    plant = changed(
        Cart,
        outputs=lambda s: {'x': Output((-0.5, 0.0), (0.5, 0.0), free=8)},
        duration=lambda s: Duration(duration, fixed=True),
        **forced(lambda x, v: rate**2 * np.sin(x) + push(x, v)),
        margins=lambda s, t, x, u: {'force': 60.0 - np.sqrt(1e-6 + (u[0] + push(*x)) ** 2)},
        running_cost=lambda s, t, x, u: (u[0] + push(*x)) ** 2,
    )
    if gain:
        assert plant().solve(counted=True).verification.ok
        return
    with pytest.raises(Infeasible, match=r'the plant is unstable: deviations .* grow \S+-fold'):
        plant().solve(counted=True)
