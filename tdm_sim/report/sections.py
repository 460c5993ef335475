# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Sections of the report's page as HTML, and how they are put into two columns."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from tdm_sim.report.charts import Chart
from tdm_sim.report.comparison import Comparison
from tdm_sim.report.mission import Mission, Severity
from tdm_sim.report.tables import events_table, parameters_table, summary_table

_LEFT = ('states', 'controls')  # charts below the animation; others stand below the summary


def columns(
    mission: Mission, comparison: Comparison, charts: Iterable[Chart], moving: bool
) -> str:
    """
    Return animation, summary and charts in two columns.

    On a phone they are read one after the other, in the order of their `order`.
    """
    cards = [(0, _stage(mission))] if moving else []
    cards.append((1, _summary(mission, comparison)))
    cards += [(int(chart.key not in _LEFT), _chart(chart)) for chart in charts]
    halves = ['', '']
    for order, (side, html) in enumerate(cards):
        halves[side] += html.replace('<section', f'<section style="order: {order}"', 1)
    return ''.join(f'<div class="column">{half}</div>' for half in halves if half)


def missing(sentences: Iterable[str]) -> str:
    """Return what is not known and why; nothing if all is."""
    items = ''.join(f'<li>{escape(sentence)}</li>' for sentence in sentences)
    if not items:
        return ''
    return f'<div class="callout" id="missing"><h2>What is missing</h2><ul>{items}</ul></div>'


def details(mission: Mission) -> str:
    """Return events and parameters."""
    parts = []
    if mission.events:
        grave = [event for event in mission.events if event.level != Severity.OK]
        early = sum(map(mission.is_early, grave))
        count = f'{len(mission.events)} events, {len(grave)} of them warnings or errors'
        count += f' ({early} before the motion)' if early else ''
        parts.append(
            '<section class="card" id="events"><h2>Events</h2>'
            f'<p class="note">{count}</p>'
            f'<div class="scroll">{events_table(mission)}</div></section>'
        )
    if mission.parameters:
        parts.append(
            '<section class="card" id="parameters"><details><summary>Parameters of the problem'
            f'</summary>{parameters_table(mission.parameters)}</details></section>'
        )
    return ''.join(parts)


def _summary(mission: Mission, comparison: Comparison) -> str:
    table = summary_table(mission, comparison)
    return f'<section class="card" id="summary"><h2>Summary</h2>{table}</section>'


def _chart(chart: Chart) -> str:
    note = f'<p class="note">{escape(chart.note)}</p>' if chart.note else ''
    return (
        f'<section class="card"><h2>{escape(chart.title)}</h2>{note}'
        f'<div class="chart" id="chart-{chart.key}"></div></section>'
    )


def _stage(mission: Mission) -> str:
    return (
        '<section class="card" id="animation"><h2>Motion</h2><div id="scene"></div>'
        f'{_key(mission)}</section>'
    )


def _key(mission: Mission) -> str:
    """Explain the animation's lines."""
    line = '<line x1="1" x2="25" y1="7" y2="7" class="{}" stroke="currentColor"></line>'
    planned = any(vehicle.plans for vehicle in mission.vehicles)
    entries = [('planned', 'path', planned), ('travelled', 'trail', mission.was_carried_out)]
    ground = {shape.style for shape in mission.vehicles[0].view.surroundings()}
    entries.append(('limit', 'limit', 'limit' in ground))
    items = ''.join(
        f'<li><svg viewBox="0 0 26 14" aria-hidden="true">{line.format(style)}</svg>{name}</li>'
        for name, style, there in entries
        if there
    )
    return f'<ul class="key">{items}</ul>'
