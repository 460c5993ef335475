# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The same problems solved by this package and by what users would reach for otherwise.

`run` measures in a process of its own, on one core with one thread; `tables` makes the tables of
its figures, `charts` the pictures.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

from benchmark.peers.tables import text

_ONE_THREAD = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')


def run(cases: int = 100, quick: bool = False) -> dict[str, Any]:
    """Measure `cases` random cases of every problem; `quick`: hardly any nodes, robots, ..."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / 'peers.json'
        command = [sys.executable, '-m', 'benchmark.peers.measure', '--output', str(output)]
        subprocess.run(
            [*command, '--cases', str(cases), *(['--quick'] if quick else [])],
            cwd=Path(__file__).parents[2],
            env=os.environ | _ONE_THREAD,
            check=True,
        )
        figures: dict[str, Any] = json.loads(output.read_text())
    return figures


def table(figures: dict[str, Any]) -> str:
    """Return the figures as text."""
    return text(figures)
