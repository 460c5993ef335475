# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/benchmarks.md and its pictures, from the figures of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime, timezone
import os
from pathlib import Path
import platform
import shutil
from typing import Any

from benchmark.peers.tables import in_short, sections

DOCS = Path(__file__).parents[1] / 'docs'
Tables = Mapping[str, Callable[[dict[str, Any]], str]]

_INTRODUCTION = """\
# Benchmarks

Written by `make benchmark` from the figures of its run. {when}, {machine}.

{versions}

Compare ratios: absolute times are those of this machine while it may have had other work.
"""

_PEERS = """\
## Peers

The same problems, solved in one process on one core by this package and by what users would reach
for otherwise, case by case in turn (`python -m benchmark peers --cases {cases}`). Times are
processor times.

- **tdm_planner**: `solve()` as the planner node calls it, with its own check of the plan.
  Iterations are evaluations of the dynamics along a candidate.
- **collocation**: Hermite-Simpson with exact first and second derivatives, CasADi and Ipopt with
  MUMPS. Variables are scaled, expressions expanded to scalars and built once; only Ipopt's own
  time is counted, not that of building, guessing or checking. Barrier strategy, tolerances and
  guesses were chosen for the most and quickest solutions.
  First guesses of the swing-up: the straight line to upright; a simulated swing under energy
  control (Astrom and Furuta 2000), full or slow. Of the robots: straight ways with a quintic law
  of time, or all bowed to one side. *Best of 3* tries all three.
- **warm**: from the plan of a neighbouring state (up to .05 rad and .25 rad/s, or 5 cm for every
  robot away). Collocation starts from its own optimum there, with its multipliers.
- **Drake**: its `MultibodyPlant` and `DirectCollocation` with SNOPT, the first {drake} cases.

Every solution is flown: its controls, linear or held between nodes as its author says, drive the
true equations of motion (DOP853, or exact quadrature for the robots). *Solved* means that this
flight ends within .05 rad and .5 rad/s of upright, or within 2 cm, .01 m/s, .05 rad and .02 rad/s
of every robot's goal, with limits kept (disk within .01 rad, distances within 1 cm). Plans of this
package pass a stricter check besides: 1e-4 rad and 1e-3 rad/s; 3.5 mm. *Within 1.02* is the share
of all cases solved at no more than 1.02 times the best known cost, which a long search and
collocation from its result gave (`benchmark/*_reference.py`).

![Share of cases solved near the best known cost within a time](images/benchmark_success.png)
"""

_PROFILE = """\
Shares are of processor time, of all threads together; a function's share holds all it calls. The
largest costs, and why they remain:

- *Polishing* (`switching_search.polish`), the largest part of a cold swing-up: up to ten arrivals
  are minimised, each in some ten steps on four to eight variables. The motions are compiled; what
  is left is numpy called on tiny arrays. Polishing four instead of ten took 15 % less time, and
  97 and 91 instead of 99 and 97 of 100 swing-ups came within 1.02 of the best known time.
- *Steering* (`pendulum_rollout.steer`), the second: 300 random starts in compiled threads. On two
  free cores it takes half as long by the clock as it counts here. With an earlier plan to start
  from there is none: that plan is polished and checked first.
- *Linearising* the robots' rows (`formation_program.linearise`), the largest part of a cold
  formation, is one pass over precomputed bases for all robots, nodes and pairs, from four first
  guesses; a warm one has one guess, and mostly pays for the thrusters' directions
  (`formation_plan.trajectory`) and the check of the plan (`verify_formation`).
"""


def write(figures: Mapping[str, Any], tables: Tables, folder: Path = DOCS) -> Path:
    """Write the page and its pictures; parts that were not run are left out."""
    parts = [_introduction(figures)]
    if 'peers' in figures:
        from benchmark.peers.charts import draw
        from benchmark.peers.pendulum_cases import DRAKE_CASES

        draw(figures['peers'], folder / 'images')
        parts.append(
            _PEERS.format(
                cases=figures['peers']['cases'],
                drake=min(DRAKE_CASES, figures['peers']['cases']),
            )
        )
        parts.append(f'### In short\n\n{in_short(figures["peers"])}\n')
        parts += [f'### {name}\n\n{body}\n' for name, body in sections(figures['peers'])]
        growth = 'Time over intervals, cost over varied parameters, time over robots'
        parts.append(f'![{growth}](images/benchmark_growth.png)\n')
    for name, table in tables.items():
        if name in figures and name != 'peers':
            heading = name.replace('_', ' ').capitalize()
            command = f'`python -m benchmark {name}`'
            parts.append(f'## {heading}\n\n{command}\n\n```text\n{table(figures[name])}\n```\n')
        if name in figures and name == 'profile':
            parts.append(_flames(figures[name], folder / 'images'))
    page = folder / 'benchmarks.md'
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text('\n'.join(parts))
    return page


def _flames(figures: Mapping[str, Any], images: Path) -> str:
    """Return what the profile says, with the flame graphs, which are copied to `images`."""
    lines = [_PROFILE]
    for title, found in figures.items():
        picture = Path(found['picture'])
        if picture.is_file():
            images.mkdir(parents=True, exist_ok=True)
            shutil.copy(picture, images / picture.name)
            lines.append(f'![Flame graph: {title}](images/{picture.name})\n')
    return '\n'.join(lines)


def _introduction(figures: Mapping[str, Any]) -> str:
    versions = figures.get('peers', {}).get('versions', {})
    named = ', '.join(f'{name} {version}' for name, version in versions.items())
    when = figures.get('when') or datetime.now(timezone.utc).date().isoformat()
    return _INTRODUCTION.format(
        when=when,
        machine=figures.get('machine') or machine(),
        versions=f'Versions: {named}.' if named else '',
    )


def machine() -> str:
    """Processor, cores and Python."""
    name = platform.processor() or platform.machine()
    cpu = Path('/proc/cpuinfo')
    if cpu.is_file():
        models = [line for line in cpu.read_text().splitlines() if line.startswith('model name')]
        name = models[0].split(':')[1].strip() if models else name
    return f'{name}, {os.cpu_count()} cores, Python {platform.python_version()}'
