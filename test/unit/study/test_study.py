# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A study: what it varies, rows that depend on their points alone; table, pictures, page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
import itertools
import json
from pathlib import Path
import re
import time
from unittest.mock import Mock

import numpy as np
from pyarrow import csv
import pytest
from stated import Cart, changed, forced
from tdm_planner.cli import main
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import parameter
from tdm_planner.plan_files import UnusableFile
from tdm_planner.problems import DirectProblem, PendulumSwingUp, RobotFormation
from tdm_planner.problems.registry import load_problem
from tdm_planner.tracking.motion import finished
from tdm_planner.tracking.stated_tracking import StatedTracker, StatedTrackerParameters
from tdm_sim.progress import Progress
from tdm_sim.study import study
from tdm_sim.study.axes import Axis, cell, checked, parse_axis, points_of
from tdm_sim.study.flights import ClosedLoop
from tdm_sim.study.pictures import draw, write_page
from tdm_sim.study.study import _collect, ROWS, Rows, Trial

STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.2, 'solver.deadline': 0.3}
WEAK = {'limits.torque': 1e-4, 'solver.deadline': 0.05}
ASKED = [(PendulumSwingUp, how) for how in (STRONG, WEAK, {**STRONG, 'method': 'smooth'})]
KINDS, MAPS = Axis('kind', ('plain', 'odd')), ['cost', 'duration']
AXES = [Axis('x', (0.1, 1.0, 10.0), 'log'), KINDS]


@pytest.mark.parametrize(('kind', 'parameters'), [*ASKED, (RobotFormation, {})])
def test_a_slow_machine_finds_the_same(kind, parameters, monkeypatch):
    """Here by a clock on which every look takes a tenth of a second."""
    trial = Trial(kind, parameters)
    row = trial({})
    ticks = itertools.count()
    monkeypatch.setattr(time, 'perf_counter', lambda: 0.1 * next(ticks))
    again = trial({})
    assert row | {'solve_time': again['solve_time']} == again
    assert row['code'] == ('DEADLINE' if parameters == WEAK else '')


@pytest.mark.parametrize(
    ('point', 'code', 'reason'),
    [
        ({'start.psi': 2.5}, 'INVALID_PROBLEM', 'limits.disk_angle'),
        ({'limits.torque': 1e-6}, 'DEADLINE', 'more swings than'),
        ({'start.psi': 0.0}, 'INTERNAL', 'ZeroDivisionError: a fault'),
    ],
)
def test_a_row_without_a_plan_says_why(point, code, reason, monkeypatch):
    if code == 'INTERNAL':
        faulty = Mock(side_effect=ZeroDivisionError('a fault of the program'))
        monkeypatch.setattr(PendulumSwingUp, 'standing_plan', faulty)
    row = Trial(PendulumSwingUp, {'solver.deadline': 0.05})(point)
    assert (row['verified'], row['code'], row['cost']) == (False, code, None)
    assert reason in row['reason']


def flown(kind, parameters=(), point=(), **how) -> dict:
    row = Trial(kind, dict(parameters), ClosedLoop(**how))(dict(point))
    seeds = how.get('seeds', 1)
    assert (row['code'], row['lost']) == ('', '')
    assert row['flights'] == row['caught'] == row['held'] == seeds
    return row


def test_every_plan_is_flown() -> None:
    row = flown(PendulumSwingUp, STRONG, seeds=2, mismatch=0.03)
    assert 0.0 < row['flown.disk_angle'] < row['margin.disk_angle'] + 0.3
    assert 0.0 <= row['flown.torque'] < row['margin.torque']  # feedback uses the reserve
    # on a plant that is too different a flight is lost
    row = Trial(PendulumSwingUp, STRONG, ClosedLoop(mismatch=0.6))({})
    assert row['held'] == 0
    assert 'pendulum' in row['lost']
    robots = flown(RobotFormation, {'robots': ['robot1', 'robot2']}, mismatch=0.03, rate=20.0)
    assert robots['flown.robot1 - robot2'] > 0.0
    cart = load_problem('double_integrator:DoubleIntegrator')
    row = flown(cart, point={'start.x': -0.5}, seeds=2, mismatch=0.02)
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


