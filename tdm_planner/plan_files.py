# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plans as files: JSON (everything), CSV (a table), NPZ (arrays); chosen by the file's ending."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import csv
import io
import json
import math
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory


class UnusableFile(InvalidProblem):
    """A file or folder cannot be used as asked to; the message names it and says why."""

    code: ClassVar[str] = 'FILE'


VEHICLE_FIGURES = ('problem', 'duration', 'cost', 'penalty', 'solve_time', 'evaluations')


def plan_document(problem: Problem, solution: Solution) -> dict[str, Any]:
    """Return what a plan file holds: the solution, and the problem's parameters by dotted name."""
    return {
        **solution.to_dict(),
        'summary': solution.summary,
        'parameters': finite(problem.to_parameters()),
    }


def finite(value: Any) -> Any:
    """Return a JSON value in which None stands for every number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [finite(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def vehicles(plan: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the plan of every vehicle by name; a plan of a single one has the name ''."""
    return dict(plan['robots']) if 'robots' in plan else {'': plan}


def to_json(plan: Mapping[str, Any]) -> bytes:
    """Return the plan (`Solution.to_dict`) as JSON, numbers to the last bit."""
    return (json.dumps(plan, indent=1, allow_nan=False) + '\n').encode()


def to_csv(plan: Mapping[str, Any]) -> bytes:
    """Return a table: (robot,) time, states, controls; one row a sample."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    for index, (name, part) in enumerate(vehicles(plan).items()):
        label = [name] if name else []
        if index == 0:
            head = ['robot'] if name else []
            writer.writerow([*head, 'time', *part['states'], *part['controls']])
        columns = [part['times'], *part['states'].values(), *part['controls'].values()]
        writer.writerows([*label, *map(repr, row)] for row in zip(*columns, strict=True))
    return text.getvalue().encode()


def to_npz(plan: Mapping[str, Any]) -> bytes:
    """
    Return arrays `times` and one for every state and control; ``robot/`` before each name.

    Raise UnusableFile for a state or control that is called as another array.
    """
    arrays: dict[str, Any] = {figure: np.array(plan[figure]) for figure in VEHICLE_FIGURES}
    for name, part in vehicles(plan).items():
        prefix = f'{name}/' if name else ''
        arrays[f'{prefix}times'] = np.array(part['times'])
        arrays[f'{prefix}interpolation'] = np.array(part['interpolation'])
        for group in ('states', 'controls'):
            for column, values in part[group].items():
                if f'{prefix}{column}' in arrays:
                    raise UnusableFile(
                        f"a .npz file cannot hold the {group[:-1]} '{column}', which is the name "
                        'of another array there: write a .json file'
                    )
                arrays[f'{prefix}{column}'] = np.array(values)
    data = io.BytesIO()
    np.savez_compressed(data, **arrays)
    return data.getvalue()


WRITERS: dict[str, Callable[[Mapping[str, Any]], bytes]] = {
    '.json': to_json,
    '.csv': to_csv,
    '.npz': to_npz,
}


def check_path(path: Path, endings: tuple[str, ...] = tuple(WRITERS)) -> None:
    """Raise UnusableFile for a path that cannot be written, before a long computation begins."""
    if path.suffix.lower() not in endings:
        raise UnusableFile(f"the file '{path}' must end in one of {', '.join(endings)}")
    if not path.parent.is_dir():
        raise UnusableFile(f"the folder '{path.parent}' does not exist")
    if path.is_dir():
        raise UnusableFile(f"'{path}' is a folder, not a file")


def save_plan(plan: Mapping[str, Any], path: Path | str) -> None:
    """
    Write a plan (`Solution.to_dict`) in the format of the path's ending.

    Raises
    ------
    UnusableFile
        If the path is not one that can be written.

    """
    path = Path(path)
    check_path(path)
    write_file(path, WRITERS[path.suffix.lower()](plan))


def make_folder(path: Path) -> None:
    """Make a folder unless it is there; raises UnusableFile if that cannot be done."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableFile(f"the folder '{path}' cannot be made: {error.strerror}") from None


def write_file(path: Path, data: bytes, mode: str = 'wb') -> None:
    """Write a file, or append to it ('ab'); raises UnusableFile if that cannot be done."""
    try:
        with path.open(mode) as file:
            file.write(data)
    except OSError as error:
        raise UnusableFile(f"the file '{path}' cannot be written: {error.strerror}") from None


def load_plan(path: Path | str) -> dict[str, Any]:
    """
    Read a plan from its JSON file.

    Raises
    ------
    UnusableFile
        If the file cannot be read or is not a plan.

    """
    try:
        plan: dict[str, Any] = json.loads(Path(path).read_text())
    except OSError as error:
        raise UnusableFile(f"the file '{path}' cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise UnusableFile(f"the file '{path}' is not JSON") from None
    try:
        parts = vehicles(plan)
        if not parts or 'problem' not in plan:
            raise KeyError('problem')
        for part in parts.values():
            Trajectory.from_dict(dict(part))
    except InvalidProblem as error:
        raise UnusableFile(f"the file '{path}' is not a plan written by tdm: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError):
        raise UnusableFile(f"the file '{path}' is not a plan written by tdm") from None
    return plan
