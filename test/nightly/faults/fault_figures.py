# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the scenarios of faults measure, kept for the table of docs/reliability.md."""

from __future__ import annotations

import json
import os
from pathlib import Path

EVERYTHING = os.environ.get('TDM_FAULTS') == 'all'
FILE = 'TDM_FAULT_FIGURES'  # where `python -m tools.measure_faults` collects


def note(scenario: str, **figures: float) -> None:
    """Print what was measured, times in s, and append it as a line of JSON to `FILE`."""
    print(f'{scenario}: ' + ', '.join(f'{k} {v:.3f}' for k, v in figures.items()))
    path = os.environ.get(FILE)
    if path:
        with Path(path).open('a', encoding='utf-8') as file:
            file.write(json.dumps({'scenario': scenario, **figures}) + '\n')
