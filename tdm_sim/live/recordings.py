# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings started and stopped on the page, and reports on them."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys
import time

from tdm_planner.exceptions import TdmError
from tdm_sim.processes import NodeProcesses
from tdm_sim.record_command import RECORDING

_LOOK = 0.05  # s between looks whether a recording has begun
_PATIENCE = 15.0  # s that the first message may take


class RecordingFailed(TdmError):
    """`tdm record` failed; the message is what it printed last."""

    code = 'RECORDING_FAILED'


class ReportFailed(TdmError):
    """`tdm report` failed; the message is what it printed."""

    code = 'REPORT_FAILED'


class Recordings:
    """Bags of a namespace in a folder, each recorded by a `tdm record` of its own."""

    def __init__(self, folder: Path, namespace: str) -> None:
        self._folder, self._namespace = folder, namespace
        self._recorder = NodeProcesses(folder / 'log')
        self._number = 0
        self.last: Path | None = None

    @property
    def running(self) -> bool:
        """Whether a recording is being made."""
        return bool(self._recorder.identifiers)

    def start(self) -> Path:
        """
        Begin a recording; returns its folder once the first message is written.

        Raise RecordingFailed if the recorder ends instead, or no message comes.
        """
        while (bag := self._folder / f'recording_{self._number + 1}').exists():
            self._number += 1
        words = ['record', '-o', str(bag), '--namespace', self._namespace]
        self._recorder.start('recorder', 'tdm_planner.cli', words)
        latest = time.monotonic() + _PATIENCE
        while RECORDING not in self._recorder.last_line('recorder'):
            late = time.monotonic() > latest
            if late or self._recorder.ended():
                self._recorder.end()
                silent = f'no message has come in {self._namespace} within {_PATIENCE:g} s'
                raise RecordingFailed(silent if late else self._recorder.last_line('recorder'))
            time.sleep(_LOOK)
        self.last = bag
        return bag

    def stop(self) -> None:
        """
        End the recording.

        Raise RecordingFailed if it is not complete.
        """
        if any(self._recorder.end().values()):
            raise RecordingFailed(self._recorder.last_line('recorder'))

    def report(self, problem: str) -> Path:
        """
        Make a report on the last recording, which ends if it has not.

        `problem` is the planner's. Reports load no class that only a recording names.

        Raise ReportFailed if there is none, or nothing can be told of it.
        """
        if self.last is None:
            raise ReportFailed('nothing was recorded yet')
        if self.running:
            self.stop()
        file = self.last.with_suffix('.html')
        words = ['report', str(self.last), '-o', str(file), '--namespace', self._namespace, '-q']
        if ':' in problem:
            words += ['--problem', problem]
        done = subprocess.run(
            [sys.executable, '-m', 'tdm_planner.cli', *words], capture_output=True, text=True
        )
        if done.returncode:
            raise ReportFailed(done.stderr.strip() or f'tdm report ended with {done.returncode}')
        return file
