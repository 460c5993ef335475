# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Progress of a command: a live line on a terminal, plain lines when piped, or nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import io
import sys
import time

from tdm_planner.plan_files import UnusableFile


@contextmanager
def printing() -> Iterator[None]:
    """
    Raise UnusableFile where standard output cannot be written; nothing is written any more.

    Where it is not read any more, as behind ``| head``, the rest of the block is skipped silently.
    """
    try:
        yield
    except (OSError, SystemExit) as error:
        # rich makes a SystemExit of a pipe that is closed
        fault = error.__context__ if isinstance(error, SystemExit) else error
        if not isinstance(fault, OSError) or fault.filename is not None:
            raise  # of a file that a statement reads
        sys.stdout = io.StringIO()  # what is left would be tried again as the process ends
        if not isinstance(fault, BrokenPipeError):
            raise UnusableFile(f'standard output cannot be written: {fault.strerror}') from None


class Progress:
    """
    Lines that stay, one for every part of the work; none when quiet. A context manager.

    On a terminal (`live`) there is a line below them, with the time of the present part.
    """

    def __init__(self, quiet: bool = False) -> None:
        # Here, as every command loads this module: rich takes 60 ms.
        from rich.console import Console
        from rich.progress import Progress as Bars
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

        self.live = not quiet and sys.stdout is not None and sys.stdout.isatty()
        self._started = time.monotonic()
        self._console = Console(highlight=False, emoji=False, quiet=quiet)
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
        self.line(f'[{time.monotonic() - self._started:5.1f} s] {text}')
        self._bars.reset(self._task, description=text)

    def line(self, text: str) -> None:
        """Print a line that stays."""
        with printing():
            self._console.print(text, markup=False, soft_wrap=True)

    def update(self, text: str) -> None:
        """Replace the live line."""
        self._bars.update(self._task, description=text)

    def __enter__(self) -> Progress:
        if self.live:
            self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.live:
            self._bars.stop()
