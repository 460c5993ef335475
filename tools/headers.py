# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Bring the first lines of every source to one form, and check them.

python -m tools.headers --check   exit 1 where a source lacks copyright and licence
python -m tools.headers --long    write the licence's notice out: what ament_copyright recognises
python -m tools.headers --short   copyright and SPDX identifier

ament_copyright knows licences by the text of their notice only, not by SPDX identifiers; the long
form is for those who run it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('benchmark', 'docs', 'launch', 'tdm_planner', 'tdm_sim', 'test', 'tools')

COPYRIGHT = '# Copyright 2026 The tdm_planner authors\n'
SHORT = COPYRIGHT + '# SPDX-License-Identifier: Apache-2.0\n'
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
LONG = COPYRIGHT + ''.join(f'# {line}'.rstrip() + '\n' for line in NOTICE.splitlines())


def sources(root: Path = ROOT) -> Iterator[Path]:
    """Yield every Python source, setup.py among them."""
    yield root / 'setup.py'
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob('*.py')):
            if '_build' not in path.parts:
                yield path


def body_of(text: str) -> str | None:
    """Return what follows the header, in either form; None without one."""
    for header in (LONG, SHORT):
        if text.startswith(header):
            return text.removeprefix(header)
    return None


def main() -> int:
    """Check the headers, or rewrite them."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    form = parser.add_mutually_exclusive_group(required=True)
    form.add_argument('--check', action='store_true')
    form.add_argument('--long', action='store_true')
    form.add_argument('--short', action='store_true')
    options = parser.parse_args()
    missing = 0
    for path in sources():
        text = path.read_text(encoding='utf-8')
        body = body_of(text)
        if body is None:
            missing += 1
            print(f'{path.relative_to(ROOT)}: no copyright and licence in its first lines')
        elif not options.check:
            gap = '\n' if options.long and not body.startswith('\n') else ''
            made = LONG + gap + body if options.long else SHORT + body.removeprefix('\n')
            if made != text:
                path.write_text(made, encoding='utf-8')
    return int(missing > 0)


if __name__ == '__main__':
    sys.exit(main())