def test_a_plant_flies_where_states_rest_or_its_rates_have_no_slope() -> None:
    """Throughout the plan; where its controls vanish."""
    flown(Hop, seeds=2, mismatch=0.02)
    tracker = StatedTracker(Hop(), StatedTrackerParameters())
    law = finished(tracker.prepare(Hop().solve().trajectory))
    rises, aside = law.ranges[:2]
    assert rises == pytest.approx(3.0, rel=1e-3)
    assert 0.0 < aside < rises

    def derivative(self, x, u):
        rates = Hop.derivative(self, x, u)
        return (*rates[:5], rates[5] + 1e-9 * np.sqrt(u[0] ** 2 + u[1] ** 2))

    flown(changed(Hop, derivative=derivative), mismatch=0.02)


@pytest.mark.parametrize(('growth', 'least'), [(10.0, ''), (50.0, 'must be 600 Hz or more')])
def test_a_rate_that_is_too_slow_for_a_plant_is_said(growth: float, least: str) -> None:
    """Without feedback the error of the place grows by e in the time 1 / `growth`."""
    falling = changed(
        Cart,
        outputs=lambda s: {'x': Output((1.0, 0.0), (0.0, 0.0), free=2)},
        duration=lambda s: Duration(5.0 / growth, fixed=True),
        **forced(lambda x, v: growth**2 * x),
        margins=DirectProblem.margins,
    )()
    tracker = StatedTracker(falling, StatedTrackerParameters(rate=200.0))
    assert tracker.warning == ''
    finished(tracker.prepare(falling.solve().trajectory))
    assert tracker.warning.endswith(least)
    assert bool(tracker.warning) == bool(least)


def test_ranges_lists_and_random_values() -> None:
    ranges = {'0.1:0.3:3': ([0.1, 0.2, 0.3], 'linear'), '1e-2:1:log 3': ([0.01, 0.1, 1.0], 'log')}
    ranges |= {'-3.14:3.14:2': ([-3.14, 3.14], 'linear'), '.5': ([0.5], 'list')}
    for given, (values, spacing) in ranges.items():
        axis = parse_axis(f'a.b={given}')
        assert (axis.name, axis.spacing) == ('a.b', spacing)
        assert list(axis.values) == pytest.approx(values)
    lists = {'switching,smooth': ('switching', 'smooth'), '[1, 2],[3, 4]': ([1, 2], [3, 4])}
    for given, items in lists.items():
        assert parse_axis(f'a.b={given}') == Axis('a.b', items, 'list')
    # the name makes the random ones
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
    drawn = [Axis('x', (1, 2), 'random'), Axis('n', (0, 1)), Axis('y', (3, 4), 'random')]
    for axes, expected in ((grid, '13 14 15 23 24 25'), (drawn, '103 204 113 214')):
        points = [''.join(map(str, point.values())) for point in points_of(axes)]
        assert points == expected.split()
    assert list(points_of(drawn)[0]) == ['x', 'n', 'y']
    for axes, words in (
        ([Axis('a', (1,)), Axis('a', (2,))], 'varied twice'),
        ([Axis('a', (1,), 'random'), Axis('b', (2, 3), 'random')], 'as many values'),
    ):
        with pytest.raises(InvalidProblem, match=words):
            points_of(axes)


def found(point: dict) -> dict:
    """Return what a plan that takes no time came to: none of the kind odd from 1 on."""
    if point['kind'] == 'odd' and point['x'] >= 1.0:
        nothing = dict.fromkeys(('cost', 'duration', 'solve_time', 'evaluations'))
        return {'verified': False, 'code': 'INFEASIBLE', 'reason': 'too <b>odd</b>', **nothing}
    figures = {'cost': 2 * point['x'], 'duration': point['x'], 'solve_time': 0.1, 'evaluations': 3}
    return {'verified': True, 'code': '', 'reason': '', **figures, 'margin.wall': 0.25}


