# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Pictures of a study, and the page with them, which needs no network.

A picture is a curve over one variable, a map over two, all pairs of more.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
import io
from pathlib import Path
from statistics import mode
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import LogLocator, NullFormatter
import numpy as np
from numpy.typing import NDArray
from tdm_planner.drawing import COLOURS
from tdm_planner.plan_files import write_file
from tdm_planner.plotting import legend_above
from tdm_sim.report.page import page_html
from tdm_sim.report.tables import card
from tdm_sim.study.axes import Axis
from tdm_sim.study.flights import FLOWN
from tdm_sim.study.study import MARGIN

Array = NDArray[np.float64]
Columns = Mapping[str, Sequence[Any]]

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
_FIGURES = ('cost', 'duration', 'solve_time', 'evaluations', 'caught', 'held')
_REASONS = 8  # that are told of a code, the most frequent


class Variable:
    """
    A parameter along an axis of a picture.

    `places` (n,) are where its values lie; of what are no numbers their count. `edges` (n + 1,)
    lie between them.
    """

    def __init__(self, axis: Axis, unit: str) -> None:
        numbers = all(type(value) in (int, float) for value in axis.values)
        self.name, self.unit, self.spacing = axis.name, unit, axis.spacing
        values = sorted(set(axis.values)) if numbers else list(axis.values)
        self.labels = [] if numbers else [str(value) for value in values]
        self.places = np.array(values if numbers else range(len(values)), dtype=float)
        self._number = {_key(value): number for number, value in enumerate(values)}
        log = axis.spacing == 'log'
        at = np.log(self.places) if log else self.places
        ends = 1.5 * at[[0, -1]] - 0.5 * at[[1, -2]]
        edges = np.array([ends[0], *(0.5 * (at[1:] + at[:-1])), ends[1]])
        self.edges = np.exp(edges) if log else edges

    def place(self, column: Sequence[Any]) -> NDArray[np.intp]:
        """Return which of the values every row has (N,)."""
        return np.array([self._number[_key(value)] for value in column], dtype=np.intp)

    def label(self, axes: Axes, which: str) -> None:
        """Name the axis x or y of a picture, and its values where they are no numbers."""
        axis: Any = getattr(axes, f'{which}axis')
        axis.set_label_text(f'{self.name} [{self.unit}]' if self.unit else self.name)
        if self.labels:
            axis.set_ticks(self.places, self.labels)
        elif self.spacing == 'log':
            axes.set(**{f'{which}scale': 'log'})
            _plain(axis)


