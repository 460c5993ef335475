# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Values out of files and messages that anybody may have written: checked, cleaned, bounded."""

from __future__ import annotations

from collections.abc import Mapping
import itertools
import math
from typing import Any

LONGEST_TEXT = 500
MOST_ENTRIES = 2000


def text(value: object, longest: int = LONGEST_TEXT) -> str:
    """Return a string on one line, without control characters, not overlong; '' if it is none."""
    if not isinstance(value, str):
        return ''
    start = value[: 4 * longest]
    line = ' '.join(''.join(c if c.isprintable() else ' ' for c in start).split())
    return line if len(line) <= longest and len(start) == len(value) else line[:longest] + '...'


def number(value: object) -> float | None:
    """Return a finite number; None if it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None


def mapping(value: object) -> dict[str, Any]:
    """Return a mapping with clean names; empty if it is none."""
    if not isinstance(value, Mapping):
        return {}
    return {text(str(k), 200): v for k, v in itertools.islice(value.items(), MOST_ENTRIES)}


def numbers(value: object) -> dict[str, float]:
    """Return the finite numbers of a mapping, by name."""
    found = {name: number(item) for name, item in mapping(value).items()}
    return {name: item for name, item in found.items() if item is not None}


def parameters(value: object) -> dict[str, object]:
    """Return a mapping's values that a parameter may have: scalars and flat lists of them."""
    return {
        name: [*map(_scalar, item[:MOST_ENTRIES])] if isinstance(item, list) else _scalar(item)
        for name, item in mapping(value).items()
    }


def _scalar(value: object) -> object:
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int):
        return value if number(value) is not None else None
    return text(value) if isinstance(value, str) else number(value)