def collected(path: Path | None, order: list[int], until: int = 99):
    """Return the table once rows came in this order, `until` Ctrl-C."""
    rows, points = Rows(path, {'any': 1}), points_of(AXES)
    left = [row for row in order if row not in rows.found]

    def results() -> Iterator[tuple[int, dict]]:
        for count, row in enumerate(left):
            if count == until:
                raise KeyboardInterrupt
            yield row, found(points[row])

    _collect(rows, points, results(), Progress(quiet=True))
    return rows.table()


def test_the_table_is_the_same_in_whatever_order_rows_come() -> None:
    whole = collected(None, [0, 1, 2, 3, 4, 5])
    assert whole.equals(collected(None, [5, 3, 1, 0, 2, 4]))
    assert whole.column_names[:4] == ['row', 'x', 'kind', 'verified']
    assert whole['verified'].to_pylist() == [True, True, True, False, True, False]
    assert whole['cost'].to_pylist() == [0.2, 0.2, 2.0, None, 20.0, None]


@pytest.mark.parametrize('cut', [0, 1, 60])
def test_an_interrupted_study_goes_on(tmp_path: Path, cut: int) -> None:
    """Also if its last line was cut off."""
    path = tmp_path / 'new' / ROWS
    with pytest.raises(KeyboardInterrupt):
        collected(path, [4, 2, 0, 1, 3, 5], until=2)
    path.write_bytes(path.read_bytes()[: -cut or None])
    assert Rows(path, {'any': 1}).found.keys() == ({4} if cut else {2, 4})
    whole = collected(path, [0, 1, 2, 3, 4, 5])
    assert whole.equals(collected(None, [0, 1, 2, 3, 4, 5]))
    assert Rows(path, {'any': 1}).table().equals(whole)
    with pytest.raises(UnusableFile, match='holds another study'):
        Rows(path, {'any': 2})
    path.rename(path.with_name('thesis.tex'))
    with pytest.raises(UnusableFile, match='holds files, and no study'):
        Rows(path, {'any': 1})
    path.mkdir()
    with pytest.raises(UnusableFile, match='cannot be read: Is a directory'):
        Rows(path, {'any': 1})


