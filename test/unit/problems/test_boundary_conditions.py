# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What boundary values fix: of states and controls, and of neither."""

import numpy as np
import pytest
from stated import Car, Cart, changed, Quickest
from tdm_planner.direct_method import Duration, Output
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.exceptions import Infeasible
from tdm_planner.problem_check import check_problem

GRAVITY = 9.81  # m/s^2


def hung(p):
    """States of a crane, and its acceleration, by the jet of its load's position."""
    angle, rate = -p[2] / GRAVITY, -p[3] / GRAVITY
    return (p[0] - angle, p[1] - rate, angle, rate), (p[2] + p[4] / GRAVITY,)


CRANE = changed(
    Quickest,
    states={'x': 'm', 'v': 'm/s', 'angle': 'rad', 'rate': 'rad/s'},
    controls={'a': 'm/s^2'},
    outputs=lambda s: {'load': Output((0.0,) * 4, (1.0, 0.0), free=4, derivatives=4)},
    invert=lambda s, y, z: hung(y['load']),
    derivative=lambda s, x, u: (x[1], u[0], x[3], -GRAVITY * x[2] - u[0]),
    control_limits=lambda s: {'a': (-2.0, 2.0)},
)


def load(plan):
    x, v, angle, rate = plan.trajectory.states[-1]
    return x + angle, v + rate


def test_boundary_values_that_fix_no_state_are_kept_by_the_direct_method():
    plan = CRANE().solve(counted=True)
    assert load(plan) == pytest.approx((1.0, 0.0), abs=1e-6)
    told = 'fixes no state: state it in end_conditions, or leave it out'
    assert f"('load' of order 0 at the end {told})" in plan.summary
    instead = changed(
        CRANE,
        outputs=lambda s: {'load': Output((0.0,) * 4, free=4, derivatives=4)},
        end_conditions=lambda s, t, x: (x[0] + x[2] - 1.0, x[1] + x[3]),
    )
    refined = instead().solve(counted=True)
    assert load(refined) == pytest.approx((1.0, 0.0), abs=1e-3)
    assert refined.cost < 0.97 * plan.cost


@pytest.mark.parametrize('derivatives', [(2, 2), (3, 2), (3, 3), (4, 2)])
def test_a_heading_that_a_free_velocity_may_reverse_is_not_fixed(derivatives):
    """Nor is it by chance: arctan2 of 0 and some values is 0 for all that are positive."""
    ahead, aside = derivatives

    def invert(s, y, z):
        x, across = y['x'], y['y']
        speed = np.hypot(x[1], across[1])
        turning = (x[1] * across[2] - across[1] * x[2]) / speed**2
        push = (x[1] * x[2] + across[1] * across[2]) / speed
        return (x[0], across[0], np.arctan2(across[1], x[1]), speed), (push, turning)

    car = changed(
        Quickest,
        states={'x': 'm', 'y': 'm', 'yaw': 'rad', 'speed': 'm/s'},
        controls={'a': 'm/s^2', 'turn': 'rad/s'},
        outputs=lambda s: {
            'x': Output((0.0, 1.0), (5.0,), free=3, derivatives=ahead),
            'y': Output((0.0, 0.0), (4.0, 0.0), free=3, derivatives=aside),
        },
        invert=invert,
        derivative=lambda s, x, u: (x[3] * np.cos(x[2]), x[3] * np.sin(x[2]), u[1], u[0]),
    )
    ends = Ends.of(CheckedFormulation(car()))
    assert ends.states[1] == pytest.approx([5.0, 4.0, np.nan, np.nan], nan_ok=True)
    assert ends.unkept == ("'y' of order 1 at the end",)


@pytest.mark.parametrize('mass', [1.0, 1e-12])
def test_what_is_free_is_free_in_any_unit(mass):
    bead = changed(
        Cart,
        duration=lambda s: Duration(2.0, fixed=True),
        invert=lambda s, y, z: (y['x'][:2], (mass * y['x'][2],)),
        derivative=lambda s, x, u: (x[1], u[0] / mass),
        margins=lambda s, t, x, u: {'force': 10.0 - np.abs(u[0] / mass)},
        running_cost=lambda s, t, x, u: (u[0] / mass) ** 2,
    )
    assert np.isnan(Ends.of(CheckedFormulation(bead())).controls).all()
    assert bead().solve(counted=True).cost == pytest.approx(1.5, rel=1e-3)


