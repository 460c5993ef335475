# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Charts of time histories, panels one below the other on one time axis; data inside a page.

Numbers are written as plotly.js reads typed arrays, ``{"dtype": "f4", "bdata": base64}``. Texts
come from untrusted files: no string can end the element that holds the data.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
import hashlib
import html
import json
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.drawing import COLOURS

Array = NDArray[np.float64]
Kind = Literal['planned', 'measured', 'commanded', 'error', 'limit', 'switching']

# Shares of a panel's height that its title and the gap below it take.
TITLE_SHARE, FOOT_SHARE = 0.17, 0.06
_PADDING = 0.08
_FROM_BELOW = ('measured', 'commanded', 'planned', 'error')

# Within a JSON string these mean the same as the characters; in HTML they mean nothing.
_ESCAPES = {'<': r'\u003c', '>': r'\u003e', '&': r'\u0026'}


@dataclass(frozen=True, eq=False)
class Curve:
    """
    One line: `times` and `values` (n,), NaN a gap; `colour` is the number of its colour.

    The legend switches curves by their kind and by their `series`, the vehicle or pair of vehicles
    they belong to ('' where there is only one), in all charts. `held`: the value stays until the
    next sample.
    """

    kind: Kind
    times: Array
    values: Array
    colour: int
    series: str = ''
    held: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """One quantity over time, with its limits and the instants at which a control switches."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    description: str = ''
    limits: tuple[float, ...] = ()
    switches: tuple[float, ...] = ()

    def value_range(self) -> tuple[float, float]:
        """Return the range of the axis: everything drawn, with room above and below."""
        seen = [curve.values[np.isfinite(curve.values)] for curve in self.curves]
        values = np.concatenate([*seen, np.array(self.limits)])
        if not values.size:
            return -1.0, 1.0
        low, high = float(values.min()), float(values.max())
        room = _PADDING * (high - low) or max(1e-3, 0.1 * abs(high))
        return low - room, high + room


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels that belong together; `key` names it in the page, `note` explains it in a line."""

    key: str
    title: str
    panels: tuple[Panel, ...]
    note: str = ''


def plotly_json(chart: Chart, span: tuple[float, float]) -> dict[str, Any]:
    """
    Return the chart as plotly.js takes it, its numbers in single precision.

    All panels share one time axis, so that zooming one zooms all.
    """
    traces = [
        {**trace, 'yaxis': f'y{index + 1}' if index else 'y'}
        for index, panel in enumerate(chart.panels)
        for trace in _traces(panel, span)
    ]
    return {'data': traces, 'layout': _layout(chart)}


def _traces(panel: Panel, span: tuple[float, float]) -> list[dict[str, Any]]:
    traces = []
    low, high = panel.value_range()
    if panel.switches:
        instants = np.repeat(np.array(panel.switches), 3)
        edges = np.tile([low, high, np.nan], len(panel.switches))
        traces.append(_trace('switching', instants, edges, {'width': 1, 'dash': 'dot'}))
    # measured curves lie broad and pale below planned ones
    order = sorted(panel.curves, key=lambda curve: _FROM_BELOW.index(curve.kind))
    traces += [_curve_trace(curve) for curve in order]
    if panel.limits:
        ends = np.tile([*span, np.nan], len(panel.limits))
        levels = np.repeat(np.array(panel.limits), 3)
        traces.append(_trace('limit', ends, levels, {'width': 1.3, 'dash': 'dash'}))
    return traces


def _curve_trace(curve: Curve) -> dict[str, Any]:
    line: dict[str, Any] = {'width': 1.5}
    if curve.held:
        line['shape'] = 'hv'
    trace = _trace(curve.kind, curve.times, curve.values, line, curve.series)
    trace['meta']['colour'] = curve.colour % len(COLOURS)
    if curve.kind == 'measured':
        line['width'] = 3.5
        trace['opacity'] = 0.5
    elif curve.kind == 'error':
        line['width'] = 1  # of a broad line, ripple would make a band
    elif curve.kind == 'commanded':
        line |= {'width': 1, 'dash': 'dot'}
    return trace


def _trace(
    kind: Kind, x: Array, y: Array, line: dict[str, Any], series: str = ''
) -> dict[str, Any]:
    label = html.escape(f'{series} {kind}'.strip(), quote=False)  # plotly.js reads tags in names
    return {
        'name': label,
        'type': 'scatter',
        'x': packed(x),
        'y': packed(y),
        'mode': 'lines',
        'line': line,
        'hoverinfo': 'skip',
        'meta': {'kind': kind, 'series': series},
    }


def _layout(chart: Chart) -> dict[str, Any]:
    count = len(chart.panels)
    layout: dict[str, Any] = {
        'hovermode': False,
        'dragmode': 'zoom',
        'showlegend': False,  # the page has its own, shared by all charts
        'xaxis': {'title': {'text': 'time from the start of the motion [s]'}, 'anchor': 'free',
                  'position': 0, 'zeroline': False},
        'annotations': [],
    }  # fmt: skip
    for index, panel in enumerate(chart.panels):
        top = 1.0 - index / count
        bottom = max(0.0, top - (1.0 - FOOT_SHARE) / count)
        layout[f'yaxis{index + 1 if index else ""}'] = {
            'domain': [bottom, top - TITLE_SHARE / count],
            'range': list(panel.value_range()),
            'zeroline': False,
            'nticks': 5,
            'automargin': False,
            'exponentformat': 'power',
        }
        layout['annotations'].append(
            {
                'text': f'<b>{html.escape(panel.title, quote=False)}</b>',
                'xref': 'paper',
                'yref': 'paper',
                'x': 0,
                'y': top,
                'xanchor': 'left',
                'yanchor': 'top',
                'showarrow': False,
            }
        )
    layout['meta'] = {'panels': [[p.title, p.description, p.unit] for p in chart.panels]}
    return layout


def packed(values: ArrayLike) -> dict[str, str]:
    """Return numbers (n,) in single precision as plotly.js reads them; NaN is a gap."""
    data = np.ascontiguousarray(values, dtype='<f4').tobytes()
    return {'dtype': 'f4', 'bdata': base64.b64encode(data).decode('ascii')}


def json_for_html(data: Any) -> str:
    """
    Return `data` as JSON that may stand inside a ``<script>`` element.

    Raises
    ------
    ValueError
        For a number that is not finite, which JSON cannot hold.

    """
    text = json.dumps(data, allow_nan=False, separators=(',', ':'))
    for character, escape in _ESCAPES.items():
        text = text.replace(character, escape)
    return text


def content_hash(script: str) -> str:
    """Return the source expression by which a content security policy lets a script run."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
