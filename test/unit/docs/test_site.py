# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`make docs` finds links of the made pages that lead nowhere."""

from __future__ import annotations

from pathlib import Path
import sys

import pytest

links = pytest.importorskip('tools.links')


@pytest.mark.parametrize(
    'dead', ['', 'missing.html', 'folder/other.html#elsewhere', '#bottom', 'missing.png']
)
def test_dead_links_are_found(dead: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    links._read.cache_clear()
    monkeypatch.setattr(sys, 'argv', ['links', str(tmp_path)])
    assert links.main() == 1  # an empty site is no success
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'index.html').write_text(
        '<a href="folder/other.html#there">a</a> <a href="https://example.org/x">b</a>'
        '<h1 id="top">c</h1> <a href="#top">d</a> <img src="picture.png">'
    )
    (tmp_path / 'folder' / 'other.html').write_text('<p id="there">e</p><a href="../">f</a>')
    (tmp_path / 'picture.png').write_bytes(b'')
    if dead:
        (tmp_path / 'third.html').write_text(f'<a href="{dead}">a</a>')
    found = links.dead_links(tmp_path)
    assert len(found) == bool(dead)
    assert all(dead in line for line in found)
    assert links.main() == len(found)
