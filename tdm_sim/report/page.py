# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The report as one self-contained HTML page: tables, animation, charts; it needs no network.

Whatever comes from a recording is escaped, and a content security policy lets nothing but the
page's own scripts run and nothing be loaded.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from html import escape
from importlib.resources import files
from pathlib import Path
import re

from plotly.offline import get_plotlyjs
from tdm_planner import __version__
from tdm_planner.plan_files import check_path, UnusableFile
from tdm_planner.problems.registry import load_problem
from tdm_sim.progress import Progress
from tdm_sim.report import animation
from tdm_sim.report.charts import Chart, content_hash, json_for_html, plotly_figure, plotly_json
from tdm_sim.report.comparison import compare, Comparison
from tdm_sim.report.histories import (
    control_chart,
    distance_chart,
    error_chart,
    margin_chart,
    state_chart,
)
from tdm_sim.report.mission import Mission
from tdm_sim.report.reader import read_mission
from tdm_sim.report.sections import columns, details, missing

_REAL_TIME = 0.02  # what the speed of simulated time may differ from 1 without a word
_SCRIPTS = ('data.js', 'clock.js', 'scene.js', 'charts.js', 'report.js')
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
_PLAYED_IN = 8.0  # s that the motion takes on the screen, about
_LEAD, _SHARE_AFTER, _LEAST_AFTER = 0.25, 0.3, 1.5

Slots = Mapping[str, str]


def write_report(mission: Mission, path: Path, comparison: Comparison | None = None) -> int:
    """
    Write the report on a mission to `path`; returns the file's size in bytes.

    Raises
    ------
    UnusableFile
        If the file cannot be written.

    """
    page = report_page(mission, comparison).encode()
    try:
        path.write_bytes(page)
    except OSError as error:
        raise UnusableFile(f"the file '{path}' cannot be written: {error.strerror}") from None
    return len(page)


def report_page(mission: Mission, comparison: Comparison | None = None) -> str:
    """Return the report on a mission as HTML; `comparison` is what `compare` makes of it."""
    comparison = comparison or compare(mission)
    charts = mission_charts(mission, comparison)
    scene = animation.scene(mission)
    data = json_for_html(
        {
            'span': list(mission.span),
            'motion': list(motion_span(mission)),
            'speed': f'{playing_speed(mission):g}',
            'scene': scene,
            'charts': [
                {'key': chart.key, **plotly_json(plotly_figure(chart, mission.span))}
                for chart in charts
            ],
        }
    )
    plotly = get_plotlyjs()
    script = "'use strict';\n" + '\n'.join(_asset(name) for name in _SCRIPTS)
    policy = (
        "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
        f'script-src {content_hash(plotly)} {content_hash(script)}; '
        "base-uri 'none'; form-action 'none'"
    )
    return _filled(
        _asset('page.html'),
        {
            'policy': policy,
            'version': __version__,
            'title': escape(mission.title),
            'subtitle': escape(_subtitle(mission)),
            'style': _asset('page.css'),
            'missing': missing(mission.missing),
            'columns': columns(mission, comparison, charts, scene is not None),
            'details': details(mission),
            'source': escape(_source(mission)),
            'speeds': ''.join(f'<option value="{s:g}">{s:g}&times;</option>' for s in _SPEEDS),
            'data': data,
            'plotly': plotly,
            'script': script,
        },
    )


def mission_charts(mission: Mission, comparison: Comparison) -> list[Chart]:
    """Return the charts that have anything to show."""
    charts = [
        state_chart(mission),
        control_chart(mission),
        distance_chart(mission, comparison),
        margin_chart(mission, comparison),
        error_chart(mission, comparison),
    ]
    return [chart for chart in charts if any(panel.curves for panel in chart.panels)]


def motion_span(mission: Mission) -> tuple[float, float]:
    """Return the part of the time that is shown first: the motion and what follows closely."""
    first, last = mission.span
    ends = [plan.end for vehicle in mission.vehicles for plan in vehicle.plans]
    if not ends:
        return first, last
    end = max(ends)
    after = max(_LEAST_AFTER, _SHARE_AFTER * end)
    return max(first, -_LEAD), min(last, end + after)


def playing_speed(mission: Mission) -> float:
    """Return the speed at which the motion is over in a time that is pleasant to watch."""
    start, end = motion_span(mission)
    return min(_SPEEDS, key=lambda speed: abs((end - start) / speed - _PLAYED_IN))


def _asset(name: str) -> str:
    return files('tdm_sim.report').joinpath('assets', name).read_text(encoding='utf-8')


def _filled(template: str, slots: Slots) -> str:
    """Fill the template in one pass, so that what is filled in is never taken for a slot."""
    return re.sub(r'{{(\w+)}}', lambda match: slots[match.group(1)], template)


def _subtitle(mission: Mission) -> str:
    parts = [figures.summary for figures in mission.figures[-1:] if figures.summary]
    if not mission.was_carried_out:
        parts.append('planned, not carried out')
    return ' · '.join(parts or [mission.problem])


def _source(mission: Mission) -> str:
    parts = [f'tdm_planner {__version__}']
    if mission.source:
        parts.append(f'from {mission.source}')
    if mission.recorded_at is not None:
        at = datetime.fromtimestamp(mission.recorded_at, timezone.utc)
        parts.append(f'recorded {at:%Y-%m-%d %H:%M:%S} UTC')
    if abs(mission.speed - 1.0) > _REAL_TIME:
        parts.append(f'simulated time at {mission.speed:.2g} times real time')
    return ' · '.join(parts)


ENDINGS = ('.html', '.htm')


def make_report(
    source: Path,
    output: Path,
    progress: Progress,
    namespace: str | None = None,
    problem: str | None = None,
) -> None:
    """
    Write the report on a recording or a plan file.

    `namespace` chooses among several planners in one recording; `problem` names one that is not
    installed, ``module:Class``.

    Raises
    ------
    TdmError
        If the source cannot be read or the report not be written.

    """
    check_path(output, ENDINGS)
    progress.phase(f'reading {source}')
    given = None if problem is None else load_problem(problem)
    mission = read_mission(source, namespace, given)
    progress.phase(f'writing {output}')
    write_report(mission, output)
