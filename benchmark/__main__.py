# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Measure the package and write docs/benchmarks.md: ``python -m benchmark [SECTION ...]``.

    python -m benchmark closed_loop --set seeds=10 --no-docs    one table, of ten seeds

Every section runs in a process of its own; one that fails is said to on the page, and the exit
code is then 1. With sections named only these are run, and the page is brought up to date with
them. Timings are of one run on this machine: compare ratios.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
from pathlib import Path
import sys
import time
from typing import Any

from benchmark import page
from benchmark.runner import run
from benchmark.sections import Section, SECTIONS
from tdm_sim.progress import Progress

QUICK_FOLDER = Path('build') / 'benchmark'


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sections named on the command line, or all; returns the exit code."""
    options = _options(arguments)
    folder: Path = options.output or (QUICK_FOLDER if options.quick else page.DOCS)
    records = page.read(folder)
    failed = []
    with Progress() as progress:
        began = time.monotonic()
        for number, name in enumerate(options.sections, 1):
            section, title = SECTIONS[name], f'[{number}/{len(options.sections)}] {name}'
            progress.phase(title)
            settings = {**(section.quick if options.quick else section.full), **options.set}
            records[name] = _measured(section, settings, title, progress)
            if records[name]['figures'] is None:
                failed.append(name)
            if options.docs:  # after each, so that none are lost
                records = {each: records[each] for each in SECTIONS if each in records}
                page.keep(folder, records)
        if options.docs:
            written = page.write(folder, options.quick)
            progress.line(f'{written} written after {(time.monotonic() - began) / 60:.1f} min')
    if failed:
        print(f'failed: {", ".join(failed)}', file=sys.stderr)
    return 1 if failed else 0


def _measured(
    section: Section, settings: dict[str, Any], title: str, progress: Progress
) -> dict[str, Any]:
    """Run a section, print its table or why there is none; returns its record."""
    outcome = run(section, settings, lambda text: progress.update(f'{title}: {text}'))
    if outcome.figures is None:
        progress.line('\n'.join(outcome.log))
        progress.line(f'{section.name} failed: {outcome.failure}')
    else:
        progress.line(f'{section.table(outcome.figures)}\n({outcome.seconds:.0f} s)')
    return page.record(outcome)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='python -m benchmark', description=__doc__)
    parser.add_argument(
        'sections', nargs='*', metavar='SECTION', help=f'of {", ".join(SECTIONS)}; default: all'
    )
    parser.add_argument(
        '--quick',
        action='store_true',
        help=f'a few cases, to see that it works; into {QUICK_FOLDER} unless --output says else',
    )
    parser.add_argument(
        '--set', type=_setting, action='append', default=[], metavar='NAME=VALUE',
        help='of the sections, in the place of theirs',
    )  # fmt: skip
    parser.add_argument(
        '--output', type=Path, metavar='FOLDER', help='of the page, its figures and pictures'
    )
    parser.add_argument(
        '--docs',
        action=argparse.BooleanOptionalAction,
        default=True,
        help='write the page and its figures (the default)',
    )
    options = parser.parse_args(arguments)
    unknown = [name for name in options.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"there is no section '{unknown[0]}': must be of {', '.join(SECTIONS)}")
    options.sections = options.sections or list(SECTIONS)
    options.set = dict(options.set)
    for name in options.sections:
        for setting in sorted(set(options.set) - set(SECTIONS[name].full)):
            known = ', '.join(SECTIONS[name].full)
            parser.error(f"'{name}' has no setting '{setting}': must be of {known}")
    return options


def _setting(text: str) -> tuple[str, Any]:
    name, _, value = text.partition('=')
    return name, json.loads(value)


if __name__ == '__main__':
    sys.exit(main())
