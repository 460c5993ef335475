# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A live line on a terminal, plain lines when piped, nothing when quiet."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.status import Status


class Progress:
    """Tell how far a long piece of work has come; a context manager."""

    def __init__(self, quiet: bool = False) -> None:
        self.console = Console(quiet=quiet, highlight=False)
        self._status: Status | None = None
        self._started = time.monotonic()
        if self.console.is_terminal and not quiet:
            self._status = self.console.status('')

    def phase(self, text: str) -> None:
        """Begin another part of the work."""
        elapsed = time.monotonic() - self._started
        self.console.print(f'[{elapsed:5.1f} s] {text}', markup=False, soft_wrap=True)

    def update(self, text: str) -> None:
        """Replace the live line; not shown when piped."""
        if self._status is not None:
            self._status.update(text)

    def __enter__(self) -> Progress:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._status is not None:
            self._status.stop()
