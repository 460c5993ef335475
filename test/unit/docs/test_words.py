# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Sources and pages keep to the glossary; pages are short, and quote messages as they are."""

import ast
from collections.abc import Iterator
import io
from pathlib import Path
import re
import tokenize

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = ('tdm_planner', 'tdm_sim', 'launch', 'tools', 'benchmark')
SOURCES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob('*.py'))
PAGES = sorted(
    path
    for path in [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *(ROOT / 'docs').rglob('*.md')]
    if '_build' not in path.parts and path.name != 'benchmarks.md'  # written by a benchmark
)
# Retired, and what is said instead. Identifiers are exempt: names, backticks, braces.
RETIRED = {
    r'left out|leaves? (states|messages) out': 'ignored, dropped, skipped',
    r'in force|carried out|carries out': 'active, executed',
    r'taken over|takes over|taken up|take-over|preempt\w*': 'superseded, resumed, recovered',
    r'refus(e|es|ed|ing|als?)': 'rejected, ignored',
    r'given up|gives? up': 'dropped, aborted',
    r'foreseen|foresees|foretell': 'predicted',
    r'made anew|started anew|planned anew': 'replanned, restarted',
    r'first guess(es)?': 'initial guess',
    r'steer(s|ed|ing)?': 'shooting',
    r'lockstep|worth all|beyond help|whoever has written|wish(es|ed)?|trouble': '-',
    r'(some|no|every)body': 'a client, no node, a viewer',
}
CHECKED = re.compile('|'.join(rf'\b(?:{phrase})\b' for phrase in RETIRED), re.IGNORECASE)
EXEMPT = re.compile(r'`[^`\n]*`|\{[^}\n]*\}')
GENERATED = re.compile(r'<!-- generated: .*?<!-- end -->', re.DOTALL)


def prose(source: Path) -> str:
    tokens = tokenize.generate_tokens(io.StringIO(source.read_text(encoding='utf-8')).readline)
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, 'FSTRING_MIDDLE', None)}
    return '\n'.join(token.string for token in tokens if token.type in kinds)


def test_sources_and_pages_use_no_retired_words_and_are_short() -> None:
    pages = {page: page.read_text(encoding='utf-8') for page in PAGES}
    texts = {page: GENERATED.sub('', text) for page, text in pages.items()}
    texts |= {source: EXEMPT.sub('', prose(source)) for source in SOURCES}
    found = [f'{path}: {match[0]}' for path in texts for match in CHECKED.finditer(texts[path])]
    assert not found, '\n'.join(found)
    every = pages | {source: source.read_text(encoding='utf-8') for source in SOURCES}
    assert not [path.name for path, text in every.items() if len(text.splitlines()) > 400]


def texts() -> Iterator[str]:
    """Yield every text of the sources, `...` in the place of values."""
    files = [*(ROOT / 'tdm_planner').rglob('*.py'), *(ROOT / 'tdm_sim').rglob('*.py')]
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.JoinedStr):
                parts = (p.value if isinstance(p, ast.Constant) else '...' for p in node.values)
                yield ''.join(map(str, parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
    yield (ROOT / 'Makefile').read_text(encoding='utf-8')


def test_troubleshooting_quotes_messages_as_they_are() -> None:
    page = (ROOT / 'docs/troubleshooting.md').read_text(encoding='utf-8')
    quoted = re.findall(r'^> `(.+)`$', page, re.MULTILINE)
    known = '\n'.join(texts())
    parts = [part for message in quoted for part in re.split(r"\s*'?\.\.\.'?\s*", message)]
    assert quoted
    assert not [part for part in parts if len(part) > 3 and part not in known]
