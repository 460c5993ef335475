# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Begin every source with copyright and licence, in the words that ament_copyright recognises.

python -m tools.headers           write them where they are missing
python -m tools.headers --check   exit 1 where they are missing
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('benchmark', 'docs', 'launch', 'tdm_planner', 'tdm_sim', 'test', 'tools')

NOTICE = """
Licensed under the Apache License, Version 2.0 (the "License");
you may not use this file except in compliance with the License.
You may obtain a copy of the License at

    http://www.apache.org/licenses/LICENSE-2.0

Unless required by applicable law or agreed to in writing, software
distributed under the License is distributed on an "AS IS" BASIS,
WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
See the License for the specific language governing permissions and
limitations under the License.
"""
COMMENTS = {'.py': '#', '.c': '//'}


def header(path: Path) -> str:
    """Return the header as comments of the language that `path` is in."""
    lines = ['Copyright 2026 The tdm_planner authors', *NOTICE.splitlines()]
    return ''.join(f'{COMMENTS[path.suffix]} {line}'.rstrip() + '\n' for line in lines)


def sources(root: Path = ROOT) -> Iterator[Path]:
    """Yield every source, setup.py among them."""
    yield root / 'setup.py'
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob('*')):
            if path.suffix in COMMENTS and '_build' not in path.parts:
                yield path


def words(text: str) -> list[str]:
    """Return what is said, however the lines are broken, as ament_copyright compares it."""
    return [word for word in text.split() if word not in COMMENTS.values()]


def bare(root: Path = ROOT) -> list[Path]:
    """Return the sources without the header."""

    def begins(path: Path) -> bool:
        wanted, found = words(header(path)), words(path.read_text(encoding='utf-8'))
        return found[: len(wanted)] == wanted

    return [path for path in sources(root) if not begins(path)]


def main() -> int:
    """Check the headers, or write those that are missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('--check', action='store_true', help='only tell what is missing')
    options = parser.parse_args()
    found = bare(ROOT)
    for path in found:
        if options.check:
            print(f'{path.relative_to(ROOT)}: no copyright and licence in its first lines')
        else:
            text = path.read_text(encoding='utf-8')
            path.write_text(header(path) + '\n' + text, encoding='utf-8')
    return 1 if options.check and found else 0


if __name__ == '__main__':
    sys.exit(main())
