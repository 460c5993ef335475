# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Pictures of a study, and the page with them, which needs no network.

A picture is a curve over one variable, a map over two, all pairs of more.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from html import escape
import io
from itertools import cycle
from pathlib import Path
from statistics import mode
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import LogLocator, NullFormatter
import numpy as np
from numpy.typing import NDArray
from tdm_planner.arrays import Array
from tdm_planner.drawing import COLOURS
from tdm_planner.plan_files import write_file
from tdm_sim.report.page import page_html
from tdm_sim.report.plotting import legend_above
from tdm_sim.report.tables import card
from tdm_sim.study.axes import Axis, cell

Columns = Mapping[str, Sequence[Any]]
Codes = NDArray[np.object_]  # (N,) of every row why it is not verified; '': it is
Rows = Sequence[Sequence[Any]]

PAGE = 'study.html'
REPEATED = 'solver.seed'  # varied, it repeats plans: their spread is shown
_HATCHES = {  # of what is not verified, by the reason's code
    'INFEASIBLE': '///',
    'DEADLINE': '...',
    'VERIFICATION_FAILED': 'xxx',
    'INVALID_PROBLEM': '\\\\\\',
    'INTERNAL': '+++',
}
_OTHER, _GROUND, _INK = 'ooo', '0.93', '0.45'
_FAR = 30.0  # times the median, or its inverse: values beyond have the colour of that
_WIDE = 10.0  # ratio of the largest value to the smallest, from which colours are logarithmic
_MARKERS = 'xv^<>sd'
_DPI = 110
_SHARES = {'caught': 'share of flights caught', 'held': 'share of flights held'}
_TITLES = {'cost': 'cost J', 'duration': 'duration [s]', **_SHARES}
_REASONS = 8  # that are told of a code, the most frequent


class Variable:
    """
    A parameter along an axis of a picture.

    `places` (n,) are where its values lie, of what are no numbers their count; `edges` (n + 1,)
    lie between them; `rows` (N,) say which of the values every row has.
    """

    def __init__(self, axis: Axis, unit: str, column: Sequence[Any]) -> None:
        self.title, self.spacing = f'{axis.name} [{unit}]' if unit else axis.name, axis.spacing
        self.labels: list[str] = []
        if all(type(value) in (int, float) for value in axis.values):
            self.places = np.unique(np.array(axis.values, dtype=float))
            self.rows = np.searchsorted(self.places, np.array(column, dtype=float))
        else:
            self.labels = list(dict.fromkeys(str(cell(value)) for value in axis.values))
            self.places = np.arange(len(self.labels), dtype=float)
            self.rows = np.array([self.labels.index(str(cell(value))) for value in column])
        log = axis.spacing == 'log'
        at = np.log(self.places) if log else self.places
        around = np.array([2 * at[0] - at[1], *at, 2 * at[-1] - at[-2]])
        edges = 0.5 * (around[1:] + around[:-1])
        self.edges = np.exp(edges) if log else edges

    def label(self, axes: Axes, which: str) -> None:
        """Name the axis x or y of a picture, and its values where they are no numbers."""
        axis: Any = getattr(axes, f'{which}axis')
        axis.set_label_text(self.title)
        if self.labels:
            axis.set_ticks(self.places, self.labels)
        elif self.spacing == 'log':
            axes.set(**{f'{which}scale': 'log'})
            _plain(axis)


def _plain(axis: Any) -> None:
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(lambda value, _: f'{value:g}')
    axis.set_minor_formatter(NullFormatter())


def draw(
    columns: Columns, axes: Sequence[Axis], units: Mapping[str, str]
) -> dict[str, tuple[Figure, str]]:
    """
    Return pictures and their titles by name; none where nothing is varied.

    `columns` are those of a study's table, all of one length.
    """
    varied = [a for a in axes if len(set(map(cell, a.values))) > 1 and a.name != REPEATED]
    variables = [Variable(axis, units.get(axis.name, ''), columns[axis.name]) for axis in varied]
    codes = np.array(columns['code'], dtype=object)
    shown = {n: np.array(columns[n], dtype=float) for n in _TITLES if n in columns}
    for name in shown.keys() & _SHARES.keys():
        shown[name] /= np.array(columns['flights'], dtype=float)
    if np.array_equal(shown['cost'], shown['duration'], equal_nan=True):
        del shown['cost']
    if not variables:
        return {}
    if len(variables) == 1:
        return {'curve': (_curves(variables[0], shown, codes), ' and '.join(shown))}
    return {n: (_maps(variables, n, values, codes), _TITLES[n]) for n, values in shown.items()}