def _plain(axis: Any) -> None:
    """Write plain numbers on a logarithmic axis."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(lambda value, _: f'{value:g}')
    axis.set_minor_formatter(NullFormatter())


def _key(value: Any) -> str:
    return str(list(value)) if isinstance(value, (list, tuple)) else str(value)


class Quantity(NamedTuple):
    """What a picture shows: `values` (N,) of every row, NaN where it has none."""

    name: str
    title: str
    values: Array
    share: bool = False


def quantities(columns: Columns) -> list[Quantity]:
    """Return what there is to show: cost, duration where it is another, shares of flights."""
    names = ('cost', 'duration', *(('flights', 'caught', 'held') if 'flights' in columns else ()))
    cost, duration, *flown = (np.array(columns[name], dtype=float) for name in names)
    same = np.array_equal(cost, duration, equal_nan=True)
    found = [] if same else [Quantity('cost', 'cost J', cost)]
    found.append(Quantity('duration', 'duration [s]', duration))
    for name, count in zip(names[3:], flown[1:], strict=True):
        found.append(Quantity(name, f'share of flights {name}', count / flown[0], share=True))
    return found


def draw(
    columns: Columns, axes: Sequence[Axis], units: Mapping[str, str]
) -> dict[str, tuple[Figure, str]]:
    """
    Return pictures and their titles by name; none where nothing is varied.

    `columns` are those of a study's table, all of one length.
    """
    varied = [a for a in axes if len(set(map(_key, a.values))) > 1 and a.name != REPEATED]
    variables = [Variable(axis, units.get(axis.name, '')) for axis in varied]
    shown = quantities(columns)
    if not variables:
        return {}
    if len(variables) == 1:
        names = ' and '.join(q.name for q in shown)
        return {'curve': (_curves(columns, variables[0], shown), names)}
    return {q.name: (_maps(columns, variables, q), q.title) for q in shown}


def _curves(columns: Columns, variable: Variable, shown: Sequence[Quantity]) -> Figure:
    """Draw medians over one variable, the spread of repeated plans, what is not verified."""
    figure = Figure(figsize=(8, 1.2 + 2.4 * len(shown)), layout='constrained')
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    at, codes = variable.place(columns[variable.name]), np.array(columns['code'], dtype=object)
    for axis, quantity in zip(axes, shown, strict=True):
        groups = [quantity.values[at == k] for k in range(len(variable.places))]
        low, middle, high = (
            np.array([np.nan if np.isnan(g).all() else share(g) for g in groups])
            for share in (np.nanmin, np.nanmedian, np.nanmax)
        )
        style = '.' if variable.spacing == 'random' or variable.labels else '.-'
        axis.fill_between(variable.places, low, high, color=COLOURS[0], alpha=0.2, lw=0)
        axis.plot(variable.places, middle, style, color=COLOURS[0])
        for k in np.flatnonzero(np.isnan(middle)).tolist():
            if (at == k).any():
                axis.axvspan(*variable.edges[[k, k + 1]], **_hatched(mode(codes[at == k])))
        axis.set_ylabel(quantity.title)
        axis.grid(alpha=0.25)
        if quantity.share:
            axis.set_ylim(-0.03, 1.03)
    variable.label(axes[-1], 'x')
    _legend(axes[0], columns)
    return figure


def _map(
    axis: Axes, columns: Columns, variables: tuple[Variable, Variable], quantity: Quantity
) -> Any:
    """Colour the plane of two variables, hatched where nothing is verified; return the colours."""
    x, y = variables
    norm = _norm(quantity)
    codes = columns['code']
    i, j = x.place(columns[x.name]), y.place(columns[y.name])
    if x.spacing == y.spacing == 'random':
        drawn: Any = axis.scatter(x.places[i], y.places[j], c=quantity.values, norm=norm, s=22)
        for code, marker in zip(_codes(columns), _MARKERS * 9, strict=False):
            of = np.array([c == code for c in codes])
            axis.plot(x.places[i[of]], y.places[j[of]], marker, color=_INK, ms=4, label=code)
    else:
        values = np.full((y.places.size, x.places.size), np.nan)
        hatched: dict[str, list[Rectangle]] = {}
        for q, p in sorted({*zip(j.tolist(), i.tolist(), strict=True)}):
            rows = np.flatnonzero((j == q) & (i == p)).tolist()
            known = quantity.values[rows]
            if not np.isnan(known).all():
                values[q, p] = np.nanmedian(known)
                continue
            corner, end = (x.edges[p], y.edges[q]), (x.edges[p + 1], y.edges[q + 1])
            cell = Rectangle(corner, end[0] - corner[0], end[1] - corner[1])
            hatched.setdefault(mode(codes[row] for row in rows), []).append(cell)
        drawn = axis.pcolormesh(x.edges, y.edges, np.ma.masked_invalid(values), norm=norm)
        drawn.set_rasterized(True)
        for code, cells in hatched.items():
            axis.add_collection(PatchCollection(cells, **_hatched(code)))
        axis.set(xlim=x.edges[[0, -1]], ylim=y.edges[[0, -1]])
    x.label(axis, 'x')
    y.label(axis, 'y')
    return drawn


def _maps(columns: Columns, variables: Sequence[Variable], quantity: Quantity) -> Figure:
    """Draw the plane of every two variables: the median over all values of the others."""
    n = len(variables) - 1
    size = (8.0, 5.6) if n == 1 else (3.2 * n + 2.0, 2.8 * n + 0.8)
    figure = Figure(figsize=size, layout='constrained')
    axes = figure.subplots(n, n, squeeze=False)
    for axis in axes[np.triu_indices(n, 1)]:
        axis.remove()
    drawn: Any = None
    for q in range(n):
        for p in range(q + 1):
            drawn = _map(axes[q, p], columns, (variables[p], variables[q + 1]), quantity)
            if q < n - 1:
                axes[q, p].set_xlabel('')
            if p:
                axes[q, p].set_ylabel('')
    kept = list(axes[np.tril_indices(n)])
    title = quantity.title if n == 1 else f'{quantity.title}, median'
    bar = figure.colorbar(drawn, ax=kept, label=title, shrink=1.0 if n == 1 else 0.8)
    if isinstance(drawn.norm, LogNorm):
        _plain(bar.ax.yaxis)
    _legend(axes[0, 0], columns)
    return figure


def _norm(quantity: Quantity) -> Normalize:
    known = quantity.values[np.isfinite(quantity.values)]
    if quantity.share or not known.size:
        return Normalize(0.0, 1.0)
    low, high, middle = float(known.min()), float(known.max()), float(np.median(known))
    if low > 0.0:  # a start that is the goal, say, must not take the colours of all others
        low, high = max(low, middle / _FAR), min(high, middle * _FAR)
    return (LogNorm if 0.0 < low * _WIDE < high else Normalize)(low, high)


def _codes(columns: Columns) -> list[str]:
    """Return the codes of what is not verified."""
    return sorted({*columns['code']} - {''})


def _hatched(code: str) -> dict[str, Any]:
    return {'fc': _GROUND, 'ec': _INK, 'lw': 0, 'hatch': _HATCHES.get(code, _OTHER)}


def _legend(axis: Axes, columns: Columns) -> None:
    """Explain the hatches above a picture."""
    lines, labels = axis.get_legend_handles_labels()
    handles: dict[str, Any] = dict(zip(labels, lines, strict=True))
    if not any(isinstance(line, Line2D) for line in lines):
        handles = {code: Patch(**_hatched(code)) for code in _codes(columns)}
    if handles:
        legend_above(axis, handles, columns=4)


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
    verified, total = sum(columns['verified']), len(columns['row'])
    over = ', '.join(f'{axis.name} ({len(axis.values)} values)' for axis in axes)
    cards.append(card('Verified', _counts(columns)))
    cards.append(card('Figures', _figures(columns)))
    cards.append(card('What was varied', _table(('parameter', 'values'), map(_values, axes))))
    if shared:
        cards.append(card('What was the same', _table(('', ''), shared.items())))
    title = f'Study of {problem}'
    subtitle = f'{verified} of {total} plans verified; {over}'
    write_file(folder / PAGE, page_html(title, subtitle, (cards[::2], cards[1::2])).encode())


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    def line(cells: Sequence[Any], tag: str) -> str:
        return f'<tr>{"".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells)}</tr>'

    body = ''.join(line(row, 'td') for row in rows)
    return f'<table><thead>{line(head, "th")}</thead><tbody>{body}</tbody></table>'


def _counts(columns: Columns) -> str:
    """Count the plans, and what became of the others, with the reasons."""
    told = Counter(zip(columns['code'], columns['reason'], strict=True))
    codes = Counter(columns['code'])
    rows: list[Sequence[Any]] = [('verified', codes.pop('', 0), '')]
    for code, count in codes.most_common():
        rows.append((code, count, ''))
        reasons = [('', n, reason) for (of, reason), n in told.most_common() if of == code]
        rows += reasons[:_REASONS]
    return _table(('', f'of {len(columns["row"])}', 'reason'), rows)


def _figures(columns: Columns) -> str:
    """Return least, median and largest of every column of figures."""
    rows = []
    for name, values in columns.items():
        known = [v for v in values if v is not None]
        if known and (name in _FIGURES or name.startswith((MARGIN, FLOWN))):
            quantiles = np.quantile(np.array(known, dtype=float), [0.0, 0.5, 1.0])
            rows.append((name, *(f'{value:.4g}' for value in quantiles)))
    return _table(('', 'least', 'median', 'largest'), rows)


def _values(axis: Axis) -> tuple[str, str]:
    count = len(axis.values)
    if axis.spacing == 'list' and count <= _REASONS:
        return axis.name, ', '.join(map(str, axis.values))
    return axis.name, f'{axis.values[0]} to {axis.values[-1]}, {count} values, {axis.spacing}'
