# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled where numba is installed, plain Python where it is not.

Setting the environment variable TDM_DISABLE_NUMBA=1 makes the package run as if numba were absent.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from typing import Any, TypeVar

_Function = TypeVar('_Function', bound=Callable[..., Any])


def _numba() -> Any:
    if os.environ.get('TDM_DISABLE_NUMBA', '') not in ('', '0'):
        return None
    try:
        import numba
    except ImportError:
        return None
    return numba


COMPILED = _numba() is not None


def compiled(function: _Function) -> _Function:
    """Compile on the first call and keep the machine code on disk; the GIL is let go meanwhile."""
    numba = _numba()
    if numba is None:
        return function
    made: _Function = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    return made