def _cells(
    variables: Sequence[Variable], values: Array, codes: Codes
) -> Iterator[tuple[list[int], Array, str]]:
    """Yield places of rows, what of `values` (N,) is known there, the code of most of them."""
    cells, which = np.unique([v.rows for v in variables], axis=1, return_inverse=True)
    order = np.argsort(which.ravel(), kind='stable')
    ends = np.cumsum(np.bincount(which.ravel()))
    for found, rows in zip(cells.T.tolist(), np.split(order, ends[:-1]), strict=True):
        yield found, values[rows][~np.isnan(values[rows])], mode(codes[rows])


def _curves(variable: Variable, shown: Mapping[str, Array], codes: Codes) -> Figure:
    """Draw medians over one variable, the spread of repeated plans, what is not verified."""
    figure = Figure(figsize=(8, 1.2 + 2.4 * len(shown)), layout='constrained')
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    style = '.' if variable.spacing == 'random' or variable.labels else '.-'
    for axis, (name, values) in zip(axes, shown.items(), strict=True):
        low, middle, high = spread = np.full((3, variable.places.size), np.nan)
        for (k,), known, code in _cells([variable], values, codes):
            if known.size:
                spread[:, k] = known.min(), np.median(known), known.max()
            else:
                axis.axvspan(*variable.edges[[k, k + 1]], **_hatched(code))
        axis.fill_between(variable.places, low, high, color=COLOURS[0], alpha=0.2, lw=0)
        axis.plot(variable.places, middle, style, color=COLOURS[0])
        axis.set_ylabel(_TITLES[name])
        axis.grid(alpha=0.25)
        if name in _SHARES:
            axis.set_ylim(-0.03, 1.03)
    variable.label(axes[-1], 'x')
    _legend(axes[0], codes)
    return figure


def _map(
    axis: Axes, x: Variable, y: Variable, values: Array, codes: Codes, norm: Normalize
) -> Any:
    """Colour the plane of two variables, hatched where nothing is verified; return the colours."""
    if x.spacing == y.spacing == 'random':
        at, to = x.places[x.rows], y.places[y.rows]
        drawn: Any = axis.scatter(at, to, c=values, norm=norm, s=22)
        for code, marker in zip(_reasons(codes), cycle(_MARKERS), strict=False):
            of = codes == code
            axis.plot(at[of], to[of], marker, color=_INK, ms=4, label=code)
    else:
        colours = np.full((y.places.size, x.places.size), np.nan)
        for (p, q), known, code in _cells([x, y], values, codes):
            if known.size:
                colours[q, p] = np.median(known)
                continue
            wide, high = x.edges[p + 1] - x.edges[p], y.edges[q + 1] - y.edges[q]
            corner = x.edges[p], y.edges[q]
            axis.add_patch(Rectangle(corner, wide, high, **_hatched(code)))
        drawn = axis.pcolormesh(x.edges, y.edges, np.ma.masked_invalid(colours), norm=norm)
    x.label(axis, 'x')
    y.label(axis, 'y')
    axis.label_outer()
    return drawn


def _maps(variables: Sequence[Variable], name: str, values: Array, codes: Codes) -> Figure:
    """Draw the plane of every two variables: the median over all values of the others."""
    n = len(variables) - 1
    norm = _norm(name, values)
    size = (8.0, 5.6) if n == 1 else (3.2 * n + 2.0, 2.8 * n + 0.8)
    figure = Figure(figsize=size, layout='constrained')
    cells = [(q, p) for q in range(n) for p in range(q + 1)]
    axes = [figure.add_subplot(n, n, q * n + p + 1) for q, p in cells]
    for axis, (q, p) in zip(axes, cells, strict=True):
        drawn = _map(axis, variables[p], variables[q + 1], values, codes, norm)
    title = _TITLES[name] if n == 1 else f'{_TITLES[name]}, median'
    bar = figure.colorbar(drawn, ax=axes, label=title)
    if isinstance(drawn.norm, LogNorm):
        _plain(bar.ax.yaxis)
    _legend(axes[0], codes)
    return figure