def test_rows_of_a_statement_that_was_edited_are_not_kept(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(study, 'workers', lambda *_: nullcontext(Mock()))
    monkeypatch.setattr(study, 'each', lambda _, work, points, lost: enumerate(map(work, points)))
    monkeypatch.syspath_prepend(tmp_path)
    file, asked = tmp_path / 'edited.py', ('edited:Edited', {'limit': [9.0]}, tmp_path / 'out')
    file.write_text('from stated import Cart\n\n\nclass Edited(Cart): ...\n')
    assert study.run(*asked).equals(study.run(*asked))
    file.write_text('from stated import Cart\n\n\nclass Edited(Cart):\n    guess = 2.0\n')
    with pytest.raises(InvalidProblem, match='of a statement that was edited since'):
        study.run(*asked)


def test_a_study_that_never_began_leaves_its_folder_to_another(tmp_path: Path) -> None:
    for k in (1, 2):
        assert not Rows(tmp_path / ROWS, {'any': k}).found
    assert not (tmp_path / ROWS).exists()


def rows_of(axes: list[Axis]) -> list[dict]:
    points = enumerate(points_of(axes))
    return [{'row': i, **p, **found({'kind': 'plain', 'x': 1.0, **p})} for i, p in points]


def columns_of(rows: list[dict]) -> dict[str, list]:
    return {name: [cell(row.get(name)) for row in rows] for name in rows[0]}


@pytest.mark.parametrize('closed', [False, True])
@pytest.mark.parametrize(
    ('axes', 'names'),
    [
        ([Axis('x', (3.0, 1.0, 2.0), 'random')], ['curve']),
        ([Axis('x', (1.0, 2.0, 4.0), 'log'), Axis('solver.seed', (0, 1))], ['curve']),
        ([Axis('x', (1.0, 2.0), 'linear'), KINDS], MAPS),
        ([Axis('x', (1.0, 2.0, 0.2), 'random'), Axis('y', (1.0, 2.0, 0.0), 'random')], MAPS),
        ([Axis('x', (1.0, 2.0)), Axis('y', (1, 2)), KINDS], MAPS),
        ([Axis('x', (1.0, 2.0)), Axis('y', (['a'], ['a', 'b']))], MAPS),
        ([], []),
    ],
)
def test_pictures_and_page_of_any_number_of_variables(axes, names, closed, tmp_path):
    rows = rows_of(axes)
    for row in rows if closed else []:
        counts = {'flights': 4, 'caught': 4, 'held': 3} if row['verified'] else {}
        row |= dict.fromkeys(('flights', 'caught', 'held')) | counts
    columns = columns_of(rows)
    pictures = draw(columns, axes, {'x': 'N m'})
    assert list(pictures) == [*names, *(['caught', 'held'] if closed and names == MAPS else [])]
    for figure, _ in pictures.values():
        assert any('x [N m]' in axis.get_xlabel() for axis in figure.axes)
    odd = any(row['code'] for row in rows)
    legends = [axis.get_legend() for figure, _ in pictures.values() for axis in figure.axes]
    texts = {text.get_text() for legend in legends if legend for text in legend.get_texts()}
    assert texts == ({'INFEASIBLE'} if odd else set())
    write_page(tmp_path, 'any', columns, axes, {'a': 1}, pictures)
    page = re.sub('base64,[^"]*', '', (tmp_path / 'study.html').read_text())
    assert ('too &lt;b&gt;odd&lt;/b&gt;' in page) == odd
    assert '<b>' not in page
    assert {file.stem for file in tmp_path.glob('*.png')} == {*pictures}
    assert 'http' not in page.replace('http-equiv', '')


def test_a_plan_that_does_nothing_leaves_the_others_their_colours() -> None:
    axes = [Axis('x', (1.0, 2.0)), Axis('y', (-1.0, 0.0, 1.0))]
    rows = [row | ({} if row['y'] else {'duration': 1e-3}) for row in rows_of(axes)]
    figure, _ = draw(columns_of(rows), axes, {})['duration']
    (norm,) = {mesh.norm for axis in figure.axes[:1] for mesh in axis.collections if mesh.norm}
    assert (norm.vmin, norm.vmax) == pytest.approx((1.0 / 30.0, 2.0))


def test_processes_find_the_same_to_the_last_bit_and_go_on(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shared = ['--set', 'torque_reserve=.2', 'solver.deadline=.2']
    words = ['study', 'pendulum', '--over', 'limits.torque=1e-7:.09:2', '--over']
    words += ['start.psi=0,.1']
    assert main([*words, *shared, '-o', 'out', '--csv', '--processes', '2']) == 0
    assert 'study.html' in capsys.readouterr().out
    files = {path.name for path in Path('out').iterdir()}
    assert files == {ROWS, 'table.csv', 'study.html', 'duration.png'}
    before = Path('out/table.csv').read_bytes()
    kept = csv.read_csv('out/table.csv')
    assert kept['verified'].to_pylist() == [False, False, True, True]
    trial = Trial(PendulumSwingUp, {'torque_reserve': 0.2, 'solver.deadline': 0.2})
    points = points_of([Axis('limits.torque', (1e-7, 0.09)), Axis('start.psi', (0.0, 0.1))])
    for row, point in zip(kept.to_pylist(), points, strict=True):
        here = {**point, **trial(point), 'solve_time': row['solve_time']}
        assert {name: row[name] for name in here} == here
    assert main([*words, *shared, '-o', 'out', '--csv', '-q']) == 0
    assert Path('out/table.csv').read_bytes() == before
    assert main([*words, '-o', 'out']) == 2
    assert 'holds another study' in capsys.readouterr().err
    asked = json.loads(Path('out', ROWS).read_text().splitlines()[0])
    assert asked['over'] == {'limits.torque': [1e-7, 0.09], 'start.psi': [0.0, 0.1]}
