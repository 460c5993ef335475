# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the report as HTML; everything from a recording is escaped."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from tdm_sim.report.mission import Event, Mission

MOST_EVENTS = 300
MINUS = '\N{MINUS SIGN}'


def summary_table(mission: Mission) -> str:
    """Return planned against achieved."""
    return ''


def events_table(mission: Mission) -> str:
    """Return what nodes said of themselves, in order; the instants lead the cursor there."""
    events = mission.events[:MOST_EVENTS]
    rows = ''.join(map(_event_row, events))
    if len(mission.events) > len(events):
        left = len(mission.events) - len(events)
        rows += f'<tr><td colspan="3">and {left} more</td></tr>'
    return f'<table class="events"><tbody>{rows}</tbody></table>'


def _event_row(event: Event) -> str:
    return (
        f'<tr class="{event.level.name}"><td>{instant_button(event.time)}</td>'
        f'<td>{escape(event.source)}</td><td>{escape(event.text)}</td></tr>'
    )


def instant_button(instant: float) -> str:
    """Return an instant [s] as a button that moves the cursor there."""
    sign = MINUS if instant < 0 else ''
    return (
        f'<button type="button" class="link" data-instant="{instant:.6f}">'
        f'{sign}{abs(instant):.2f} s</button>'
    )


def parameters_table(parameters: Mapping[str, object]) -> str:
    """Return parameters by dotted name."""
    rows = ''.join(
        f'<tr><th><code>{escape(name)}</code></th><td>{escape(_value(value))}</td></tr>'
        for name, value in sorted(parameters.items())
    )
    return f'<table><tbody>{rows}</tbody></table>'


def _value(value: object) -> str:
    if isinstance(value, float):
        return f'{value:g}'
    if isinstance(value, (list, tuple)):
        return ', '.join(map(_value, value))
    return str(value)
