# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the package: ``python -m benchmark [PART ...]``.

Prints every part's table as it is done and leaves them in ``benchmark.md`` and ``benchmark.json``
in the working directory. Timings are of one run on this machine: compare ratios.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import os
from pathlib import Path
import platform
import time
from typing import Any

from benchmark import closed_loop, library, nodes, pendulum, replanning, robots

PARTS: dict[str, tuple[Callable[[], dict[str, Any]], Callable[[dict[str, Any]], str]]] = {
    'pendulum': (pendulum.run, pendulum.table),
    'robots': (robots.run, robots.table),
    'closed_loop': (closed_loop.run, closed_loop.table),
    'replanning': (replanning.run, replanning.table),
    'nodes': (nodes.run, nodes.table),
    'library': (library.run, library.table),
}


def main() -> None:
    """Run the parts named on the command line, or all."""
    parser = argparse.ArgumentParser(prog='python -m benchmark', description=__doc__)
    parser.add_argument('parts', nargs='*', choices=[*PARTS, []], help='default: all')
    chosen = parser.parse_args().parts or list(PARTS)
    machine = f'{platform.processor() or platform.machine()}, {os.cpu_count()} cores, '
    machine += f'Python {platform.python_version()}'
    report, figures = [f'# Benchmark\n\n{machine}\n'], {}
    for name in chosen:
        run, table = PARTS[name]
        print(f'== {name} ...', flush=True)
        began = time.perf_counter()
        figures[name] = run()
        text = table(figures[name])
        print(f'{text}\n== {name}: {time.perf_counter() - began:.0f} s', flush=True)
        report.append(f'## {name}\n\n```\n{text}\n```\n')
        Path('benchmark.md').write_text('\n'.join(report))
        Path('benchmark.json').write_text(json.dumps(figures, indent=1, default=str) + '\n')
    print('written to benchmark.md and benchmark.json')


if __name__ == '__main__':
    main()
