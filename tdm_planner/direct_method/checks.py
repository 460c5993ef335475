# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Checks of what users pass in, and what to write instead of what went wrong in a function."""

from __future__ import annotations

from importlib.util import find_spec
import inspect
import linecache
from pathlib import Path
import traceback
from typing import Any

import numpy as np
from tdm_planner.exceptions import InvalidProblem

_LARGEST = 1e100  # its cube can still be computed
_HINTS = {
    'math.': "use numpy's functions, such as np.sqrt(x)",
    'float(': 'leave the conversion to float out',
    'if ': 'use np.where(condition, this, that) in place of `if` on a value',
    ' and ': 'use np.logical_and(...) in place of `and` on values',
    ' or ': 'use np.logical_or(...) in place of `or` on values',
    ' & ': 'use np.logical_and(...) in place of & on values',
    ' | ': 'use np.logical_or(...) in place of | on values',
    'min(': 'use np.minimum and np.maximum',
    'max(': 'use np.minimum and np.maximum',
    'np.linalg': 'write the formula by components',
    'pline': 'use a formula in place of a spline',
    'mean(': 'write what holds at one node: there are no sums over nodes',
    'sum(': 'write what holds at one node: there are no sums over nodes',
}
_SPECS = [find_spec(name) for name in ('casadi', 'numpy', __name__)]
_LIBRARIES = tuple(f'{Path(spec.origin).parent}/' for spec in _SPECS if spec and spec.origin)
_HINT = "use numpy's functions of single values (np.sqrt, np.arctan2, np.where, np.maximum)"


def shown(value: Any, longest: int = 60) -> str:
    """Return a value as an error message shows it: on one line, not too long."""
    text = ' '.join(repr(value).split())
    return text if len(text) <= longest else text[: longest - 3] + '...'


def number(value: Any, what: str, *, positive: bool = False) -> float:
    """Return a finite (or `positive`) number; if it is none, InvalidProblem names `what`."""
    allowed = 'a positive number' if positive else 'a finite number'
    try:
        found = float(value) if np.ndim(value) == 0 and not isinstance(value, str) else np.nan
    except (TypeError, ValueError, OverflowError):
        found = np.nan
    if not abs(found) <= _LARGEST or (positive and found <= 0):
        raise InvalidProblem(f'{what} = {shown(value)} is not allowed: must be {allowed}')
    return found


def whole(value: Any, what: str, least: int, most: int) -> int:
    """Return an integer in [least, most]; if it is none, InvalidProblem names `what`."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (is_whole and least <= value <= most):
        raise InvalidProblem(
            f'{what} = {shown(value)} is not allowed: must be an integer from {least} to {most}'
        )
    return int(value)


def told(formulation: Any, function: str, error: Exception, traced: bool = False) -> str:
    """
    Return the sentence that says which line of the user's source raises what.

    In place of that it says what to write, where it is known; if the line is `traced`, always.
    """
    where, source = '', ''
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if not frame.filename.startswith(_LIBRARIES):
            source = linecache.getline(frame.filename, frame.lineno or 0).strip() or frame.name
            where = f' in line {frame.lineno} of {frame.filename.rsplit("/", 1)[-1]}, `{source}`'
            break
    known = traced or isinstance(error, TypeError | ValueError)  # what numpy's arrays raise
    hint = next((hint for word, hint in _HINTS.items() if known and word in source), None)
    what = 'cannot be traced' if traced else f'raises {type(error).__name__}'
    hint = hint or (_HINT if traced else ' '.join(str(error).split()))
    return f'{function} of {type(formulation).__name__} {what}{where}: {hint}'


def suspect(formulation: Any, function: str) -> str:
    """Return what may be the cause, from words in the function's source."""
    try:
        lines, first = inspect.getsourcelines(getattr(type(formulation), function))
    except (OSError, TypeError):
        return _HINT
    words = {w: h for w, h in _HINTS.items() if w not in ('if ', ' and ', ' or ')}
    for number, line in enumerate(lines):
        hint = next((hint for word, hint in words.items() if word in line), None)
        if hint:
            return f'line {first + number}, `{line.strip()}`: {hint}'
    return 'it must depend on its arguments at the same node alone'
