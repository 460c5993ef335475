# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The figures that the page is written from, as a file beside it: sections run one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import importlib.metadata
import json
import os
from pathlib import Path
import platform
import re
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
    text = json.dumps(records)
    rounded = json.loads(text, parse_float=lambda digits: float(f'{float(digits):.{_DIGITS}g}'))
    lines = (
        f'{json.dumps(name)}: {json.dumps(record, separators=(",", ":"))}'
        for name, record in rounded.items()
    )
    # A section a line: what has changed shows.
    file.write_text('{\n' + ',\n'.join(lines) + '\n}\n')
    return file


def record(outcome: Outcome) -> dict[str, Any]:
    """Return what is kept of a run, with the machine and the versions it was made with."""
    kept = asdict(outcome)
    del kept['log']
    return {**kept, 'machine': machine(), 'versions': versions()}


def machine() -> str:
    """Processor, cores and Python."""
    told = re.search(r'^model name\s*: (.*)$', Path('/proc/cpuinfo').read_text(), re.MULTILINE)
    name = told[1] if told else platform.processor() or platform.machine()
    return f'{name}, {os.cpu_count()} cores, Python {platform.python_version()}'


def versions() -> dict[str, str]:
    """Versions of this package and of what it is compared with."""
    return {name: importlib.metadata.version(name) for name in _PACKAGES}
