# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a user's function raises, in one sentence that says what to write instead."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
import inspect
import re
import traceback
from typing import Any

from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.exceptions import one_line, place_of
from tdm_planner.parameters import suggestion, Validated

HINTS = {
    'math.': "use numpy's functions, such as np.sqrt(x)",
    'float(': 'leave the conversion to float out',
    'if ': 'use np.where(condition, this, that) in place of `if` on a value',
    ' and ': 'use np.logical_and(...) in place of `and` on values',
    ' or ': 'use np.logical_or(...) in place of `or` on values',
    ' & ': 'use np.logical_and(...) in place of & on values',
    ' | ': 'use np.logical_or(...) in place of | on values',
    **dict.fromkeys(('min(', 'max('), 'use np.minimum and np.maximum'),
    **dict.fromkeys(('np.linalg', 'dot(', ' @ '), 'write the formula by components'),
    'period=': 'give np.interp x % period and a table with both ends, in place of period',
    'pline': 'use np.interp or a polynomial in place of a spline',
    'astype(': 'leave astype out',
    **dict.fromkeys(('zeros(', '] = '), 'return the components, such as (x[1], u[0])'),
    **dict.fromkeys(
        ('mean(', 'sum('), 'write what holds at one node: there are no sums over nodes'
    ),
}
ARGUMENTS = {  # of every function that is traced, but for the numbers
    'invert': 'yz',
    'derivative': 'xu',
    'margins': 'txu',
    'running_cost': 'txu',
    'final_cost': 'tx',
    'start_conditions': 'tx',
    'end_conditions': 'tx',
}
HINT = "use numpy's functions of single values (np.sqrt, np.arctan2, np.where, np.maximum)"
_OWN = Formulation, Validated  # classes of users, and groups of their parameters
_INTERPOLATION = 'scipy/interpolate'  # in the paths of what draws splines


def told(formulation: Any, function: str, error: Exception, traced: bool = False) -> str:
    """
    Return the sentence that says which line of the user's source raises what.

    In place of that it says what to write, where it is known; if the line is `traced`, always.
    """
    where, source = place_of(error)
    if _INTERPOLATION in traceback.extract_tb(error.__traceback__)[-1].filename:
        source += 'spline'
    # What numpy's arrays raise; a `__post_init__` has none, and words of its own.
    arrays = isinstance(error, TypeError | ValueError) and function != '__post_init__'
    known = HINTS.items() if traced or arrays else ()
    hint = next((hint for word, hint in known if word in source), None)
    owner = getattr(error, 'obj', None)
    if traced and isinstance(error, AttributeError) and isinstance(owner, _OWN):
        # Without symbols it was there.
        hint = f"'{error.name}' follows from parameters: state it as a property"
    what = 'cannot be traced' if traced else f'raises {type(error).__name__}'
    hint = hint or (HINT if traced else _usage(function, error, source) or one_line(error))
    return f'{function} of {type(formulation).__name__} {what}{where}: {hint}'


def suspect(formulation: Any, function: str) -> str:
    """Return what may be why a trace is wrong, from words in the function's source, or ''."""
    try:
        lines, first = inspect.getsourcelines(getattr(type(formulation), function))
    except (OSError, TypeError):
        return HINT
    words = {w: h for w, h in HINTS.items() if w not in ('if ', ' and ', ' or ')}
    for number, line in enumerate(lines, first):
        if hint := next((hint for word, hint in words.items() if word in line), None):
            return f'line {number}, `{line.strip()}`: {hint}'
    return ''


def _usage(function: str, error: Exception, source: str) -> str:
    """Say how a function is called, and with what; '' where that is not what is wrong."""
    if isinstance(error, FrozenInstanceError):
        return 'a problem is frozen: state what follows from its parameters as a property'
    if isinstance(error, AttributeError) and isinstance(error.obj, _OWN):
        question = suggestion(error.name or '', dir(error.obj))
        return f"{type(error.obj).__name__} has no '{error.name}'{question and ': ' + question}"
    if function not in ARGUMENTS:
        return ''
    if isinstance(error, TypeError) and not source:
        return f'{one_line(error)}: it is called as {function}({", ".join(ARGUMENTS[function])})'
    key = re.escape(str(error.args[0])) if isinstance(error, KeyError) else ''
    owner = re.search(rf"""(\w*)\W*\[['"]{key}['"]\]""", source)  # of another table
    if key and function == 'invert' and (owner is None or owner[1] in ('y', 'z')):
        return f'{error} is in neither outputs() nor integrated()'
    unlike = isinstance(error, IndexError) or 'values to unpack' in str(error)
    if unlike and function == 'invert':
        return "y['x'] holds x and as many derivatives as Output(derivatives=2) says: 3 arrays"
    if isinstance(error, IndexError | AttributeError):
        return 'x and u are sequences in the order of the names, x[0] the first state'
    return ''
