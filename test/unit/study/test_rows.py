# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a study varies; a row depends on its point alone, a fault costs no more than the row."""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import time
from typing import Any

import numpy as np
import pytest
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import parameter
from tdm_planner.problems import DirectProblem, PendulumSwingUp, RobotFormation
from tdm_planner.problems.registry import load_problem
from tdm_planner.tracking import TrackerParameters
from tdm_planner.tracking.stated_tracking import StatedTracker
from tdm_sim.study.axes import Axis, checked, parse_axis, Points
from tdm_sim.study.flights import ClosedLoop
from tdm_sim.study.tables import Trial

STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.2, 'solver.deadline': 0.3}


@pytest.mark.parametrize(
    ('kind', 'parameters'),
    [
        (PendulumSwingUp, STRONG),
        (PendulumSwingUp, {'limits.torque': 1e-4, 'solver.deadline': 0.05}),
        (PendulumSwingUp, {**STRONG, 'method': 'smooth'}),
        (RobotFormation, {}),
    ],
)
def test_a_slow_machine_finds_the_same(kind, parameters, monkeypatch):
    """Here by a clock on which every look takes a tenth of a second."""
    trial = Trial(kind, parameters)
    row = trial({})
    ticks = itertools.count()
    monkeypatch.setattr(time, 'perf_counter', lambda: 0.1 * next(ticks))
    again = trial({})
    for found in (row, again):
        found.pop('solve_time')
    assert row == again
    assert row['code'] == ('' if row['verified'] else 'DEADLINE')


def faulty(self: Any) -> None:
    raise ZeroDivisionError('a fault of the program')


@pytest.mark.parametrize(
    ('point', 'code', 'reason'),
    [
        ({'start.psi': 2.5}, 'INVALID_PROBLEM', 'limits.disk_angle'),
        ({'limits.torque': 1e-4}, 'DEADLINE', 'weak'),
        ({'start.psi': 0.0}, 'INTERNAL', 'ZeroDivisionError: a fault'),
    ],
)
def test_a_row_without_a_plan_says_why(point, code, reason, monkeypatch):
    if code == 'INTERNAL':
        monkeypatch.setattr(PendulumSwingUp, 'standing_plan', faulty)
    row = Trial(PendulumSwingUp, {'solver.deadline': 0.05})(point)
    assert (row['verified'], row['code'], row['cost']) == (False, code, None)
    assert reason in row['reason']


def test_every_plan_is_flown() -> None:
    row = Trial(PendulumSwingUp, STRONG, ClosedLoop(seeds=2, mismatch=0.03))({})
    assert (row['flights'], row['caught'], row['held'], row['lost']) == (2, 2, 2, '')
    assert 0.0 < row['flown.disk_angle'] < row['margin.disk_angle'] + 0.3
    assert 0.0 <= row['flown.torque'] < row['margin.torque']  # feedback uses the reserve


def test_a_flight_is_lost_on_a_plant_that_is_too_different() -> None:
    how = ClosedLoop(mismatch=0.6)
    row = Trial(PendulumSwingUp, STRONG, how)({})
    assert row['held'] == 0
    assert 'pendulum' in row['lost']


def test_robots_fly_in_formation_and_keep_their_distance() -> None:
    names = ['robot1', 'robot2']
    row = Trial(RobotFormation, {'robots': names}, ClosedLoop(mismatch=0.03, rate=20.0))({})
    assert (row['caught'], row['held']) == (1, 1), row['lost']
    assert row['flown.robot1 - robot2'] > 0.0


def test_a_stated_plant_flies_as_well() -> None:
    cart = load_problem('double_integrator:DoubleIntegrator')
    row = Trial(cart, {}, ClosedLoop(seeds=2, mismatch=0.02))({'start.x': -0.5})
    assert (row['code'], row['caught'], row['held']) == ('', 2, 2), row['lost']
    assert row['cost'] == pytest.approx(2.0**0.5, rel=1e-2)


@dataclass(frozen=True)
class Hop(DirectProblem):
    """A vehicle that rises upright: its roll, coupled to the way aside, rests."""

    state_names = ('z', 'x', 'roll', 'w', 'v', 'p')
    state_units = ('m', 'm', 'rad', 'm/s', 'm/s', 'rad/s')
    control_names, control_units = ('thrust', 'moment'), ('m/s^2', 'rad/s^2')
    mass: float = parameter(1.0, 'mass')

    def outputs(self):
        return {'z': Output((0.0, 0.0), (3.0, 0.0), 4), 'roll': Output((0.0, 0.0), (0.0, 0.0), 2)}

    def integrated(self):
        return {'x': Integrated(0.0, 0.0), 'v': Integrated(0.0, 0.0)}

    def duration(self):
        return Duration(4.0, fixed=True)

    def invert(self, y, z):
        (h, w, up), (roll, p, turn) = y['z'], y['roll']
        return (h, z['x'], roll, w, z['v'], p), ((up + 1.0) * self.mass / np.cos(roll), turn)

    def derivative(self, x, u):
        push = u[0] / self.mass
        return x[3], x[4], x[5], push * np.cos(x[2]) - 1.0, -push * np.sin(x[2]), u[1]

    def control_limits(self):
        return {'thrust': (0.0, 2.0), 'moment': (-2.0, 2.0)}

    def running_cost(self, t, x, u):
        return (u[0] - 1.0) ** 2 + u[1] ** 2


