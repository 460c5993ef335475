# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Sections in processes of their own: one that fails, crashes or hangs takes no other with it.

Such a process is ``python -m benchmark.runner NAME SETTINGS OUTPUT``: SETTINGS is JSON, OUTPUT the
JSON file that the figures are written to.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

from benchmark.measuring import MARK
from benchmark.sections import Section, SECTIONS, Settings

ROOT = Path(__file__).parents[1]
_LINES_KEPT = 200  # lines of what a section says


@dataclass(frozen=True)
class Outcome:
    """What came of a section: `figures`, or else the `failure`, one sentence, and its `log`."""

    settings: Settings
    when: str
    seconds: float
    figures: dict[str, Any] | None = None
    failure: str = ''
    log: tuple[str, ...] = field(default=(), repr=False)


def run(section: Section, settings: Settings, report: Callable[[str], None]) -> Outcome:
    """Measure a section; `report` is told what it is at."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / 'figures.json'
        command = [
            sys.executable, '-m', 'benchmark.runner',
            section.name, json.dumps(dict(settings), default=str), str(output),
        ]  # fmt: skip
        failure, log = _watched(command, section.limit, report)
        figures = json.loads(output.read_text()) if not failure else None
    return Outcome(
        settings=settings,
        when=datetime.now(timezone.utc).date().isoformat(),
        seconds=time.monotonic() - began,
        figures=figures,
        failure=failure,
        log=log,
    )


def _watched(
    command: list[str], limit: float, report: Callable[[str], None]
) -> tuple[str, tuple[str, ...]]:
    """Run a command; returns why it failed, '' if it did not, and what it said."""
    log: deque[str] = deque(maxlen=_LINES_KEPT)
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors='replace',
        start_new_session=True,  # so that all that it starts can be ended with it
    )
    reader = threading.Thread(target=_read, args=(process, log, report), daemon=True)
    reader.start()
    try:
        code = process.wait(limit)
    except subprocess.TimeoutExpired:
        return f'it took longer than {limit:g} s and was ended', tuple(log)
    finally:
        _end(process)
        reader.join(5.0)
    if code == 0:
        return '', tuple(log)
    if code < 0:
        return f'it was ended by {signal.Signals(-code).name}', tuple(log)
    return next((line.strip() for line in reversed(log) if line.strip()), ''), tuple(log)


def _read(process: subprocess.Popen[str], log: deque[str], report: Callable[[str], None]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(MARK):
            report(line.removeprefix(MARK).rstrip())
        else:
            log.append(line.rstrip())


def _end(process: subprocess.Popen[str]) -> None:
    """End the process and all that it has started."""
    for number in (signal.SIGINT, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(5.0)


def main(name: str, settings: str, output: str) -> None:
    """Measure a section in this process and write its figures."""
    figures = SECTIONS[name].run(**json.loads(settings))
    Path(output).write_text(json.dumps(figures, default=float) + '\n')


if __name__ == '__main__':
    main(*sys.argv[1:])
