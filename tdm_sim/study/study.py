# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A study from beginning to end: points, rows, table, pictures, page.

Its folder holds its statement and the rows computed so far, a line each; the table is made of them
however the study ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import timedelta
from hashlib import sha256
from inspect import getfile
import io
import json
from pathlib import Path
import time
from typing import Any

import pyarrow as pa
from pyarrow import csv, parquet
from tdm_planner import __version__
from tdm_planner.exceptions import Failure, InvalidProblem, PlannerFault
from tdm_planner.plan_files import finite, make_folder, UnusableFile, write_file
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_sim.progress import Progress
from tdm_sim.study.axes import Axis, cell, checked, parse_axis, Point, points_of
from tdm_sim.study.flights import ClosedLoop, FLOWN, MARGIN, measured
from tdm_sim.study.workers import each, workers

Row = dict[str, Any]

ROWS = 'rows.jsonl'
_PERIOD = 10.0  # s between lines that stay
_FIGURES = ('cost', 'duration', 'solve_time', 'evaluations')
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
    named = problem if isinstance(problem, str) else f'{kind.__module__}:{kind.__qualname__}'
    source = ''
    with suppress(OSError, TypeError):  # classes of notebooks have no file
        source = sha256(Path(getfile(kind)).read_bytes()).hexdigest()
    statement = {  # the same statement gives the same rows
        'version': __version__,
        'problem': named,
        'source': source,
        'parameters': shared,
        'over': {axis.name: list(axis.values) for axis in axes},
        'closed_loop': closed_loop and asdict(closed_loop),
    }
    rows = Rows(folder and folder / ROWS, statement)
    left = [row for row in range(len(points)) if row not in rows.found]
    try:
        if left:
            done = len(rows.found)
            kept = f', {done} of which are there' if done else ''
            say.phase(f'planning {len(points)} times{kept}')
            with workers(scheduler, processes, kind.__module__) as client:
                if not client.nthreads():
                    say.phase('waiting for workers: the scheduler has none')
                lost = _row(PlannerFault.code, 'every process that computed it died')
                results = each(client, trial, [points[row] for row in left], lambda _: lost)
                _collect(rows, points, ((left[k], row) for k, row in results), say)
    finally:
        found = rows.table()
        if folder is not None and rows.found:
            written = io.BytesIO()
            _WRITERS[ending](found, written)
            write_file(folder / f'table{ending}', written.getvalue())
    if folder is not None:
        say.phase(f'drawing {folder}')
        _show(folder, found, axes, trial)
    return found


def _collect(rows: Rows, points: Sequence[Point], results: Iterator[Any], say: Progress) -> None:
    """Keep the rows as they are computed, and tell how many are left."""
    done, total = len(rows.found), len(points)
    began = told = time.monotonic()
    for count, (row, found) in enumerate(results, done + 1):
        rows.add({'row': row, **points[row], **found})
        now = time.monotonic()
        left = timedelta(seconds=round((now - began) / (count - done) * (total - count)))
        say.update(f'planning: {count} of {total}, {left} left')
        if not say.live and now - told > _PERIOD:
            told = now
            say.phase(f'{count} of {total}, {left} left')


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
        except Exception as error:  # noqa: B902
            # Also a fault of the program or of a user's problem: the study goes on.
            failure = Failure.of(error)
            return _row(failure.code, failure.reason)
        return row


def _row(code: str, reason: str) -> Row:
    return {'verified': not code, 'code': code, 'reason': reason, **dict.fromkeys(_FIGURES)}


class Rows:
    """
    The rows of a study, `found` by their numbers; lines of a file after one that states the study.

    `path` None: in memory only. The file is made with the first row: until then there is nothing
    to go on with. Raise UnusableFile if it cannot be used, or states another study, or if there
    is none, but other files beside it.
    """

    def __init__(self, path: Path | None, statement: Mapping[str, Any]) -> None:
        self._path = path
        self.found: dict[int, Row] = {}
        if path is None:
            return
        self._asked = json.dumps(finite(statement)).encode()
        make_folder(path.parent)
        if not path.exists():
            if any(path.parent.iterdir()):
                raise UnusableFile(
                    f"the folder '{path.parent}' holds files, and no study (no {ROWS}): name "
                    'another one'
                )
            return
        try:
            stated, *lines = path.read_bytes().split(b'\n')
        except OSError as error:
            raise UnusableFile(f"the file '{path}' cannot be read: {error.strerror}") from None
        if stated != self._asked:
            raise UnusableFile(
                f"the folder '{path.parent}' holds another study, or one of a statement that was "
                f'edited since (see {ROWS}): name another one'
            )
        for line in lines:
            with suppress(ValueError):  # it was cut off
                row = json.loads(line)
                self.found[row['row']] = row

    def add(self, row: Mapping[str, Any]) -> None:
        """Keep a row; its column `row` is its number. Raise UnusableFile if that fails."""
        kept = {name: cell(value) for name, value in row.items()}
        self.found[kept['row']] = kept
        if self._path is not None:
            head = b'' if self._path.exists() else self._asked
            write_file(self._path, head + b'\n' + json.dumps(kept).encode(), 'ab')

    def table(self) -> pa.Table:
        """Return all rows in their order."""
        rows = [row for _, row in sorted(self.found.items())]
        names = dict.fromkeys(['row', *(name for row in rows for name in row)])
        # Margins by name: an order that does not depend on which plans have them.
        last = sorted((n for n in names if n.startswith((MARGIN, FLOWN))), reverse=True)
        first = [name for name in names if name not in last]
        return pa.table({name: [row.get(name) for row in rows] for name in (*first, *last)})


def _show(folder: Path, table: pa.Table, axes: Sequence[Axis], trial: Trial) -> None:
    # matplotlib takes half a second to import, and worker processes do not need it
    from tdm_sim.study.pictures import draw, write_page

    columns = {name: table[name].to_pylist() for name in table.column_names}
    specs = trial.problem.parameter_specifications(trial.parameters)
    pictures = draw(columns, axes, {axis.name: specs[axis.name].unit for axis in axes})
    flown = {} if trial.closed_loop is None else asdict(trial.closed_loop)
    shared = {**trial.parameters, **{f'closed loop: {name}': v for name, v in flown.items()}}
    write_page(folder, trial.problem.name, columns, axes, shared, pictures)
