# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A study from beginning to end: points, rows, table, pictures, page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
import time
from typing import Any

import pyarrow as pa
from tdm_planner import __version__
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_sim.progress import Progress
from tdm_sim.study.axes import Axis, checked, parse_axis, Point, points_of
from tdm_sim.study.flights import ClosedLoop
from tdm_sim.study.tables import claim, ENDINGS, Table, Trial
from tdm_sim.study.workers import each, workers

Over = Mapping[str, str | Sequence[Any]] | Sequence[Axis]

_SAVED = 10.0  # s between two times at which the table is saved
_SAID = 10.0  # s between two lines where nothing is live


def run(
    problem: str | type[Problem],
    over: Over,
    output: Path | str | None = None,
    *,
    parameters: Mapping[str, Any] | None = None,
    closed_loop: ClosedLoop | None = None,
    scheduler: str | None = None,
    processes: int | None = None,
    ending: str = '.parquet',
    progress: Progress | None = None,
) -> pa.Table:
    """
    Plan for every combination of parameters; returns a table with a row for each, in order.

    `problem` is a class, an installed name or ``module:Class``. `over` holds what is varied by
    name: values, or a range as ``--over`` has it, ``'0.01:0.1:20'``; `parameters` what all plans
    have in common. With `closed_loop` every plan is flown, too. Work is done by `processes`, one a
    core by default, or by the Dask cluster of `scheduler`, ``HOST:PORT``.

    With an `output` folder table (``.parquet`` or ``.csv``), pictures and page are written there,
    and what the folder holds of the same study is not done again: an interrupted one goes on.

    Columns: `row`; the varied parameters; `verified`, `code` and `reason` of a failure, `cost`,
    `duration` [s], `solve_time` [s], `evaluations`; ``margin.NAME``, what the plan leaves of every
    limit at worst; in a closed loop `flights`, `caught`, `held`, `lost` and ``flown.NAME``.
    Everything but `solve_time` is the same to the last bit however many processes there are:
    searches count evaluations instead of looking at the clock.

    Raises
    ------
    InvalidProblem
        If a parameter is unknown or not allowed, the scheduler does not answer, or the folder
        holds another study.

    """
    say = progress or Progress(quiet=True)
    kind = load_problem(problem) if isinstance(problem, str) else problem
    shared = dict(parameters or {})
    axes = [checked(axis, kind, shared) for axis in _axes(over)]
    points = points_of(axes)
    trial = Trial(kind, shared, closed_loop)
    folder = None if output is None else Path(output)
    if ending not in ENDINGS:
        raise InvalidProblem(f"the table cannot end in '{ending}': must be {' or '.join(ENDINGS)}")
    if folder is not None:
        claim(folder, _statement(problem, trial, axes))
    table = Table(None if folder is None else folder / f'table{ending}')
    done = table.rows
    left = [row for row in range(len(points)) if row not in done]
    if left:
        kept = f', {len(done)} of which are there' if done else ''
        say.phase(f'planning {len(points)} times{kept}')
        with workers(scheduler, processes) as client:
            _collect(table, points, each(client, trial, points, trial.lost, left), say)
    found = table.save()
    if folder is not None:
        say.phase(f'drawing {folder}')
        _show(folder, found, axes, trial)
    return found


def _axes(over: Over) -> list[Axis]:
    if not isinstance(over, Mapping):
        return list(over)
    return [
        parse_axis(f'{name}={given}') if isinstance(given, str) else Axis(name, tuple(given))
        for name, given in over.items()
    ]


def _statement(problem: str | type[Problem], trial: Trial, axes: Sequence[Axis]) -> Point:
    """Return the statement of a study: the same statement gives the same table."""
    name = problem if isinstance(problem, str) else f'{problem.__module__}:{problem.__qualname__}'
    return {
        'version': __version__,
        'problem': name,
        'parameters': dict(trial.parameters),
        'over': {axis.name: list(axis.values) for axis in axes},
        'closed_loop': trial.closed_loop and asdict(trial.closed_loop),
    }


def _collect(table: Table, points: Sequence[Point], results: Iterator[Any], say: Progress) -> None:
    """Add the rows as they are computed; save the table now and then, and at any end."""
    done = len(table.rows)
    left = len(points) - done
    began = saved = said = time.monotonic()
    try:
        for count, (row, found) in enumerate(results, 1):
            table.add({'row': row, **points[row], **found})
            now = time.monotonic()
            began = now if count == 1 else began  # processes have started by then
            text = f'{done + count} of {len(points)}'
            if count > 1:
                text += f', {_span((now - began) / (count - 1) * (left - count))} left'
            say.update(f'planning: {text}')
            if now - said > _SAID:
                said = now
                if not say.live:
                    say.phase(text)
            if now - saved > _SAVED:
                table.save()
                saved = time.monotonic()
    finally:
        table.save()


def _span(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f'{minutes} min {rest:02d} s' if minutes else f'{rest} s'


def _show(folder: Path, table: pa.Table, axes: Sequence[Axis], trial: Trial) -> None:
    """Write pictures and page."""
    # matplotlib takes half a second to import, and worker processes do not need it
    from tdm_sim.study.pictures import draw, write_page

    columns = {name: table[name].to_pylist() for name in table.column_names}
    specs = trial.problem.parameter_specifications(trial.parameters)
    units = {axis.name: specs[axis.name].unit for axis in axes}
    pictures = draw(columns, axes, units)
    shared = dict(trial.parameters)
    if trial.closed_loop is not None:
        shared |= {f'closed loop: {name}': v for name, v in asdict(trial.closed_loop).items()}
    write_page(folder, trial.problem.name, columns, axes, shared, pictures)
