# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
One section, in this process: ``python -m benchmark.section NAME SETTINGS OUTPUT``.

SETTINGS is JSON, OUTPUT the JSON file that the figures are written to. What is at work is said on
the standard error output, see `benchmark.progress`.
"""

from __future__ import annotations

import json
from pathlib import Path
import sys

from benchmark.sections import SECTIONS


def main(name: str, settings: str, output: str) -> None:
    """Measure and write the figures."""
    figures = SECTIONS[name].run(**json.loads(settings))
    Path(output).write_text(json.dumps(figures, default=float) + '\n')


if __name__ == '__main__':
    main(*sys.argv[1:])
