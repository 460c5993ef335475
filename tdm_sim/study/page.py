# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A study as one self-contained HTML page; it needs no network."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
import io
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from tdm_planner import __version__
from tdm_planner.plan_files import write_file
from tdm_sim.report.tables import card
from tdm_sim.study.axes import Axis
from tdm_sim.study.flights import FLOWN
from tdm_sim.study.pictures import Columns
from tdm_sim.study.tables import MARGIN

_PAGE = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="generator" content="tdm_planner {version}">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}
figure {{ margin: 0; }} figure img {{ max-width: 100%; border-radius: 6px; }}</style>
</head>
<body>
<header><h1>{title}</h1><p class="subtitle">{subtitle}</p></header>
<main><div class="columns">{columns}</div></main>
<footer>tdm_planner {version}</footer>
</body>
</html>
"""
_REASONS = 8  # that are told of a code, the most frequent
_DPI = 110


def write_pictures(folder: Path, pictures: Mapping[str, tuple[Figure, str]]) -> dict[str, bytes]:
    """Write pictures as PNG into a folder; returns them."""
    found = {}
    for name, (figure, _) in pictures.items():
        data = io.BytesIO()
        figure.savefig(data, format='png', dpi=_DPI)
        found[name] = data.getvalue()
        (folder / f'{name}.png').write_bytes(found[name])
    return found


def write_page(
    path: Path,
    problem: str,
    columns: Columns,
    axes: Sequence[Axis],
    shared: Mapping[str, Any],
    pictures: Mapping[str, tuple[str, bytes]],
) -> None:
    """
    Write the page of a study's table; `pictures` are titles and PNG by name.

    Raises
    ------
    UnusableFile
        If it cannot be written.

    """
    verified, total = sum(columns['verified']), len(columns['row'])
    over = ', '.join(f'{axis.name} ({len(axis.values)} values)' for axis in axes)
    cards = [_figure(title, data) for title, data in pictures.values()]
    cards.append(card('Verified', _counts(columns)))
    cards.append(card('Figures', _figures(columns)))
    cards.append(card('What was varied', _table(('parameter', 'values'), _values(axes))))
    if shared:
        rows = [(name, str(value)) for name, value in shared.items()]
        cards.append(card('What was the same', _table(('', ''), rows)))
    halves = cards[::2], cards[1::2]
    page = _PAGE.format(
        version=__version__,
        title=escape(f'Study of {problem}'),
        subtitle=escape(f'{verified} of {total} plans verified; {over}'),
        style=files('tdm_sim.report').joinpath('assets', 'page.css').read_text(encoding='utf-8'),
        columns=''.join(f'<div class="column">{"".join(part)}</div>' for part in halves),
    )
    write_file(path, page.encode())


def _figure(title: str, data: bytes) -> str:
    source = base64.b64encode(data).decode()
    body = f'<figure><img alt="{escape(title)}" src="data:image/png;base64,{source}"></figure>'
    return card(title[:1].upper() + title[1:], body)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return '<tr>' + ''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells) + '</tr>'

    body = ''.join(line(row, 'td') for row in rows)
    return f'<table><thead>{line(head, "th")}</thead><tbody>{body}</tbody></table>'


def _counts(columns: Columns) -> str:
    """Count the plans, and what became of the others, with the reasons."""
    total, codes = len(columns['row']), Counter(columns['code'])
    rows = [('verified', str(codes.pop('', 0)), '')]
    for code, count in codes.most_common():
        told = Counter(
            r for c, r in zip(columns['code'], columns['reason'], strict=True) if c == code
        )
        rows.append((code, str(count), ''))
        rows += [('', str(n), reason) for reason, n in told.most_common(_REASONS)]
    return _table(('', f'of {total}', 'reason'), rows)


def _figures(columns: Columns) -> str:
    """Return least, median and largest of every column of figures."""
    rows = []
    for name, values in columns.items():
        plain = name in ('cost', 'duration', 'solve_time', 'evaluations', 'caught', 'held')
        if not (plain or name.startswith((MARGIN, FLOWN))):
            continue
        known = np.array([v for v in values if v is not None], dtype=float)
        if known.size:
            quantiles = np.quantile(known, [0.0, 0.5, 1.0])
            rows.append((name, *(f'{value:.4g}' for value in quantiles)))
    return _table(('', 'least', 'median', 'largest'), rows)


def _values(axes: Sequence[Axis]) -> list[tuple[str, str]]:
    found = []
    for axis in axes:
        few = [str(value) for value in axis.values] if len(axis.values) <= _REASONS else []
        ends = f'{axis.values[0]} to {axis.values[-1]}, {len(axis.values)} values, {axis.spacing}'
        found.append((axis.name, ', '.join(few) if axis.spacing == 'list' and few else ends))
    return found
