# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a section is at, said to those who wait."""

from __future__ import annotations

from collections.abc import Collection, Iterator
import sys
import time
from typing import TypeVar

MARK = '» '
_SELDOM = 0.5  # s between lines about a loop

Item = TypeVar('Item')


def report(text: str) -> None:
    """Say what is being done now."""
    print(f'{MARK}{text}', file=sys.stderr, flush=True)


def counted(items: Collection[Item], what: str) -> Iterator[Item]:
    """Go through `items` and say, now and then, how many are done."""
    said = -_SELDOM
    for count, item in enumerate(items):
        if time.monotonic() - said > _SELDOM:
            report(f'{what}: {count} of {len(items)}')
            said = time.monotonic()
        yield item
