# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The figures that the page is written from, as a file beside it: sections run one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import importlib.metadata
import json
import math
import os
from pathlib import Path
import platform
from typing import Any

from benchmark.runner import Outcome

NAME = 'benchmarks.json'
_DIGITS = 6
_PACKAGES = ('tdm_planner', 'numpy', 'scipy', 'numba', 'daqp', 'casadi')

Records = dict[str, dict[str, Any]]


def read(folder: Path) -> Records:
    """Return the records of the sections that were run, by name; none if there is no file."""
    file = folder / NAME
    if not file.is_file():
        return {}
    found: Records = json.loads(file.read_text())
    return found


def write(folder: Path, records: Mapping[str, Any]) -> Path:
    """Write the records; figures keep six digits."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / NAME
    lines = (
        f'{json.dumps(name)}: {json.dumps(_rounded(record), separators=(",", ":"))}'
        for name, record in records.items()
    )
    # A section a line: what has changed shows.
    file.write_text('{\n' + ',\n'.join(lines) + '\n}\n')
    return file


def record(outcome: Outcome) -> dict[str, Any]:
    """Return what is kept of a run, with the machine and the versions it was made with."""
    kept = asdict(outcome)
    del kept['log']
    return {**kept, 'machine': machine(), 'versions': versions()}


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f'{value:.{_DIGITS}g}') if math.isfinite(value) else value
    if isinstance(value, Mapping):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value


def machine() -> str:
    """Processor, cores and Python."""
    name = platform.processor() or platform.machine()
    cpu = Path('/proc/cpuinfo')
    if cpu.is_file():
        models = [line for line in cpu.read_text().splitlines() if line.startswith('model name')]
        name = models[0].split(':')[1].strip() if models else name
    return f'{name}, {os.cpu_count()} cores, Python {platform.python_version()}'


def versions() -> dict[str, str]:
    """Versions of this package and of what it is compared with."""
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = 'not installed'
    return found
