# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The folder of a study: its statement, its rows, and the table of those computed so far.

The table is replaced as a whole, so that it can be read whenever the study ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import csv, parquet
from tdm_planner.exceptions import PlannerFault, TdmError
from tdm_planner.plan_files import finite, UnusableFile
from tdm_planner.problems.problem import Problem
from tdm_sim.study.axes import Point
from tdm_sim.study.flights import ClosedLoop, FLOWN, measured

Row = dict[str, Any]

MARGIN = 'margin.'  # before the name of a limit: what the plan leaves of it at worst
STATEMENT = 'study.json'
_TEXTS = dict.fromkeys(('code', 'reason', 'lost'), pa.string())
ENDINGS = ('.parquet', '.csv')


@dataclass(frozen=True)
class Trial:
    """
    Computes a point: the plan and, with a closed loop, its runs.

    `parameters` are those that all points share. The result is the row without its parameters. It
    depends on the point alone, not on the clock or the order of points.
    """

    problem: type[Problem]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    closed_loop: ClosedLoop | None = None

    def __call__(self, point: Point) -> Row:
        """Return the row of a point."""
        try:
            return self._tried(point)
        except TdmError as error:
            return failed(error.code, str(error))
        except Exception as error:  # noqa: B902
            # A fault of the program or of a user's problem: the study goes on.
            return failed(PlannerFault.code, f'{type(error).__name__}: {error}')

    def lost(self, point: Point) -> Row:
        """Return the row of a point at which every process died."""
        del point
        return failed(PlannerFault.code, 'every process that computed it died')

    def _tried(self, point: Point) -> Row:
        problem = self.problem.from_parameters({**self.parameters, **point})
        solution = problem.solve(counted=True)
        row: Row = {
            'verified': True,
            'code': '',
            'reason': '',
            'cost': float(solution.cost),
            'duration': float(solution.duration),
            'solve_time': solution.solve_time,
            'evaluations': solution.evaluations,
        }
        check = solution.verification
        row |= {f'{MARGIN}{name}': float(value) for name, value in check.worst.items()}
        if self.closed_loop is not None:
            row |= measured(problem, solution, self.closed_loop)
        return row


def failed(code: str, reason: str) -> Row:
    """Return the row of a point without a plan."""
    nothing = dict.fromkeys(('cost', 'duration', 'solve_time', 'evaluations'))
    return {'verified': False, 'code': code, 'reason': reason, **nothing}


class Table:
    """The rows of a study, new and found on the disk; `path` None: in memory only."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._kept = pa.table({'row': pa.array([], pa.int64())})
        self._fresh: list[Mapping[str, Any]] = []
        if path is not None and path.is_file():
            self._kept = _read(path)

    @property
    def rows(self) -> set[int]:
        """Numbers of the rows that were found on the disk."""
        return set(self._kept['row'].to_pylist())

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a row; its column `row` is its number."""
        self._fresh.append(row)

    def save(self) -> pa.Table:
        """
        Return all rows in their order, written to the disk.

        Raises
        ------
        UnusableFile
            If that cannot be written.

        """
        if self._fresh:
            names = dict.fromkeys(name for row in self._fresh for name in row)
            columns = {name: [_cell(row.get(name)) for row in self._fresh] for name in names}
            both = [self._kept, pa.table(columns)]
            found = pa.concat_tables(both, promote_options='permissive').sort_by('row')
            self._kept = found.select(_ordered(found.column_names)).combine_chunks()
            self._fresh = []
            if self._path is not None:
                _write(self._kept, self._path)
        return self._kept


def _ordered(names: Sequence[str]) -> list[str]:
    """Return columns in an order that does not depend on the first rows: margins by name."""
    margins = [name for name in names if name.startswith((MARGIN, FLOWN))]
    return [name for name in names if name not in margins] + sorted(margins, reverse=True)


def _cell(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, (list, tuple)) else value


def _read(path: Path) -> pa.Table:
    try:
        if path.suffix == '.csv':  # where all texts are empty, it cannot tell that they are texts
            return csv.read_csv(path, convert_options=csv.ConvertOptions(column_types=_TEXTS))
        return parquet.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise UnusableFile(f"the table '{path}' cannot be read: {error}") from None


def _write(table: pa.Table, path: Path) -> None:
    new = path.with_suffix('.new')
    try:
        if path.suffix == '.csv':
            csv.write_csv(table, new)
        else:
            parquet.write_table(table, new)
        os.replace(new, path)
    except OSError as error:
        raise UnusableFile(f"the table '{path}' cannot be written: {error.strerror}") from None


def claim(folder: Path, statement: Mapping[str, Any]) -> None:
    """
    Take a folder for the study of this statement, a new one or that of the same study.

    Raises
    ------
    UnusableFile
        If it holds another study, or cannot be written.

    """
    asked = json.dumps(finite(statement), indent=1) + '\n'
    path = folder / STATEMENT
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if path.is_file():
            if path.read_text(encoding='utf-8') != asked:
                raise UnusableFile(
                    f"the folder '{folder}' holds another study (see {STATEMENT}): name another "
                    'one'
                )
        else:
            path.write_text(asked, encoding='utf-8')
    except OSError as error:
        raise UnusableFile(f"the folder '{folder}' cannot be used: {error.strerror}") from None
