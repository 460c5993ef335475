# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Follow every link inside a folder of HTML pages; exit 1 if one leads nowhere.

python -m tools.links docs/_build
"""

from __future__ import annotations

import argparse
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
import sys
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """Gathers what a page links to, and the anchors that it has."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take links, sources and anchors of a tag."""
        for name, value in attrs:
            if value is None:
                continue
            if name == 'id' or (tag == 'a' and name == 'name'):
                self.anchors.add(value)
            elif name in ('href', 'src'):
                self.links.append(value)


@cache
def _read(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding='utf-8'))
    return page


def dead_links(folder: Path) -> list[str]:
    """Return a line for every link of the pages in `folder` whose file or anchor is missing."""
    found = []
    for path in sorted(folder.rglob('*.html')):
        for link in dict.fromkeys(_read(path).links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target = target / 'index.html'
            missing = not target.is_file()
            if not missing and parts.fragment and target.suffix == '.html':
                missing = unquote(parts.fragment) not in _read(target).anchors
            if missing:
                found.append(f'{path.relative_to(folder)}: {link} leads nowhere')
    return found


def main() -> int:
    """Check the folder named on the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('folder', type=Path, help='of HTML pages, such as docs/_build')
    folder = parser.parse_args().folder
    pages = len(list(folder.rglob('*.html')))
    dead = dead_links(folder)
    print('\n'.join([*dead, f'{folder}: {pages} pages, {len(dead)} dead links']))
    return int(bool(dead) or not pages)


if __name__ == '__main__':
    sys.exit(main())
