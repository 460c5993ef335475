# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""How the documentation's pages are made; `make docs` makes them, without a network."""

from __future__ import annotations

import importlib
from pathlib import Path
import sys
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / '_extensions'), str(HERE.parent)]

project = 'tdm_planner'
author = 'The tdm_planner authors'
copyright = '2026, The tdm_planner authors'  # noqa: A001
version = release = importlib.import_module('tdm_planner').__version__

extensions = [
    'myst_parser',
    'sphinx.ext.autodoc',
    'sphinx.ext.napoleon',
    'plain_docstrings',
    'presentation_mathml',
]
source_suffix = {'.md': 'markdown', '.rst': 'restructuredtext'}
exclude_patterns = ['_build', '_extensions']
default_role = 'literal'

# GitHub shows the same pages: its syntax, its anchors.
myst_enable_extensions = ['amsmath', 'attrs_inline', 'dollarmath', 'tasklist']
myst_heading_anchors = 4
myst_dmath_double_inline = True

autodoc_member_order = 'bysource'
autodoc_typehints = 'signature'
autodoc_typehints_format = 'short'
autodoc_type_aliases = {'Array': 'Array', 'ArrayLike': 'ArrayLike'}
python_maximum_signature_line_length = 88
napoleon_numpy_docstring = True
napoleon_google_docstring = False

html_theme = 'furo'
html_title = f'tdm_planner {version}'
html_static_path = ['_static']
html_css_files = ['wide_tables.css']
html_math_renderer = 'mathml'
html_show_sphinx = False
html_copy_source = False
html_theme_options = {'navigation_with_keys': True}


def leave_out_missing_pages(app: Any, name: str, content: list[str]) -> None:
    """Take pages that measurements write off the index while they are not there."""
    if name == 'index':
        for page in ('benchmarks', 'reliability'):
            if not (HERE / f'{page}.md').is_file():
                content[0] = content[0].replace(f'\n{page}\n', '\n')


def setup(app: Any) -> None:
    """Register what is special to these pages."""
    app.connect('source-read', leave_out_missing_pages)
