# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Functions that numba compiles, where their machine code is kept, and threads that share them.

numba by itself keeps it by path and time stamp of a function's file: it compiles a copy, such as
`colcon build` makes, again, and does not notice a change in another file that is inlined. Here the
text of the sources counts, and the machine code lies in the Python environment (or below
NUMBA_CACHE_DIR): what `make setup` compiled serves every copy that runs there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
import os
import threading
from typing import Any, TypeVar

import numba
from numba.core import event
from numba.core.caching import IndexDataCacheFile
from numba.extending import register_jitable
import numpy as np
from tdm_planner.plants.slopes import DIGEST, FOLDER

_Function = TypeVar('_Function', bound=Callable[..., Any])

_NICE = 5  # of the threads that help
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


def report_compilation(tell: Callable[[str], object]) -> None:
    """Have `tell` called with a sentence, once, as soon as this process must compile a kernel."""
    register: Any = event.register  # typed in some versions only
    register('numba:compile', _Compilations(tell))


def compiled(function: _Function) -> _Function:
    """Compile on the first call and keep the machine code on disk; the GIL is let go meanwhile."""
    made: Any = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    cache = made._cache
    folder = FOLDER if os.access(FOLDER, os.R_OK | os.X_OK) else cache.cache_path
    index: Any = IndexDataCacheFile  # typed in some versions only
    cache._cache_file = index(str(folder), cache._impl.filename_base, DIGEST)
    if not os.access(folder, os.W_OK):  # another user has set the environment up
        cache.save_overload = lambda signature, data: None
    typed: _Function = made
    return typed


def inlined(function: _Function) -> _Function:
    """Let compiled functions call this one, as part of themselves; called itself it is Python."""
    made: _Function = register_jitable(error_model='numpy', forceinline=True)(function)
    return made


def sum_in_threads(work: Callable[[int], int], pieces: Sequence[int]) -> int:
    """
    Sum what `work` returns for each of the pieces, which all cores take in turn.

    The threads that help are of lower priority, so that the control loop goes first.
    """
    left = iter(pieces)

    def some() -> int:
        return sum(map(work, left))

    helpers = min(len(os.sched_getaffinity(0)), len(pieces)) - 1
    if helpers <= 0:
        return some()
    with ThreadPoolExecutor(helpers, initializer=_give_way) as pool:
        others = [pool.submit(some) for _ in range(helpers)]
        return some() + sum(other.result() for other in others)


def _give_way() -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)


@compiled
def sine_and_cosine(angle: float) -> tuple[float, float]:
    """
    Both to the last bit or nearly, up to some 1e6 rad, without a branch.

    The angle less the nearest multiple of pi / 2, itself in three parts (Cody and Waite), then
    the polynomials of fdlibm's kernels.
    """
    quarters = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - quarters * 1.57079632673412561417
    x -= quarters * 6.07710050630396597660e-11
    x -= quarters * 2.02226624879595063154e-21
    z = x * x
    s = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155e-10)
    s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * s)
    s = x + x * z * (-1.66666666666666324348e-01 + z * s)
    c = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.135964755778819e-11)
    c = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * c)
    c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * c)
    half = 0.5 * quarters
    odd = half > np.floor(half)
    quarter = 0.5 * np.floor(half)
    sign = 1.0 - 4.0 * (quarter - np.floor(quarter))
    return sign * (c if odd else s), sign * (-s if odd else c)
