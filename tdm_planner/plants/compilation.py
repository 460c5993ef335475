# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Functions that numba compiles, and where their machine code is kept.

numba by itself keeps it by path and time stamp of a function's file: it compiles a copy, such as
`colcon build` makes, again, and does not notice a change in another file that is inlined. Here the
text of the sources counts, and the machine code lies in the Python environment (or below
NUMBA_CACHE_DIR): what `make setup` compiled serves every copy that runs there.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from typing import Any, TypeVar

import numba
from numba.core import event
from numba.core.caching import IndexDataCacheFile
from numba.extending import register_jitable
from tdm_planner.plants.slopes import DIGEST, FOLDER

_Function = TypeVar('_Function', bound=Callable[..., Any])

COMPILING = (
    "compiling kernels, once: this may take a minute; 'python3 -m tdm_planner.set_up' does it "
    'beforehand'
)


class _Compilations(event.Listener):
    """Tells of the first compilation; a kernel that is loaded from the disk is none."""

    def __init__(self, tell: Callable[[str], object]) -> None:
        self._tell: Callable[[str], object] | None = tell

    def on_start(self, event: Any) -> None:
        if self._tell is not None:
            tell, self._tell = self._tell, None
            tell(COMPILING)

    def on_end(self, event: Any) -> None:
        """Say nothing."""


def tell_of_compilation(tell: Callable[[str], object]) -> None:
    """Have `tell` called with a sentence, once, as soon as this process must compile a kernel."""
    register: Any = event.register  # typed in some versions only
    register('numba:compile', _Compilations(tell))


def _keep_in_memory(signature: Any, data: Any) -> None:
    """Save nothing: the folder can only be read."""


def compiled(function: _Function) -> _Function:
    """Compile on the first call and keep the machine code on disk; the GIL is let go meanwhile."""
    made: Any = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    cache = made._cache
    folder = FOLDER if os.access(FOLDER, os.R_OK | os.X_OK) else cache.cache_path
    index: Any = IndexDataCacheFile  # typed in some versions only
    cache._cache_file = index(str(folder), cache._impl.filename_base, DIGEST)
    if not os.access(folder, os.W_OK):  # another user has set the environment up
        cache.save_overload = _keep_in_memory
    typed: _Function = made
    return typed


def inlined(function: _Function) -> _Function:
    """Let compiled functions call this one, as part of themselves; called itself it is Python."""
    made: _Function = register_jitable(error_model='numpy', forceinline=True)(function)
    return made
