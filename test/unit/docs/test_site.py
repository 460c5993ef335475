# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How the documentation's pages are made; continuous integration makes them by `make docs`."""

from __future__ import annotations

from pathlib import Path
import re
import sys

import pytest
from tools import links
from tools.links import dead_links

SOURCE = Path(__file__).resolve().parents[3]
sphinx = pytest.importorskip('sphinx', reason='the site is made by: make docs')


@pytest.fixture(autouse=True)
def _extensions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SOURCE / 'docs' / '_extensions'))


def test_warnings_and_dead_links_fail_the_build():
    recipe = re.search(
        r'^docs:.*\n((?:\t.*\n)+)', (SOURCE / 'Makefile').read_text('utf-8'), re.MULTILINE
    )
    assert recipe is not None
    assert '--fail-on-warning' in recipe[1]
    assert '-m tools.links docs/_build' in recipe[1]


def test_every_formula_is_understood():
    from presentation_mathml import mathml

    theory = (SOURCE / 'docs' / 'theory.md').read_text(encoding='utf-8')
    formulas = re.findall(r'\$\$(.+?)\$\$|\$([^$]+?)\$', theory, re.DOTALL)
    assert len(formulas) > 50
    for display, inline in formulas:
        assert mathml(display or inline, bool(display)).startswith('<math')


@pytest.mark.parametrize('wrong', [r'\frac12 x', r'\nosuch{x}', r'\frac{1}{2'])
def test_formulas_that_would_come_out_wrong_stop_the_build(wrong: str):
    from presentation_mathml import mathml
    from sphinx.errors import ExtensionError

    with pytest.raises(ExtensionError):
        mathml(wrong, display=True)


def test_docstrings_are_taken_as_they_stand():
    from plain_docstrings import to_restructured_text

    lines = ['The limit |T| <= T_max of `a_b*`.', '', '    x = |y| * 2', '', 'After.']
    assert to_restructured_text(lines) == [
        r'The limit \|T\| <= T_max of `a_b*`.',
        '',
        '::',
        '',
        '    x = |y| * 2',
        '',
        'After.',
    ]


def test_sections_of_docstrings_are_left_alone():
    from plain_docstrings import to_restructured_text

    lines = ['Do it.', '', 'Raises', '------', 'InvalidProblem', '    If it cannot be done.']
    assert to_restructured_text(lines) == lines


def test_every_worked_plant_is_shown():
    shown = (SOURCE / 'docs' / 'plants' / 'sources.md').read_text(encoding='utf-8')
    listed = (SOURCE / 'docs' / 'plants' / 'README.md').read_text(encoding='utf-8')
    for name in re.findall(r'^\| \[(\w+\.py)\]', listed, re.MULTILINE):
        assert f'{{literalinclude}} {name}' in shown, name


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'index.html').write_text(
        '<a href="folder/other.html#there">a</a> <a href="https://example.org/x">b</a>'
        '<h1 id="top">c</h1> <a href="#top">d</a> <img src="picture.png">'
    )
    (tmp_path / 'folder' / 'other.html').write_text('<p id="there">e</p><a href="../">f</a>')
    (tmp_path / 'picture.png').write_bytes(b'')
    links._read.cache_clear()
    return tmp_path


def test_links_that_lead_somewhere_are_passed(site: Path, monkeypatch: pytest.MonkeyPatch):
    assert dead_links(site) == []
    monkeypatch.setattr(sys, 'argv', ['links', str(site)])
    assert links.main() == 0


@pytest.mark.parametrize(
    'link', ['missing.html', 'folder/other.html#elsewhere', '#bottom', 'missing.png']
)
def test_dead_links_are_found(site: Path, link: str, monkeypatch: pytest.MonkeyPatch):
    (site / 'third.html').write_text(f'<a href="{link}">a</a>')
    (found,) = dead_links(site)
    assert link in found
    monkeypatch.setattr(sys, 'argv', ['links', str(site)])
    assert links.main() == 1


def test_an_empty_site_is_no_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, 'argv', ['links', str(tmp_path)])
    assert links.main() == 1
