# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The pages that people read, and what stands in their code blocks."""

from __future__ import annotations

from pathlib import Path
import re
import shlex

from ros_harness import SOURCE

PAGES = sorted(
    path
    for path in [*SOURCE.glob('*.md'), *(SOURCE / 'docs').rglob('*.md')]
    if '_build' not in path.parts
)
SHARE = '$(ros2 pkg prefix --share tdm_planner)'  # commands are run in a folder like it


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


def console_commands(page: Path) -> list[list[str]]:
    """Return the words of every line of the blocks marked `console`, which may stand in lists."""
    text = page.read_text(encoding='utf-8')
    found = re.findall(r'^( *)```console\n(.*?)^\1```$', text, re.DOTALL | re.MULTILINE)
    lines = ''.join(block for _, block in found).replace('\\\n', ' ').splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def typed(page: Path) -> list[list[str]]:
    """Return the words of every command, those of blocks marked `console` too."""
    found = [*commands(page), *console_commands(page)]
    return [[word.replace(SHARE, '.') for word in command] for command in found]


def install_own_plant(folder: Path) -> None:
    """Leave the worked plant in a folder as pip does: a module, registered by metadata."""
    page = SOURCE / 'docs' / 'plants' / 'double_integrator.py'
    (folder / 'students_plant.py').write_text(page.read_text())
    metadata = folder / 'students_plant-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text(
        'Metadata-Version: 2.1\nName: students-plant\nVersion: 1.0\n'
    )
    (metadata / 'entry_points.txt').write_text(
        '[tdm_planner.problems]\ndouble_integrator = students_plant:DoubleIntegrator\n'
    )
