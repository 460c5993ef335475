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

"""The pages that people read, and what stands in their code blocks."""

from __future__ import annotations

from pathlib import Path
import re
import shlex

SOURCE = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path
    for path in [*SOURCE.glob('*.md'), *(SOURCE / 'docs').rglob('*.md')]
    if '_build' not in path.parts
)


def name_of(page: Path) -> str:
    return str(page.relative_to(SOURCE))


def blocks(page: Path, language: str) -> list[str]:
    """Code blocks in a language."""
    text = page.read_text(encoding='utf-8')
    return re.findall(rf'^```{language}\n(.*?)^```$', text, re.DOTALL | re.MULTILINE)


def commands(page: Path) -> list[list[str]]:
    """Return the words of every command in the page's shell blocks."""
    found = []
    for block in blocks(page, 'sh'):
        for line in block.replace('\\\n', ' ').splitlines():
            words: list[str] = []
            for word in [*shlex.split(line, comments=True), '&&']:
                if word != '&&':
                    words.append(word)
                elif words:
                    found.append(words)
                    words = []
    return found
