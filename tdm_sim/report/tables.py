# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of the report as HTML, where everything from a recording is escaped, and as text."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
import math

from tdm_sim.report.comparison import Comparison, Entry, Kind
from tdm_sim.report.mission import Mission
from tdm_sim.report.signals import ROUNDING

MINUS = '\N{MINUS SIGN}'

_HEADINGS: dict[Kind, str] = {
    'duration': 'Duration',
    'cost': 'Cost',
    'landing': 'At the planned end',
    'margin': 'Worst margins',
    'distance': 'Distances',
    'planner': 'Planner',
}
_NOTHING = 1e-12  # below this a figure is shown as 0


def card(title: str, body: str, attributes: str = '') -> str:
    """Return a part of the page with a heading; `body` and `attributes` are HTML."""
    head = f'<section {attributes} class="card">' if attributes else '<section class="card">'
    return f'{head}<h2>{escape(title)}</h2>{body}</section>'


def summary_table(mission: Mission, comparison: Comparison) -> str:
    """Return the verdict, and planned against achieved, of several vehicles the worst."""
    return _verdict(comparison) + _table(mission, _worst(comparison.entries))


def _verdict(comparison: Comparison) -> str:
    verdict = comparison.verdict
    if verdict is None:
        return ''
    if verdict.reached:
        return f'<p class="verdict good">{verdict.title}</p>'
    if not verdict.reasons:
        return f'<p class="verdict">{verdict.title}: {escape(verdict.undecided)}</p>'
    reasons = ''.join(f'<li>{escape(reason)}</li>' for reason in verdict.reasons)
    return f'<p class="verdict bad">{verdict.title}</p><ul class="reasons">{reasons}</ul>'


def figures(comparison: Comparison) -> list[tuple[str, str, str]]:
    """Return name, planned and achieved of the summary's figures as text, for terminals."""
    return [
        (f'{e.name} [{e.unit}]' if e.unit else e.name, _due(e, _text), _text(e.achieved))
        for e in _worst(comparison.entries)
    ]


def _worst(entries: Iterable[Entry]) -> list[Entry]:
    """Return the figures of the summary: of several vehicles the worst."""
    groups: dict[tuple[Kind, str], list[Entry]] = {}
    for entry in entries:
        groups.setdefault((entry.kind, entry.name), []).append(entry)
    return [_worst_of(group) for group in groups.values()]


def _worst_of(group: Sequence[Entry]) -> Entry:
    """Return the smallest margins, else the largest amounts, planned and achieved."""
    kind = group[0].kind

    def gravity(value: float | None) -> float:
        if value is None:  # a goal that was never reached is the worst
            return math.inf if kind == 'duration' else -math.inf
        return -value if kind == 'margin' else abs(value)

    planned = max(group, key=lambda entry: gravity(entry.planned))
    achieved = max(group, key=lambda entry: gravity(entry.achieved))
    leading = planned if all(entry.achieved is None for entry in group) else achieved
    return leading._replace(
        planned=planned.planned,
        planned_at=planned.planned_at,
        achieved=achieved.achieved,
        achieved_at=achieved.achieved_at,
        mark=achieved.mark,
    )


def _table(mission: Mission, entries: Sequence[Entry]) -> str:
    columns = ('planned', 'achieved') if mission.was_executed else ('planned',)
    heads = ''.join(f'<th scope="col">{column}</th>' for column in columns)
    rows = []
    for kind, heading in _HEADINGS.items():
        group = [entry for entry in entries if entry.kind == kind]
        if group:
            span = f'colspan="{1 + len(columns)}" scope="colgroup"'
            rows.append(f'<tr class="group"><th {span}>{heading}</th></tr>')
            rows += [_row(mission, entry) for entry in group]
    return (
        f'<table class="figures"><thead><tr><td></td>{heads}</tr></thead>'
        f'<tbody>{"".join(rows)}</tbody></table>'
    )


def _row(mission: Mission, entry: Entry) -> str:
    executed = mission.was_executed
    name = entry.name.removeprefix('margin of ').removesuffix(' at the planned end')
    unit = f' [{entry.unit}]' if entry.unit else ''
    vehicle = entry.vehicle if len(mission.vehicles) > 1 else ''
    notes = [note for note in (vehicle, entry.note) if note]
    small = f'<small>{escape(", ".join(notes))}</small>' if notes else ''
    planned, achieved = entry.planned, entry.achieved
    if entry.kind == 'planner':
        texts = [_due(entry, number), number(achieved)]
        cells = ''.join(f'<td>{text}</td>' for text in (texts if executed else texts[1:]))
    else:
        # a plan was checked, with the problem's own tolerances, before it was published
        cells = _cell(planned, entry.planned_at)
        bad = entry.kind == 'margin' and achieved is not None and achieved < -ROUNDING
        if executed:
            cells += _cell(achieved, entry.achieved_at, bad, entry.mark)
    return f'<tr><th scope="row">{escape(name + unit)}{small}</th>{cells}</tr>'


def _due(entry: Entry, shown: Callable[[float | None], str]) -> str:
    """Return what was planned, of the planner the most that it may be: its deadline."""
    if entry.kind != 'planner':
        return shown(entry.planned)
    return f'at most {shown(entry.planned)}' if entry.planned else ''


def _cell(value: float | None, instant: float | None, bad: bool = False, mark: str = '') -> str:
    if value is None:
        return '<td></td>'
    at = '' if instant is None else f' <small>at {instant_button(instant)}</small>'
    at += f' <small class="mark">{escape(mark)}</small>' if mark else ''
    style = ' class="bad"' if bad else ''
    return f'<td{style}>{number(value)}{at}</td>'


def _text(value: float | None) -> str:
    """Return a figure with four significant digits; '' where there is none."""
    return '' if value is None else f'{0.0 if abs(value) < _NOTHING else value:.4g}'


def number(value: float | None) -> str:
    """Return a figure with four significant digits, as HTML."""
    digits, _, exponent = _text(value).partition('e')
    if exponent:
        digits = f'{float(digits):.3g}&thinsp;&middot;&thinsp;10<sup>{int(exponent)}</sup>'
    return digits.replace('-', MINUS)


def events_table(mission: Mission) -> str:
    """Return what nodes said, in order; instants lead the cursor there, early ones are dim."""
    rows = ''.join(
        f'<tr class="{event.level.name}{" early" if mission.is_early(event) else ""}">'
        f'<td>{instant_button(event.time)}</td>'
        f'<td>{escape(event.source)}</td><td>{escape(event.text)}</td></tr>'
        for event in mission.events
    )
    return f'<table class="events"><tbody>{rows}</tbody></table>'


def instant_button(instant: float) -> str:
    """Return an instant [s] as a button that moves the cursor there."""
    sign = MINUS if instant < -0.005 else ''
    return (
        f'<button type="button" class="link" data-instant="{instant:.6f}">'
        f'{sign}{abs(instant):.2f} s</button>'
    )
