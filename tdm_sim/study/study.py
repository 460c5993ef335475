# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A study from beginning to end: points, rows, table, pictures, page.

Its folder holds its statement and the table of the rows computed so far, which is replaced as a
whole, so that it can be read whenever the study ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import timedelta
from functools import partial
import json
import os
from pathlib import Path
import time
from typing import Any

import pyarrow as pa
from pyarrow import csv, parquet
from tdm_planner import __version__
from tdm_planner.exceptions import InvalidProblem, PlannerFault, TdmError
from tdm_planner.plan_files import finite, UnusableFile
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_sim.progress import Progress
from tdm_sim.study.axes import Axis, cell, checked, parse_axis, Point, points_of
from tdm_sim.study.flights import ClosedLoop, FLOWN, MARGIN, measured
from tdm_sim.study.workers import each, workers

Row = dict[str, Any]

_SAVED = 10.0  # s between two times at which the table is saved, and between lines that stay
STATEMENT = 'study.json'
_FIGURES = ('cost', 'duration', 'solve_time', 'evaluations')
# Where all texts are empty, CSV cannot tell that they are texts.
_TEXTS = csv.ConvertOptions(column_types=dict.fromkeys(('code', 'reason', 'lost'), pa.string()))
_READERS = {'.parquet': parquet.read_table, '.csv': partial(csv.read_csv, convert_options=_TEXTS)}
_WRITERS = {'.parquet': parquet.write_table, '.csv': csv.write_csv}


