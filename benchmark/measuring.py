# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What sections share: they say what they are at, and time the solving of problems."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
import sys
import time
from typing import Any, NamedTuple, TYPE_CHECKING, TypeVar

from tdm_planner.exceptions import TdmError

if TYPE_CHECKING:  # who watches a section needs neither
    from tdm_planner.problems.problem import Problem
    from tdm_planner.problems.solution import Solution

MARK = '» '
_SELDOM = 0.5  # s between lines about a loop

Item = TypeVar('Item')


def report(text: str) -> None:
    """Say what is being done now."""
    print(f'{MARK}{text}', file=sys.stderr, flush=True)


def counted(items: Collection[Item], what: str) -> Iterator[Item]:
    """Go through `items` and say, now and then, how many are done."""
    said = -_SELDOM
    for count, item in enumerate(items):
        if time.monotonic() - said > _SELDOM:
            report(f'{what}: {count} of {len(items)}')
            said = time.monotonic()
        yield item


def resident(process: int | str = 'self') -> float:
    """Return the resident memory of a process, by default of this one [MB]."""
    status = Path(f'/proc/{process}/status').read_text()
    fields = dict(line.split(':', 1) for line in status.splitlines())
    return float(fields['VmRSS'].split()[0]) / 1024


class Timed(NamedTuple):
    """A plan, or why there is none; wall and processor time [s] that solving took."""

    plan: Solution | None
    error: TdmError | None
    wall: float
    processor: float


def timed(problem: Problem, *given: Any, **how: Any) -> Timed:
    """Solve a problem; further arguments are those of `solve`."""
    plan, error = None, None
    wall, processor = time.perf_counter(), time.process_time()
    try:
        plan = problem.solve(*given, **how)
    except TdmError as failure:
        error = failure
    return Timed(plan, error, time.perf_counter() - wall, time.process_time() - processor)
