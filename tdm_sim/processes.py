# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes as processes: started, watched and ended together."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from tdm_planner.exceptions import TdmError
from tdm_planner.starting import uninterrupted

_GRACE = 30.0  # seconds a process gets to end on SIGINT before it is killed


class ProcessFailed(TdmError):
    """A process ended unexpectedly."""

    code = 'PROCESS_FAILED'


class NodeProcesses:
    """
    Python modules run as processes, each in a group of its own, output to ``FOLDER/NAME.log``.

    As a context manager it ends everything on leaving, in the reverse order of starting.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, module: str, arguments: Sequence[str]) -> None:
        """Run ``python -m MODULE ARGUMENTS`` under a name."""
        self.folder.mkdir(parents=True, exist_ok=True)
        mode = 'ab' if name in self._processes else 'wb'  # why it ended before is in the log
        # A signal between start and registration would leave the process running.
        with self._log(name).open(mode) as output, uninterrupted():
            self._processes[name] = subprocess.Popen(
                [sys.executable, '-m', module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def identifiers(self) -> dict[str, int]:
        """Process identifier by name."""
        return {name: process.pid for name, process in self._processes.items()}

    def check(self) -> None:
        """Raise ProcessFailed, with exit code and last line, if a process has ended by itself."""
        for name, code in self.ended().items():
            raise ProcessFailed(f'{name} ended with exit code {code}: {self.last_line(name)}')

    def ended(self) -> dict[str, int]:
        """Return the exit codes of the processes that have ended by themselves, by name."""
        codes = {name: process.poll() for name, process in self._processes.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def last_line(self, name: str) -> str:
        """Return the last line a process printed, and where its log is."""
        lines = self._log(name).read_text(errors='replace').strip().splitlines()
        return f'{lines[-1] if lines else "it printed nothing"} (see {self._log(name)})'

    def end(self) -> dict[str, int]:
        """Interrupt every process, wait, and return the exit codes by name."""
        codes: dict[str, int] = {}
        for process in reversed(self._processes.values()):
            _signal_group(process, signal.SIGINT)
        deadline = time.monotonic() + _GRACE
        for name, process in self._processes.items():
            try:
                codes[name] = process.wait(max(deadline - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                _signal_group(process, signal.SIGKILL)
                codes[name] = process.wait()
        self._processes.clear()
        return codes

    def _log(self, name: str) -> Path:
        return self.folder / f'{name}.log'

    def __enter__(self) -> NodeProcesses:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    if process.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
