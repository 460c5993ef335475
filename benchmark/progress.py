# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a section is at, said to those who wait, and runs of it on two cores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from concurrent.futures import ProcessPoolExecutor
import multiprocessing
import sys
import time
from typing import Protocol, TypeVar

MARK = '» '
_SELDOM = 0.5  # s between lines about a loop
_PROCESSES = 2

Item = TypeVar('Item', covariant=True)
Argument = TypeVar('Argument')
Result = TypeVar('Result')


class Items(Sized, Iterable[Item], Protocol[Item]):
    """Things that can be counted and gone through."""


def report(text: str) -> None:
    """Say what is being done now."""
    print(f'{MARK}{text}', file=sys.stderr, flush=True)


def counted(items: Items[Item], what: str) -> Iterator[Item]:
    """Go through `items` and say, now and then, how many are done."""
    said = -_SELDOM
    for count, item in enumerate(items):
        if time.monotonic() - said > _SELDOM:
            report(f'{what}: {count} of {len(items)}')
            said = time.monotonic()
        yield item


def each(
    work: Callable[[Argument], Result], arguments: Sequence[Argument], what: str
) -> list[Result]:
    """
    Return what `work` (a function of a module) makes of every argument, in their order.

    In processes of their own, two at a time: only where no time is measured.
    """
    # Threads of the parent (of compiled code, of BLAS) would not survive a fork.
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(_PROCESSES, mp_context=context) as pool:
        futures = [pool.submit(work, argument) for argument in arguments]
        return [future.result() for future in counted(futures, what)]
