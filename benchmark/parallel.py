# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Runs that do not depend on each other, on two cores; only where no time is measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
import multiprocessing
import os
from typing import TypeVar

from benchmark.progress import counted

Argument = TypeVar('Argument')
Result = TypeVar('Result')

_PROCESSES = 2


def each(
    work: Callable[[Argument], Result], arguments: Sequence[Argument], what: str
) -> list[Result]:
    """Return what `work` (a function of a module) makes of every argument, in their order."""
    processes = min(_PROCESSES, os.cpu_count() or 1, len(arguments))
    if processes < 2:
        return [work(argument) for argument in counted(arguments, what)]
    # Threads of the parent (of compiled code, of BLAS) would not survive a fork.
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures = [pool.submit(work, argument) for argument in arguments]
        return [future.result() for future in counted(futures, what)]
