# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A study from beginning to end: table, pictures, page; interrupted, gone on with."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any

import pytest
from tdm_planner.cli import main
from tdm_planner.plan_files import UnusableFile
from tdm_planner.problems import PendulumSwingUp
from tdm_sim.progress import Progress
from tdm_sim.study import Axis
from tdm_sim.study.axes import Points
from tdm_sim.study.page import write_page
from tdm_sim.study.pictures import draw
from tdm_sim.study.study import _collect
from tdm_sim.study.tables import Table, Trial

AXES = [Axis('x', (0.1, 1.0, 10.0), 'log'), Axis('kind', ('plain', 'odd'))]


def found(point: dict[str, Any]) -> dict[str, Any]:
    """Return what a plan that takes no time came to: none of the kind odd from 1 on."""
    if point['kind'] == 'odd' and point['x'] >= 1.0:
        nothing = dict.fromkeys(('cost', 'duration', 'solve_time', 'evaluations'))
        return {'verified': False, 'code': 'INFEASIBLE', 'reason': 'too <b>odd</b>', **nothing}
    figures = {'cost': 2 * point['x'], 'duration': point['x'], 'solve_time': 0.1, 'evaluations': 3}
    return {'verified': True, 'code': '', 'reason': '', **figures, 'margin.wall': 0.25}


@pytest.fixture(params=['.parquet', '.csv'])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return tmp_path / f'table{request.param}'


def collected(path: Path | None, order: list[int], until: int = 99) -> Any:
    """Return the table once rows came in this order, `until` Ctrl-C."""
    table, points = Table(path), Points(AXES)
    left = [row for row in range(len(points)) if row not in table.rows]

    def results() -> Iterator[tuple[int, dict[str, Any]]]:
        for count, row in enumerate(row for row in order if row in left):
            if count == until:
                raise KeyboardInterrupt
            yield left.index(row), found(points[row])

    _collect(table, left, points, results(), Progress(quiet=True))
    return table.save()


def test_the_table_is_the_same_in_whatever_order_rows_come(path: Path) -> None:
    whole = collected(path, [0, 1, 2, 3, 4, 5])
    assert whole.equals(collected(None, [5, 3, 1, 0, 2, 4]))
    assert whole.column_names[:4] == ['row', 'x', 'kind', 'verified']
    assert whole['verified'].to_pylist() == [True, True, True, False, True, False]
    assert whole['cost'].to_pylist() == [0.2, 0.2, 2.0, None, 20.0, None]
    assert Table(path).save().equals(whole)


