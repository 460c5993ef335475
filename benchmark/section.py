# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""One section, in this process: ``python -m benchmark.section NAME SETTINGS OUTPUT``.

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
