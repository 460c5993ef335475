# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Formulas as MathML, which browsers show by themselves: no script, no font from elsewhere."""

from __future__ import annotations

from html import escape
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.errors import ExtensionError

# docutils takes more than one digit, and leaves no space about functions.
_SHORT_FRACTION = re.compile(r'\\[td]?frac\s*[^{\s]')
_BRACE = re.compile(r'\\[{}]')  # that is shown
_FUNCTION = re.compile(r'\\(sin|cos)(?![a-z])')
_ARGUMENT = re.compile(r'(\\(?:sin|cos)(?:\^.)?)\s*(?=[\\0-9a-z])')


def mathml(source: str, display: bool) -> str:
    """
    Return LaTeX as MathML.

    Raises
    ------
    ExtensionError
        Naming the formula, if it is not understood.

    """
    if _SHORT_FRACTION.search(source):
        raise ExtensionError(f'write the fraction with braces: {source}')
    if _BRACE.sub('', source).count('{') != _BRACE.sub('', source).count('}'):
        raise ExtensionError(f'braces do not match: {source}')
    spaced = _FUNCTION.sub(r'\\,\g<0>', source)
    spaced = _ARGUMENT.sub(r'\1\\,', spaced)
    try:
        made = str(latex2mathml.tex2mathml(spaced, as_block=display))
    except Exception as error:  # noqa: B902
        # Docutils says what is wrong by several kinds of exception.
        raise ExtensionError(f'formula not understood ({error}): {source}') from error
    if 'merror' in made:
        raise ExtensionError(f'formula not understood: {source}')
    return made


def visit_math(translator: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(mathml(node.astext(), display=False))
    raise nodes.SkipNode


def visit_displaymath(translator: Any, node: nodes.math_block) -> None:
    """Write a formula on lines of its own, with its number at the right."""
    text = node.astext()
    if '\\\\' in text and '\\begin' not in text:
        text = f'\\begin{{aligned}}{text}\\end{{aligned}}'
    label = f' aria-label="{escape(text, quote=True)}"'
    translator.body.append(f'<div class="formula"{label}>{mathml(text, display=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, Any]:
    """Register the renderer."""
    app.add_html_math_renderer('mathml', (visit_math, None), (visit_displaymath, None))
    return {'version': '1', 'parallel_read_safe': True, 'parallel_write_safe': True}
