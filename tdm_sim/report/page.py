# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The report as one self-contained HTML page: tables, animation, charts; it needs no network.

Every text of a recording is escaped, and a content security policy allows only the page's own
scripts, and loads nothing.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from datetime import datetime, timezone
from hashlib import sha256
from html import escape
from importlib.resources import files
import json
from pathlib import Path
import re

from plotly.offline import get_plotlyjs
from tdm_planner import __version__
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import Level
from tdm_planner.plan_files import write_file
from tdm_sim.report import animation
from tdm_sim.report.charts import Chart, chart_json, mission_charts, points_per_curve
from tdm_sim.report.comparison import compare, Comparison
from tdm_sim.report.mission import Mission
from tdm_sim.report.tables import card, events_table, summary_table

_SCRIPTS = ('scene.js', 'charts.js', 'report.js')
_LEAD, _SHARE_AFTER, _LEAST_AFTER = 0.25, 0.3, 1.5

# Within a JSON string these mean the same as the characters; in HTML they mean nothing.
_ESCAPES = str.maketrans({'<': r'\u003c', '>': r'\u003e', '&': r'\u0026'})

_LEFT = ('states', 'controls')  # charts below the animation; others stand below the summary


def write_report(mission: Mission, path: Path, comparison: Comparison | None = None) -> None:
    """Write the report on a mission to `path`; raise UnusableFile if that fails."""
    write_file(path, report_page(mission, comparison).encode())


def report_page(mission: Mission, comparison: Comparison | None = None) -> str:
    """Return the report on a mission as HTML; `comparison` is what `compare` makes of it."""
    comparison = comparison or compare(mission)
    charts = mission_charts(mission)
    most, scene, missing = points_per_curve(charts), None, mission.missing
    try:
        scene = animation.scene(mission)
    except InvalidProblem as error:  # a user's drawing must not cost the report
        missing = (*missing, f'There is no picture: {error}.')
    report = {
        'span': list(mission.span),
        'motion': list(motion_span(mission)),
        'scene': scene,
        'charts': [chart_json(chart, mission.span, most) for chart in charts],
    }
    data = json.dumps(report, allow_nan=False, separators=(',', ':')).translate(_ESCAPES)
    script = "'use strict';\n" + '\n'.join(_asset(name) for name in _SCRIPTS)
    return page_html(
        mission.title,
        _subtitle(mission),
        _columns(mission, comparison, charts, scene is not None),
        source=_source(mission),
        missing=_missing(missing),
        details=f'<div class="column details">{_details(mission)}</div>',
        player={'data': data, 'plotly': get_plotlyjs(), 'script': script},
    )


def page_html(
    title: str,
    subtitle: str,
    columns: Iterable[Iterable[str]],
    source: str = f'tdm_planner {__version__}',
    missing: str = '',
    details: str = '',
    player: Mapping[str, str] | None = None,
) -> str:
    """Return a page with `columns` of cards; only the player's scripts run, nothing is loaded."""
    slots = {'missing': missing, 'details': details, **(player or {})}
    scripts = [] if player is None else [player['plotly'], player['script']]
    hashes = [base64.b64encode(sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = ' '.join(f"'sha256-{found}'" for found in hashes) or "'none'"
    slots['policy'] = (
        "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
        f"script-src {allowed}; base-uri 'none'; form-action 'none'"
    )
    halves = (''.join(half) for half in columns)
    slots['columns'] = ''.join(f'<div class="column">{half}</div>' for half in halves if half)
    slots |= {'title': escape(title), 'subtitle': escape(subtitle), 'source': escape(source)}
    slots |= {'version': __version__, 'style': _asset('page.css')}
    head, bar, foot = _asset('page.html').split('<!-- player -->\n')
    template = head + foot if player is None else head + bar + foot
    # in one pass, so that inserted text is never read as a slot
    return re.sub(r'{{(\w+)}}', lambda match: slots[match.group(1)], template)


def motion_span(mission: Mission) -> tuple[float, float]:
    """Return the part of the time that is shown first: the motion and what follows closely."""
    first, last = mission.span
    if not mission.plans:
        return first, last
    end = max(plan.end for plan in mission.plans)
    after = max(_LEAST_AFTER, _SHARE_AFTER * end)
    return max(first, -_LEAD), min(last, end + after)


def _asset(name: str) -> str:
    return files('tdm_sim.report').joinpath('assets', name).read_text(encoding='utf-8')


def _subtitle(mission: Mission) -> str:
    parts = [figures.summary for figures in mission.figures[-1:] if figures.summary]
    if not mission.was_executed:
        parts.append('planned, not executed')
    return ' · '.join(parts or [figures.problem for figures in mission.figures[-1:]])


def _source(mission: Mission) -> str:
    parts = [f'tdm_planner {__version__}']
    if mission.source:
        parts.append(f'from {mission.source}')
    if mission.recorded_at is not None:
        at = datetime.fromtimestamp(mission.recorded_at, timezone.utc)
        parts.append(f'recorded {at:%Y-%m-%d %H:%M:%S} UTC')
    return ' · '.join(parts)


def _columns(
    mission: Mission, comparison: Comparison, charts: Iterable[Chart], moving: bool
) -> tuple[list[str], list[str]]:
    """Return cards in two columns; a phone shows them one after the other, by their `order`."""
    cards = [(1, 'Summary', summary_table(mission, comparison), 'id="summary"')]
    if moving:
        cards.insert(0, (0, 'Motion', '<div id="scene"></div>', 'id="animation"'))
    for chart in charts:
        note = f'<p class="note">{escape(chart.note)}</p>' if chart.note else ''
        drawn = f'{note}<div class="chart" id="chart-{chart.key}"></div>'
        cards.append((int(chart.key not in _LEFT), chart.title, drawn, ''))
    halves: tuple[list[str], list[str]] = ([], [])
    for order, (side, title, body, identity) in enumerate(cards):
        halves[side].append(card(title, body, f'style="order: {order}" {identity}'.rstrip()))
    return halves


def _missing(sentences: Iterable[str]) -> str:
    items = ''.join(f'<li>{escape(sentence)}</li>' for sentence in sentences)
    return (
        items
        and f'<div class="callout" id="missing"><h2>What is missing</h2><ul>{items}</ul></div>'
    )


def _details(mission: Mission) -> str:
    parts = []
    if mission.events:
        grave = [event for event in mission.events if event.level != Level.OK]
        early = sum(map(mission.is_early, grave))
        count = f'{len(mission.events)} events, {len(grave)} of them warnings or errors'
        count += f' ({early} before the motion)' if early else ''
        table = f'<div class="scroll">{events_table(mission)}</div>'
        parts.append(card('Events', f'<p class="note">{count}</p>{table}', 'id="events"'))
    if mission.parameters:
        parameters = json.dumps(mission.parameters, indent=1, ensure_ascii=False, sort_keys=True)
        parts.append(
            '<section class="card" id="parameters"><details><summary>Parameters of the problem'
            f'</summary><pre>{escape(parameters)}</pre></details></section>'
        )
    return ''.join(parts)