def test_a_plant_flies_where_states_rest_throughout_the_plan() -> None:
    row = Trial(Hop, {}, ClosedLoop(seeds=2, mismatch=0.02))({})
    assert (row['code'], row['caught'], row['held']) == ('', 2, 2), row['lost']
    tracker = StatedTracker(Hop(), TrackerParameters())
    tracker.prepare(Hop().solve().trajectory)
    rises, aside = tracker.ranges[:2]
    assert rises == pytest.approx(3.0, rel=1e-3)
    assert 0.0 < aside < rises


def test_a_plant_flies_whose_rates_have_no_slope_where_its_controls_vanish() -> None:
    class Thirsty(Hop):
        """Its thrust has a size."""

        def derivative(self, x, u):
            rates = super().derivative(x, u)
            return (*rates[:5], rates[5] + 1e-9 * np.sqrt(u[0] ** 2 + u[1] ** 2))

    row = Trial(Thirsty, {}, ClosedLoop(mismatch=0.02))({})
    assert (row['code'], row['caught'], row['held']) == ('', 1, 1), row['lost']


@pytest.mark.parametrize(('growth', 'least'), [(10.0, ''), (50.0, 'must be 600 Hz or more')])
def test_a_rate_that_is_too_slow_for_a_plant_is_said(growth: float, least: str) -> None:
    @dataclass(frozen=True)
    class Falling(DirectProblem):
        """A place whose error grows by e in the time 1 / `growth` without feedback."""

        state_names, state_units = ('x', 'v'), ('m', 'm/s')
        control_names, control_units = ('push',), ('m/s^2',)

        def outputs(self):
            return {'x': Output(start=(1.0, 0.0), end=(0.0, 0.0), free=2)}

        def duration(self):
            return Duration(5.0 / growth, fixed=True)

        def invert(self, y, z):
            x, v, a = y['x']
            return (x, v), (a - growth**2 * x,)

        def derivative(self, x, u):
            return x[1], growth**2 * x[0] + u[0]

        def running_cost(self, t, x, u):
            return u[0] ** 2

    tracker = StatedTracker(Falling(), TrackerParameters(rate=200.0))
    assert tracker.warning == ''
    tracker.prepare(Falling().solve().trajectory)
    assert tracker.warning.endswith(least)
    assert bool(tracker.warning) == bool(least)


@pytest.mark.parametrize(
    ('given', 'values', 'spacing'),
    [
        ('0.1:0.3:3', [0.1, 0.2, 0.3], 'linear'),
        ('1e-2:1:log 3', [0.01, 0.1, 1.0], 'log'),
        ('-3.14:3.14:2', [-3.14, 3.14], 'linear'),
        ('.5', [0.5], 'list'),
        ('switching,smooth', ['switching', 'smooth'], 'list'),
        ('[1, 2],[3, 4]', [[1, 2], [3, 4]], 'list'),
    ],
)
def test_ranges_and_lists(given: str, values: list[Any], spacing: str) -> None:
    axis = parse_axis(f'a.b={given}')
    assert (axis.name, axis.spacing) == ('a.b', spacing)
    if isinstance(values[0], float):
        assert list(axis.values) == pytest.approx(values)
    else:
        assert list(axis.values) == values


def test_random_values_are_those_of_the_name() -> None:
    one, other = parse_axis('a=0:1:random 50'), parse_axis('b=0:1:random50')
    assert one == parse_axis('a=0:1:random 50')
    assert one.values != other.values
    assert 0.0 <= min(one.values) < 0.2 < 0.8 < max(one.values) <= 1.0


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        *((text, 'LOW:HIGH:N') for text in ('', 'a', 'a=', '=1', 'a=0:1:0', 'a=0:1', 'a=0:b:3')),
        *((text, 'LOW:HIGH:N') for text in ('a=1:2:3:4', 'a=[', 'a=0:inf:3')),
        ('a=0:1:log 3', 'log range must be > 0'),
        ('limits.torqe=0.1', 'limits.torque'),
        ('limits.torque=-1:1:3', r'must be a number in \[1e-12'),
        ('goal.turns=0:1:3', '0.5'),
        ('start.source=measured', 'belongs to a node'),
        ('method=smooth,quick', 'one of switching'),
    ],
)
def test_axes_are_checked_before_anything_is_planned(text, words):
    with pytest.raises(InvalidProblem, match=words):
        checked(parse_axis(text), PendulumSwingUp, {})


def test_all_combinations_and_random_ones_together() -> None:
    grid = [Axis('a', (1, 2)), Axis('b', (3, 4, 5), 'linear')]
    assert [tuple(point.values()) for point in Points(grid)] == [
        (1, 3), (1, 4), (1, 5), (2, 3), (2, 4), (2, 5)
    ]  # fmt: skip
    drawn = [Axis('x', (1, 2), 'random'), Axis('n', (0, 1)), Axis('y', (3, 4), 'random')]
    assert [tuple(point.values()) for point in Points(drawn)] == [
        (1, 0, 3), (2, 0, 4), (1, 1, 3), (2, 1, 4)
    ]  # fmt: skip
    assert list(Points(drawn)[0]) == ['x', 'n', 'y']


def test_axes_that_do_not_go_together():
    for axes, words in (
        ([Axis('a', (1,)), Axis('a', (2,))], 'varied twice'),
        ([Axis('a', (1,), 'random'), Axis('b', (2, 3), 'random')], 'as many values'),
    ):
        with pytest.raises(InvalidProblem, match=words):
            Points(axes)
