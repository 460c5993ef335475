# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The page benchmarks.md and its picture, from the records of the sections.

These are kept in a file beside it: sections may be run one by one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
import importlib.metadata
import json
import os
from pathlib import Path
import platform
import re
from typing import Any

from benchmark.peers.tables import draw, in_short, sections
from benchmark.runner import Outcome
from benchmark.sections import Section, SECTIONS

DOCS = Path(__file__).parents[1] / 'docs'
NAME = 'benchmarks.json'
PICTURES = 'images'
_DIGITS = 6
_PACKAGES = ('tdm_planner', 'numpy', 'scipy', 'numba', 'daqp', 'casadi')

_INTRODUCTION = """\
# Benchmarks

Written by `make benchmark` from the figures of its run, which are in `benchmarks.json` beside this
page, on {made_with}.
Compare ratios: absolute times are those of a machine that may have had other work.
"""

_QUICK = """\
**A quick run of a few cases: it shows that the benchmark works. Its figures say nothing.**
"""

_PEERS = """\
- **tdm_planner**: `solve()` as the planner node calls it, with its own check of the plan;
  robots without `thrust_reserve`, as collocation keeps none. Iterations are evaluations of the
  dynamics along a candidate.
- **collocation**: Hermite-Simpson with exact first and second derivatives, CasADi and Ipopt with
  MUMPS. Variables are scaled, expressions expanded to scalars and built once; only Ipopt's own
  time is counted, not that of building, guessing or checking. Barrier strategy, tolerances and
  guesses were chosen for the most and quickest solutions.
  Initial guesses of the swing-up: the straight line to upright; a simulated swing under energy
  control (Astrom and Furuta 2000), full or slow. Of the robots: straight ways with a quintic law
  of time, or all bowed to one side. *Best of 3* tries all three.
- **warm**: from the plan of a neighbouring state (up to .05 rad and .25 rad/s, or 5 cm for every
  robot away). Collocation starts from its own optimum there, with its multipliers.

Every solution is flown: its controls, linear or held between nodes as its author says, drive the
true equations of motion (DOP853, or exact quadrature for the robots). *Solved* means that this
flight ends within .05 rad and .5 rad/s of upright, or within 2 cm, .01 m/s, .05 rad and .02 rad/s
of every robot's goal, with limits kept (disk within .01 rad, distances within 1 cm). Plans of this
package pass a stricter check besides: 1e-4 rad and 1e-3 rad/s; 3.5 mm. *Within 1.02* is the share
of all cases solved at no more than 1.02 times the best known cost, which a long search and
collocation from its result gave (`benchmark/*_reference.py`).

![Share of cases solved near the best known cost within a time](images/benchmark_success.png)
"""


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the records of the sections that were run, by name; none if there is no file."""
    file = folder / NAME
    found: dict[str, dict[str, Any]] = json.loads(file.read_text()) if file.is_file() else {}
    return found


def keep(folder: Path, records: Mapping[str, Any]) -> None:
    """Write the records; figures keep six digits."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(records)
    rounded = json.loads(text, parse_float=lambda digits: float(f'{float(digits):.{_DIGITS}g}'))
    lines = (
        f'{json.dumps(name)}: {json.dumps(record, separators=(",", ":"))}'
        for name, record in rounded.items()
    )
    # A section a line: what has changed shows.
    (folder / NAME).write_text('{\n' + ',\n'.join(lines) + '\n}\n')


def record(outcome: Outcome) -> dict[str, Any]:
    """Return what is kept of a run, with the machine and the versions it was made with."""
    kept = asdict(outcome)
    del kept['log']
    versions = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return {**kept, 'machine': _machine(), 'versions': versions}


def _machine() -> str:
    """Processor, cores and Python."""
    told = re.search(r'^model name\s*: (.*)$', Path('/proc/cpuinfo').read_text(), re.MULTILINE)
    name = told[1] if told else platform.processor() or platform.machine()
    return f'{name}, {os.cpu_count()} cores, Python {platform.python_version()}'


def write(folder: Path, quick: bool) -> Path:
    """
    Write the page from the records that are kept in a folder, and its chart.

    Sections that were never run, or failed, say so.
    """
    records = read(folder)
    made_with = Counter(_made_with(record) for record in records.values()).most_common(1)
    usual = made_with[0][0] if made_with else 'no machine yet'
    parts = [_INTRODUCTION.format(made_with=usual)]
    if quick:
        parts.append(_QUICK)
    parts += [
        _section(section, records.get(name), folder, usual) for name, section in SECTIONS.items()
    ]
    page = folder / 'benchmarks.md'
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text('\n'.join(parts))
    return page


def _section(section: Section, record: Mapping[str, Any] | None, folder: Path, usual: str) -> str:
    head = f'## {section.title}\n\n`python -m benchmark {section.name}`'
    if record is None:
        return f'{head}: not measured yet.\n'
    described = section.about.format(**{**section.full, **record['settings']})
    if record['figures'] is None:
        return f'{head}, {record["when"]}: **failed** - {record["failure"]}\n\n{described}\n'
    made_with = _made_with(record)
    other = '' if made_with == usual else f', on {made_with}'
    how = f'{record["when"]}, {record["seconds"]:.0f} s{other}.'
    if section.name == 'peers':
        draw(record['figures'], folder / PICTURES)
        tables = [f'### {name}\n\n{body}\n' for name, body in sections(record['figures'])]
        body = '\n'.join([_PEERS, f'### In short\n\n{in_short(record["figures"])}\n', *tables])
    else:
        body = f'```text\n{section.table(record["figures"])}\n```\n'
    return f'{head}, {how}\n\n{described}\n\n{body}'


def _made_with(record: Mapping[str, Any]) -> str:
    named = ', '.join(f'{name} {version}' for name, version in record['versions'].items())
    return f'{record["machine"]}, with {named}'
