# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Docstrings and signatures are written to be read as they are; here they become pages.

Bars, asterisks and trailing underscores mean themselves; an indented paragraph, which is a formula
or an example, is shown as it stands.
"""

from __future__ import annotations

import re
from typing import Any

_CODE = re.compile(r'(``.+?``|`[^`\n]+`)')
_SPECIAL = re.compile(r'([|*]|(?<=\w)_(?=[^\w]|$))')


def to_restructured_text(lines: list[str]) -> list[str]:
    """Return a docstring's lines with what is special to reStructuredText taken as it stands."""
    made: list[str] = []
    literal = False
    for number, line in enumerate(lines):
        indented = line.startswith('    ')
        if indented and not literal and not (made and made[-1].strip()) and number:
            literal = True
            made += ['::', '']
        elif line.strip() and not indented:
            literal = False
        made.append(line if literal else escaped(line))
    return made


def escaped(line: str) -> str:
    """Return a line whose special characters, outside of backquotes, are escaped."""
    parts = _CODE.split(line)
    parts[::2] = [_SPECIAL.sub(r'\\\1', part) for part in parts[::2]]
    return ''.join(parts)


def process(_: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Change a docstring in place, before its sections are read."""
    lines[:] = to_restructured_text(lines)


def shorten(
    _: Any,
    what: str,
    name: str,
    value: Any,
    options: Any,
    arguments: str | None,
    result: str | None,
) -> tuple[str | None, str | None]:
    """Write types in signatures by their last names, arrays as such."""

    def short(text: str | None) -> str | None:
        if text is None or 'numpy' not in text:
            return text
        text = re.sub(r'~?\b(?:[a-z_]\w*\.)+(\w+)', r'\1', text)
        return re.sub(r'ndarray\[tuple\[Any, \.\.\.\], dtype\[\w+\]\]', 'Array', text)

    return short(arguments), short(result)


def setup(app: Any) -> dict[str, Any]:
    """Let docstrings pass through `process` before napoleon sees them."""
    app.connect('autodoc-process-docstring', process, priority=100)
    app.connect('autodoc-process-signature', shorten)
    return {'version': '1', 'parallel_read_safe': True, 'parallel_write_safe': True}