def run(
    problem: str | type[Problem],
    over: Mapping[str, str | Sequence[Any]] | Sequence[Axis],
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
    if isinstance(over, Mapping):
        over = [
            parse_axis(f'{name}={given}') if isinstance(given, str) else Axis(name, tuple(given))
            for name, given in over.items()
        ]
    axes = [checked(axis, kind, shared) for axis in over]
    points = points_of(axes)
    trial = Trial(kind, shared, closed_loop)
    folder = None if output is None else Path(output)
    if ending not in _WRITERS:
        raise InvalidProblem(
            f"the table cannot end in '{ending}': must be {' or '.join(_WRITERS)}"
        )
    if folder is not None:
        named = problem if isinstance(problem, str) else f'{kind.__module__}:{kind.__qualname__}'
        statement = {  # the same statement gives the same table
            'version': __version__,
            'problem': named,
            'parameters': shared,
            'over': {axis.name: list(axis.values) for axis in axes},
            'closed_loop': closed_loop and asdict(closed_loop),
        }
        _claim(folder, statement)
    table = Table(folder and folder / f'table{ending}')
    left = sorted({*range(len(points))} - table.rows)
    if left:
        done = len(points) - len(left)
        kept = f', {done} of which are there' if done else ''
        say.phase(f'planning {len(points)} times{kept}')
        with workers(scheduler, processes) as client:
            lost = _row(PlannerFault.code, 'every process that computed it died')
            results = each(client, trial, [points[row] for row in left], lambda _: lost)
            _collect(table, points, ((left[k], row) for k, row in results), say)
    found = table.save()
    if folder is not None:
        say.phase(f'drawing {folder}')
        _show(folder, found, axes, trial)
    return found


def _collect(table: Table, points: Sequence[Point], results: Iterator[Any], say: Progress) -> None:
    """Add the rows as they are computed; save the table now and then, and at any end."""
    done, total = len(table.rows), len(points)
    began = saved = time.monotonic()
    try:
        for count, (row, found) in enumerate(results, done + 1):
            table.add({'row': row, **points[row], **found})
            now = time.monotonic()
            left = timedelta(seconds=round((now - began) / (count - done) * (total - count)))
            text = f'{count} of {total}, {left} left'
            say.update(f'planning: {text}')
            if now - saved > _SAVED:
                if not say.live:
                    say.phase(text)
                table.save()
                saved = time.monotonic()
    finally:
        table.save()


@dataclass(frozen=True)
class Trial:
    """
    Computes the row of a point without its parameters: the plan and, in a closed loop, its runs.

    `parameters` are those that all points share. The row depends on the point alone, not on the
    clock or the order of points.
    """

    problem: type[Problem]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    closed_loop: ClosedLoop | None = None

    def __call__(self, point: Point) -> Row:
        """Return the row of a point."""
        try:
            problem = self.problem.from_parameters({**self.parameters, **point})
            solution = problem.solve(counted=True)
            row = _row('', '') | {name: getattr(solution, name) for name in _FIGURES}
            worst = solution.verification.worst
            row |= {f'{MARGIN}{name}': float(value) for name, value in worst.items()}
            if self.closed_loop is not None:
                row |= measured(problem, solution, self.closed_loop)
        except TdmError as error:
            return _row(error.code, str(error))
        except Exception as error:  # noqa: B902
            # A fault of the program or of a user's problem: the study goes on.
            return _row(PlannerFault.code, f'{type(error).__name__}: {error}')
        return row


def _row(code: str, reason: str) -> Row:
    return {'verified': not code, 'code': code, 'reason': reason, **dict.fromkeys(_FIGURES)}


class Table:
    """The rows of a study, new and found on the disk; `path` None: in memory only."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._kept = pa.table({'row': pa.array([], pa.int64())})
        self._fresh: list[Mapping[str, Any]] = []
        try:
            if path is not None and path.is_file():
                self._kept = _READERS[path.suffix](path)
        except (OSError, pa.ArrowInvalid) as error:
            raise UnusableFile(f"the table '{path}' cannot be read: {error}") from None

    @property
    def rows(self) -> set[int]:
        """Numbers of the rows that were found on the disk."""
        return set(self._kept['row'].to_pylist())

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a row; its column `row` is its number."""
        self._fresh.append({name: cell(value) for name, value in row.items()})

    def save(self) -> pa.Table:
        """Return all rows in their order, written to the disk; UnusableFile if that fails."""
        if not self._fresh:
            return self._kept
        names = dict.fromkeys(name for row in self._fresh for name in row)
        fresh = pa.table({name: [row.get(name) for row in self._fresh] for name in names})
        found = pa.concat_tables([self._kept, fresh], promote_options='permissive').sort_by('row')
        # Margins by name: an order that does not depend on which rows came first.
        last = sorted(name for name in found.column_names if name.startswith((MARGIN, FLOWN)))
        first = [name for name in found.column_names if name not in last]
        self._kept, self._fresh = found.select([*first, *reversed(last)]).combine_chunks(), []
        if self._path is not None:
            new = self._path.with_suffix('.new')
            try:
                _WRITERS[self._path.suffix](self._kept, new)
                os.replace(new, self._path)
            except OSError as error:
                text = f"the table '{self._path}' cannot be written: {error.strerror}"
                raise UnusableFile(text) from None
        return self._kept


def _claim(folder: Path, statement: Mapping[str, Any]) -> None:
    """Take a folder for the study of this statement, a new one or that of the same study."""
    asked, path = json.dumps(finite(statement), indent=1) + '\n', folder / STATEMENT
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not path.is_file():
            path.write_text(asked, encoding='utf-8')
        same = path.read_text(encoding='utf-8') == asked
    except OSError as error:
        raise UnusableFile(f"the folder '{folder}' cannot be used: {error.strerror}") from None
    if not same:
        said = f"the folder '{folder}' holds another study (see {STATEMENT}): name another one"
        raise UnusableFile(said)


def _show(folder: Path, table: pa.Table, axes: Sequence[Axis], trial: Trial) -> None:
    # matplotlib takes half a second to import, and worker processes do not need it
    from tdm_sim.study.pictures import draw, write_page

    columns = {name: table[name].to_pylist() for name in table.column_names}
    specs = trial.problem.parameter_specifications(trial.parameters)
    pictures = draw(columns, axes, {axis.name: specs[axis.name].unit for axis in axes})
    flown = {} if trial.closed_loop is None else asdict(trial.closed_loop)
    shared = {**trial.parameters, **{f'closed loop: {name}': v for name, v in flown.items()}}
    write_page(folder, trial.problem.name, columns, axes, shared, pictures)