def _norm(name: str, values: Array) -> Normalize:
    known = values[np.isfinite(values)]
    if name in _SHARES or not known.size:
        return Normalize(0.0, 1.0)
    low, high, middle = float(known.min()), float(known.max()), float(np.median(known))
    if low > 0.0:  # a start that is the goal, say, must not take the colours of all others
        low, high = max(low, middle / _FAR), min(high, middle * _FAR)
    return (LogNorm if 0.0 < low * _WIDE < high else Normalize)(low, high)


def _reasons(codes: Codes) -> list[str]:
    return sorted({*codes} - {''})


def _hatched(code: str) -> dict[str, Any]:
    return {'fc': _GROUND, 'ec': _INK, 'lw': 0, 'hatch': _HATCHES.get(code, _OTHER)}


def _legend(axis: Axes, codes: Codes) -> None:
    lines, labels = axis.get_legend_handles_labels()
    hatches: dict[str, Any] = {code: Patch(**_hatched(code)) for code in _reasons(codes)}
    if hatches:
        legend_above(axis, dict(zip(labels, lines, strict=True)) or hatches, columns=4)


def write_page(
    folder: Path,
    problem: str,
    columns: Columns,
    axes: Sequence[Axis],
    shared: Mapping[str, Any],
    pictures: Mapping[str, tuple[Figure, str]],
) -> None:
    """
    Write the page of a study's table into a folder, and the pictures as they are `draw`n as PNG.

    Raise UnusableFile if it cannot be written.
    """
    cards = []
    for name, (figure, title) in pictures.items():
        png = io.BytesIO()
        figure.savefig(png, format='png', dpi=_DPI)
        write_file(folder / f'{name}.png', png.getvalue())
        source = f'data:image/png;base64,{base64.b64encode(png.getvalue()).decode()}'
        body = f'<img alt="{escape(title)}" src="{source}">'
        cards.append(card(title[:1].upper() + title[1:], body))
    tables = [
        ('Verified', ('', f'of {len(columns["row"])}', 'reason'), _counts(columns)),
        ('Parameters', ('', 'values'), [*map(_values, axes), *shared.items()]),
    ]
    for title, head, rows in tables:
        lines = [_line(head, 'th'), '</thead><tbody>', *(_line(row, 'td') for row in rows)]
        cards.append(card(title, f'<table class="study"><thead>{"".join(lines)}</tbody></table>'))
    over = ', '.join(f'{axis.name} ({len(axis.values)} values)' for axis in axes)
    subtitle = f'{sum(columns["verified"])} of {len(columns["row"])} plans verified; {over}'
    page = page_html(f'Study of {problem}', subtitle, (cards[::2], cards[1::2]))
    write_file(folder / PAGE, page.encode())


def _line(cells: Sequence[Any], tag: str) -> str:
    return f'<tr>{"".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells)}</tr>'


def _counts(columns: Columns) -> Rows:
    """Count the plans, and what became of the others, with the reasons."""
    told = Counter(zip(columns['code'], columns['reason'], strict=True)).most_common()
    codes = Counter(columns['code'])
    rows: list[Sequence[Any]] = [('verified', codes.pop('', 0), '')]
    for code, count in codes.most_common():
        reasons = [('', n, reason) for (of, reason), n in told if of == code]
        rows += [(code, count, ''), *reasons[:_REASONS]]
    return rows


def _values(axis: Axis) -> tuple[str, str]:
    values = list(map(str, axis.values))
    if axis.spacing == 'list' and len(values) <= _REASONS:
        return axis.name, ', '.join(values)
    return axis.name, f'{values[0]} to {values[-1]}, {len(values)} values, {axis.spacing}'
