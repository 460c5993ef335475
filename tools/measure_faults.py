# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Carry out the faults of processes again and again, and print what was measured.

python -m tools.measure_faults [PYTEST ARGUMENTS]

The figures are those of docs/reliability.md; times in s.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
import json
import os
from pathlib import Path
import platform
import statistics
import subprocess
import sys
import tempfile
import time

TESTS = ('test/nightly/faults/test_process_faults.py',)
FIGURES = 'TDM_FAULT_FIGURES'


def measure(file: Path, arguments: Sequence[str] = ()) -> int:
    """Run the tests; figures go to `file`, one JSON object a line."""
    environment = {**os.environ, FIGURES: str(file)}
    command = [sys.executable, '-m', 'pytest', '-q', '--timeout', '1800', *TESTS, *arguments]
    return subprocess.run(command, env=environment, check=False).returncode


def table(lines: Sequence[str]) -> str:
    """Return the figures by scenario: how often, median and largest."""
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    for line in lines:
        figures = json.loads(line)
        scenario = figures.pop('scenario')
        for name, value in figures.items():
            found[scenario, name].append(value)
    rows = ['| fault | figure | times | median | largest |', '|---|---|---|---|---|']
    rows += [
        f'| {scenario} | {name} | {len(values)} | {statistics.median(values):.3f} '
        f'| {max(values):.3f} |'
        for (scenario, name), values in found.items()
    ]
    return '\n'.join(rows)


def main() -> int:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, 'figures.jsonl')
        file.touch()
        code = measure(file, sys.argv[1:])
        print(table(file.read_text(encoding='utf-8').splitlines()))
    print(f'{time.strftime("%Y-%m-%d")}, {platform.platform()}, {os.cpu_count()} processors')
    return code


if __name__ == '__main__':
    sys.exit(main())