def test_boundary_values_of_which_only_the_sum_is_fixed_are_kept():
    beam = changed(
        Cart,
        states={'sum': 'm', 'moment': 'm', 'share': ''},
        controls={'a': 'm/s', 'b': 'm/s', 'c': '1/s'},
        outputs=lambda s: {
            'a': Output((0.0,), (1.0,), free=3, derivatives=1),
            'b': Output((0.0,), (0.5,), free=3, derivatives=1),
            'c': Output((1.0,), (), free=3, derivatives=1),
        },
        invert=lambda s, y, z: (
            (y['a'][0] + y['b'][0], (y['a'][0] - y['b'][0]) * y['c'][0], y['c'][0]),
            (
                y['a'][1] + y['b'][1],
                (y['a'][1] - y['b'][1]) * y['c'][0] + (y['a'][0] - y['b'][0]) * y['c'][1],
                y['c'][1],
            ),
        ),
        derivative=lambda s, x, u: (u[0], u[1], u[2]),
        margins=lambda s, t, x, u: {'share': x[2] - 0.2},
        running_cost=lambda s, t, x, u: u[0] ** 2 + u[1] ** 2 + u[2] ** 2,
    )
    total, moment, share = beam().solve(counted=True).trajectory.states[-1]
    assert 0.5 * (total + moment / share) == pytest.approx(1.0, abs=1e-6)
    assert 0.5 * (total - moment / share) == pytest.approx(0.5, abs=1e-6)


def test_numbers_beyond_all_range_are_one_sentence_when_a_problem_is_prepared():
    far = changed(
        Cart,
        outputs=lambda s: {'x': Output((0.0, 0.0), (1.0, 0.0), free=3, derivatives=60)},
        duration=lambda s: Duration(1e6),
    )
    with pytest.raises(Infeasible, match='too many orders of magnitude apart'):
        far().prepare()


def test_a_boundary_value_near_the_end_of_its_range_fixes_what_follows_from_it():
    """Of an angle of which the sine is given: beyond 1 there is none."""
    angle = changed(
        Quickest,
        states={'angle': 'rad'},
        controls={'rate': 'rad/s'},
        outputs=lambda s: {'sine': Output((0.0,), (0.95,), free=4, derivatives=1)},
        invert=lambda s, y, z: (
            (np.arcsin(y['sine'][0]),),
            (y['sine'][1] / np.sqrt(1.0 - y['sine'][0] ** 2),),
        ),
        derivative=lambda s, x, u: (u[0],),
        control_limits=lambda s: {'rate': (-1.0, 1.0)},
    )()
    assert Ends.of(CheckedFormulation(angle)).unkept == ()


def test_what_is_zero_but_for_rounding_is_fixed():
    """A velocity across is that of a start along y, r' cos(pi / 2), in Cartesian components."""
    polar = changed(
        Car,
        outputs=lambda s: {
            'r': Output((1.0,), (2.0, 0.0), free=3),
            'phi': Output((np.pi / 2, 0.0), (0.0, 0.0), free=3),
        },
        invert=lambda s, y, z: turned(y['r'], y['phi']),
    )
    ends = Ends.of(CheckedFormulation(polar(drag=0.0)))
    assert ends.states[0] == pytest.approx([0.0, 1.0, 0.0, np.nan], abs=1e-9, nan_ok=True)
    assert ends.unkept == ()


def turned(r, phi):
    """Return states and controls by the jets of polar coordinates."""
    c, s = np.cos(phi[0]), np.sin(phi[0])
    along, across = r[1], r[0] * phi[1]
    pull, push = r[2] - r[0] * phi[1] ** 2, r[0] * phi[2] + 2.0 * r[1] * phi[1]
    states = r[0] * c, r[0] * s, along * c - across * s, along * s + across * c
    return states, (pull * c - push * s, pull * s + push * c)


@pytest.mark.parametrize('free', [0, 1])
def test_a_cost_that_only_rounding_changes_does_not_jump(free):
    """A constant deceleration, from the boundary values alone."""
    ends = {'x': Output((0.0, 1.0), (0.0, -1.0), free=free)}
    thrown = changed(Cart, outputs=lambda s: ends)(time=1.0)
    assert check_problem(thrown) == []
    assert thrown.solve(counted=True).cost == pytest.approx(4.0, rel=1e-3)
