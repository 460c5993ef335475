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
import json
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.drawing import COLOURS

Array = NDArray[np.float64]
Kind = Literal['planned', 'measured', 'commanded', 'error', 'limit', 'switching']

_PADDING = 0.08
_FROM_BELOW = ('measured', 'commanded', 'planned', 'error')

# Within a JSON string these mean the same as the characters; in HTML they mean nothing.
_ESCAPES = str.maketrans({'<': r'\u003c', '>': r'\u003e', '&': r'\u0026'})


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


def chart_json(chart: Chart, span: tuple[float, float]) -> dict[str, Any]:
    """Return the chart as the page's script takes it, its numbers in single precision."""
    traces = [
        {**trace, 'yaxis': f'y{index + 1}' if index else 'y'}
        for index, panel in enumerate(chart.panels)
        for trace in _traces(panel, span)
    ]
    panels = [
        {'title': p.title, 'description': p.description, 'unit': p.unit, 'range': p.value_range()}
        for p in chart.panels
    ]
    return {'key': chart.key, 'data': traces, 'panels': panels}


def _traces(panel: Panel, span: tuple[float, float]) -> list[dict[str, Any]]:
    traces = []
    if panel.switches:
        instants = np.repeat(np.array(panel.switches), 3)
        edges = np.tile([*panel.value_range(), np.nan], len(panel.switches))
        traces.append(_trace('switching', instants, edges))
    # measured curves lie broad and pale below planned ones
    for curve in sorted(panel.curves, key=lambda curve: _FROM_BELOW.index(curve.kind)):
        how = {'colour': curve.colour % len(COLOURS), 'held': curve.held}
        traces.append(_trace(curve.kind, curve.times, curve.values, curve.series, **how))
    if panel.limits:
        ends = np.tile([*span, np.nan], len(panel.limits))
        traces.append(_trace('limit', ends, np.repeat(np.array(panel.limits), 3)))
    return traces


def _trace(kind: Kind, x: Array, y: Array, series: str = '', **how: Any) -> dict[str, Any]:
    return {'x': packed(x), 'y': packed(y), 'meta': {'kind': kind, 'series': series, **how}}


def packed(values: ArrayLike) -> dict[str, str]:
    """Return numbers (n,) in single precision as plotly.js reads them; NaN is a gap."""
    data = np.ascontiguousarray(values, dtype='<f4').tobytes()
    return {'dtype': 'f4', 'bdata': base64.b64encode(data).decode('ascii')}


def json_for_html(data: Any) -> str:
    """
    Return `data` as JSON that may stand inside a ``<script>`` element.

    Raise ValueError for a number that is not finite, which JSON cannot hold.
    """
    return json.dumps(data, allow_nan=False, separators=(',', ':')).translate(_ESCAPES)


def content_hash(script: str) -> str:
    """Return the source expression by which a content security policy lets a script run."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
