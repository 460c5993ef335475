# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the package: ``python -m benchmark [PART ...]``.

Prints every part's table as it is done and leaves the figures in ``benchmark.json`` in the working
directory; with --docs writes docs/benchmarks.md and its pictures from them. Timings are of one run
on this machine: compare ratios.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from datetime import datetime, timezone
import json
from pathlib import Path
import time
from typing import Any

from benchmark import (
    closed_loop,
    latency,
    library,
    nodes,
    page,
    peers,
    pendulum,
    profiling,
    replanning,
    robots,
)

PARTS: dict[str, tuple[Callable[..., dict[str, Any]], Callable[[dict[str, Any]], str]]] = {
    'peers': (peers.run, peers.table),
    'pendulum': (pendulum.run, pendulum.table),
    'robots': (robots.run, robots.table),
    'closed_loop': (closed_loop.run, closed_loop.table),
    'replanning': (replanning.run, replanning.table),
    'latency': (latency.run, latency.table),
    'nodes': (nodes.run, nodes.table),
    'library': (library.run, library.table),
    'profile': (profiling.run, profiling.table),
}
FIGURES = Path('benchmark.json')


def main() -> None:
    """Run the parts named on the command line, or all."""
    arguments = _arguments()
    figures: dict[str, Any] = {}
    if arguments.figures is not None:
        figures = json.loads(arguments.figures.read_text())
    else:
        measure(arguments.parts or list(PARTS), arguments.cases, figures)
    if arguments.docs:
        written = page.write(figures, {name: table for name, (_, table) in PARTS.items()})
        print(f'written to {written}')


def measure(parts: list[str], cases: int | None, figures: dict[str, Any]) -> None:
    """Run parts and write their figures after each, so that none are lost."""
    figures |= {
        'machine': page.machine(),
        'when': datetime.now(timezone.utc).date().isoformat(),
    }
    for name in parts:
        run, table = PARTS[name]
        print(f'== {name} ...', flush=True)
        began = time.perf_counter()
        figures[name] = run(cases) if name == 'peers' and cases else run()
        text = table(figures[name])
        print(f'{text}\n== {name}: {time.perf_counter() - began:.0f} s', flush=True)
        FIGURES.write_text(json.dumps(figures, indent=1, default=str) + '\n')
    print(f'figures written to {FIGURES}')


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='python -m benchmark', description=__doc__)
    parser.add_argument('parts', nargs='*', choices=[*PARTS, []], help='default: all')
    parser.add_argument('--cases', type=int, help='random cases of the peers (default 100)')
    parser.add_argument('--docs', action='store_true', help='write docs/benchmarks.md')
    parser.add_argument(
        '--figures', type=Path, metavar='FILE', help='take the figures of an earlier run'
    )
    arguments = parser.parse_args()
    if arguments.cases is not None and arguments.cases < 1:
        parser.error(f'--cases {arguments.cases}: must be at least 1')
    return arguments


if __name__ == '__main__':
    main()
