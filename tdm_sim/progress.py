# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Progress of a command: a live line on a terminal, plain lines when piped, or nothing."""

from __future__ import annotations

import sys
import time
from types import TracebackType


class Progress:
    """
    Plain lines, one for every part of the work; none when quiet. A context manager.

    `live`: whether `update` is seen.
    """

    live = False

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self._started = time.monotonic()

    def phase(self, text: str) -> None:
        """Begin another part of the work."""
        self.line(f'[{time.monotonic() - self._started:5.1f} s] {text}')

    def line(self, text: str) -> None:
        """Print a line that stays."""
        if not self.quiet:
            print(text, flush=True)

    def update(self, text: str) -> None:
        """Replace the live line; not shown when piped."""

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End the live line."""


class LiveProgress(Progress):
    """Lines that stay, and below them a live one with the time of the present part."""

    live = True

    def __init__(self) -> None:
        super().__init__()
        from rich.console import Console
        from rich.progress import Progress as Bars
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

        self._console = Console(highlight=False)
        self._bars = Bars(
            SpinnerColumn(),
            TextColumn('{task.description}', markup=False),
            TimeElapsedColumn(),
            console=self._console,
            transient=True,
        )
        self._task = self._bars.add_task('')

    def phase(self, text: str) -> None:
        """Begin another part of the work."""
        super().phase(text)
        self._bars.reset(self._task, description=text)

    def line(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(text, markup=False, soft_wrap=True)

    def update(self, text: str) -> None:
        """Replace the live line."""
        self._bars.update(self._task, description=text)

    def __enter__(self) -> Progress:
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._bars.stop()


def make_progress(quiet: bool = False) -> Progress:
    """Return the kind of progress that suits the command's output."""
    return LiveProgress() if not quiet and sys.stdout.isatty() else Progress(quiet)
