# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Functions that numba compiles; their machine code is kept on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import event

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


def compiled(function: _Function) -> _Function:
    """Compile on the first call and keep the machine code on disk; the GIL is let go meanwhile."""
    return compiled_with()(function)


def compiled_with(*called: Any) -> Callable[[_Function], _Function]:
    """
    Compile a function that calls compiled functions of other modules, `called`.

    What they do becomes part of its machine code. numba's cache on disk takes notice of changes to
    the function's own file only; theirs are made known to it here.
    """

    def decorate(function: _Function) -> _Function:
        made: Any = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
        stamps = [_cache_file(other)._source_stamp for other in called if _cache_file(other)]
        if stamps and _cache_file(made):
            _cache_file(made)._source_stamp = (_cache_file(made)._source_stamp, *stamps)
        typed: _Function = made
        return typed

    return decorate


def _cache_file(function: Any) -> Any:
    """Return what numba's cache knows of a function, None in a version that keeps it elsewhere."""
    return getattr(getattr(function, '_cache', None), '_cache_file', None)
