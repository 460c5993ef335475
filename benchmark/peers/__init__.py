# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The same problems solved by this package and by what users would reach for otherwise.

`run` measures in a process of its own, on one core with one thread; `tables` makes the tables of
its figures, `charts` the picture.
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


def run(cases: int = 100) -> dict[str, Any]:
    """Measure `cases` random cases of every problem."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / 'peers.json'
        command = [sys.executable, '-m', 'benchmark.peers.measure', '--output', str(output)]
        subprocess.run(
            [*command, '--cases', str(cases)],
            cwd=Path(__file__).parents[2],
            env=os.environ | _ONE_THREAD,
            check=True,
        )
        figures: dict[str, Any] = json.loads(output.read_text())
    return figures


def table(figures: dict[str, Any]) -> str:
    """Return the figures as text."""
    return text(figures)