def test_texts_that_are_all_empty_stay_texts(path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        collected(path, [0, 1, 2, 4], until=3)
    assert Table(path).save()['reason'].to_pylist() == ['', '', '']


def test_an_interrupted_study_leaves_a_table_and_goes_on(path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        collected(path, [4, 3, 0, 1, 2, 5], until=2)
    assert Table(path).rows == {3, 4}
    assert collected(path, [0, 1, 2, 3, 4, 5]).equals(collected(None, [0, 1, 2, 3, 4, 5]))


def test_a_table_that_is_none_is_named(path: Path) -> None:
    path.write_bytes(b'\xff\x00')
    with pytest.raises(UnusableFile, match=path.name):
        Table(path).save()


@pytest.mark.parametrize('closed', [False, True])
@pytest.mark.parametrize(
    ('axes', 'names'),
    [
        ([Axis('x', (3.0, 1.0, 2.0), 'random')], ['curve']),
        ([Axis('x', (1.0, 2.0, 4.0), 'log'), Axis('solver.seed', (0, 1))], ['curve']),
        ([Axis('x', (1.0, 2.0), 'linear'), Axis('kind', ('plain', 'odd'))], ['cost', 'duration']),
        (
            [Axis('x', (1.0, 2.0, 0.2), 'random'), Axis('y', (1.0, 2.0, 0.0), 'random')],
            ['cost', 'duration'],
        ),
        (
            [Axis('x', (1.0, 2.0)), Axis('y', (1, 2)), Axis('kind', ('plain', 'odd'))],
            ['cost', 'duration'],
        ),
        ([], []),
    ],
)
def test_pictures_and_page_of_any_number_of_variables(axes, names, closed, tmp_path):
    points = Points(axes)
    rows = [
        {'row': i, **p, **found({'kind': 'plain', 'x': 1.0, **p})} for i, p in enumerate(points)
    ]
    for row in rows if closed else []:
        flown = row['verified']
        counts = {'flights': 4, 'caught': 4, 'held': 3} if flown else {}
        row |= dict.fromkeys(('flights', 'caught', 'held')) | counts
    columns = {name: [row.get(name) for row in rows] for name in rows[0]}
    pictures = draw(columns, axes, {'x': 'N m'})
    several = names and 'curve' not in names
    assert list(pictures) == [*names, *(['caught', 'held'] if closed and several else [])]
    for name, (figure, _) in pictures.items():
        figure.savefig(tmp_path / f'{name}.png')
        assert any('x [N m]' in axis.get_xlabel() for axis in figure.axes)
    odd = any(row['code'] for row in rows)
    legends = [axis.get_legend() for figure, _ in pictures.values() for axis in figure.axes]
    texts = {text.get_text() for legend in legends if legend for text in legend.get_texts()}
    assert texts == ({'INFEASIBLE'} if odd else set())
    titled = {name: (title, b'') for name, (_, title) in pictures.items()}
    write_page(tmp_path / 'study.html', 'any', columns, axes, {'a': 1}, titled)
    page = (tmp_path / 'study.html').read_text()
    assert ('too &lt;b&gt;odd&lt;/b&gt;' in page) == odd
    assert '<b>' not in page
    assert 'http' not in page.replace('http-equiv', '')


def test_a_plan_that_does_nothing_leaves_the_others_their_colours() -> None:
    axes = [Axis('x', (1.0, 2.0)), Axis('y', (-1.0, 0.0, 1.0))]
    rows = [
        {
            'row': i,
            **p,
            **found({'kind': 'plain', 'x': 1.0}),
            'duration': p['x'] if p['y'] else 1e-3,
        }
        for i, p in enumerate(Points(axes))
    ]
    columns = {name: [row.get(name) for row in rows] for name in rows[0]}
    figure, _ = draw(columns, axes, {})['duration']
    (norm,) = {mesh.norm for axis in figure.axes[:1] for mesh in axis.collections if mesh.norm}
    assert (norm.vmin, norm.vmax) == pytest.approx((1.0 / 30.0, 2.0))


@pytest.mark.timeout(300)
def test_processes_find_the_same_to_the_last_bit_and_go_on_where_they_stopped(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    shared = ['--set', 'torque_reserve=.2', 'solver.deadline=.2']
    words = [
        'study',
        'pendulum',
        '--over',
        'limits.torque=.0001:.09:2',
        '--over',
        'start.psi=0,.1',
    ]
    assert main([*words, *shared, '-o', 'out', '--csv', '--processes', '2']) == 0
    assert 'study.html' in capsys.readouterr().out
    files = {path.name for path in Path('out').iterdir()}
    assert files == {'study.json', 'table.csv', 'study.html', 'duration.png'}
    kept = Table(Path('out/table.csv')).save()
    assert kept['verified'].to_pylist() == [False, False, True, True]
    trial = Trial(PendulumSwingUp, {'torque_reserve': 0.2, 'solver.deadline': 0.2})
    points = Points([Axis('limits.torque', (0.0001, 0.09)), Axis('start.psi', (0.0, 0.1))])
    for row, point in zip(kept.to_pylist(), points, strict=True):
        here = {**point, **trial(point)}
        assert {name: row[name] for name in here if name != 'solve_time'} == {
            name: value for name, value in here.items() if name != 'solve_time'
        }

    before = Path('out/table.csv').stat().st_mtime_ns
    assert main([*words, *shared, '-o', 'out', '--csv', '-q']) == 0
    assert Path('out/table.csv').stat().st_mtime_ns == before
    assert main([*words, '-o', 'out']) == 2
    assert 'holds another study' in capsys.readouterr().err
    asked = json.loads(Path('out/study.json').read_text())
    assert asked['over'] == {'limits.torque': [0.0001, 0.09], 'start.psi': [0.0, 0.1]}


@pytest.mark.parametrize(
    ('words', 'told'),
    [
        (['--over', 'limits.torqe=1'], 'limits.torque'),
        (['--over', 'limits.torque'], 'LOW:HIGH:N'),
        (['--over', 'start.psi=0', '--seeds', '3'], '--closed-loop'),
        (['--over', 'start.psi=0', '--closed-loop', '--seeds', '0'], "'seeds' = 0"),
        (['--over', 'start.psi=0', '--scheduler', 'localhost'], "'localhost' does not answer"),
    ],
)
def test_mistakes_get_one_sentence(words, told, tmp_path, capsys):
    assert main(['study', 'pendulum', *words, '-o', str(tmp_path / 'out'), '-q']) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert told in line
