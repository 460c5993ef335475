# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Charts of the peers' figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
import numpy as np

_COLOURS = {
    'tdm_planner': '#0b5394',
    'tdm_planner, warm': '#6fa8dc',
    'collocation, straight line': '#e69138',
    'collocation, straight ways': '#e69138',
    'collocation, swing': '#cc0000',
    'collocation, roundabout': '#cc0000',
    'collocation, best of 3 guesses': '#741b47',
    'collocation, warm': '#ea9999',
    'Drake + SNOPT, swing': '#38761d',
}
_NEAR = {'3 robots': 1.06}  # of the best known cost; elsewhere 1.02


def draw(figures: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the charts; returns their files."""
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for name, chart in (('benchmark_success', success), ('benchmark_growth', growth)):
        picture = chart(figures)
        found.append(folder / f'{name}.png')
        picture.savefig(found[-1], dpi=110)
    return found


def _figure(height: float) -> Figure:
    picture = Figure(figsize=(13, height), layout='constrained')
    FigureCanvasAgg(picture)
    return picture


def success(figures: Mapping[str, Any]) -> Figure:
    """Share of the cases solved near the best known cost within a time."""
    problems = figures['problems']
    picture = _figure(5.2)
    picture.subplots(1, len(problems), sharey=True)
    handles: dict[str, Any] = {}
    for axis, (title, problem) in zip(picture.axes, problems.items(), strict=True):
        near = _NEAR.get(title, 1.02)
        known = {int(case): cost for case, cost in problem['known'].items()}
        for name, colour in _COLOURS.items():
            if name not in problem['attempts']:
                continue
            attempts = [a for a in problem['attempts'][name] if a['case'] in known]
            times = np.sort(
                [
                    1e3 * a['seconds']
                    for a in attempts
                    if a['solved'] and a['cost'] <= near * known[a['case']]
                ]
            )
            shares = np.arange(1, times.size + 1) / max(len(attempts), 1)
            dashes = '--' if 'warm' in name else '-'
            (handles[name],) = axis.step(
                np.append(times, 1e5), np.append(shares, shares[-1:] if times.size else [0.0]),
                where='post', color=colour, linestyle=dashes, linewidth=2,
            )  # fmt: skip
        axis.set(xscale='log', xlim=(1, 1e4), ylim=(0, 1.02), xlabel='processor time [ms]')
        axis.set_title(f'{title}\nsolved at {near:g} of the best known cost or less', fontsize=10)
        axis.grid(alpha=0.3)
    picture.axes[0].set_ylabel('share of the cases')
    picture.legend(
        list(handles.values()), list(handles), loc='outside lower center', ncols=4, frameon=False
    )
    return picture


def growth(figures: Mapping[str, Any]) -> Figure:
    """Time over intervals, cost over varied parameters, time over robots."""
    picture = _figure(4.4)
    picture.subplots(1, 3)
    nodes, parameters, teams = picture.axes
    for section in dict.fromkeys(row['section'] for row in figures['nodes']):
        _line(
            nodes,
            [r for r in figures['nodes'] if r['section'] == section],
            'collocation',
            'value',
            'ms_median',
            label=section,
        )
    nodes.set(xscale='log', yscale='log', xlabel='intervals', ylabel='processor time [ms]')
    nodes.set_xticks([15, 30, 60, 100, 200], labels=['15', '30', '60', '100', '200'])
    nodes.xaxis.set_minor_locator(NullLocator())
    nodes.set_title('collocation: intervals', fontsize=10)
    robots = [r for r in figures['parameters'] if r['section'] == '3 robots']
    _line(
        parameters, robots, 'tdm_planner', 'variables', 'ratio_median', label='J / J of reference'
    )
    parameters.set(xlabel='varied parameters', ylabel='J / best known')
    parameters.set_title('this package, 3 robots: varied parameters', fontsize=10)
    for row in robots:
        parameters.annotate(
            f'{row["ms_median"]:.0f} ms',
            (row['variables'], row['ratio_median']),
            textcoords='offset points',
            xytext=(5, 6),
            fontsize=9,
        )
    parameters.margins(0.14, 0.1)
    parameters.set_xlim(right=75)
    for solver in ('tdm_planner', 'collocation'):
        _line(teams, figures['teams'], solver, 'value', 'ms_median', label=solver)
        for row in figures['teams']:
            if row['solver'] == solver and row['solved'] < 1.0:
                teams.annotate(
                    f'{100 * row["solved"]:.0f} % solved', (row['value'], row['ms_median']),
                    textcoords='offset points', xytext=(-8, 4), ha='right', fontsize=9,
                )  # fmt: skip
    teams.set(xscale='log', yscale='log', xlabel='robots', ylabel='processor time [ms]')
    teams.set_xticks([2, 3, 5, 8, 12, 20], labels=['2', '3', '5', '8', '12', '20'], minor=False)
    teams.xaxis.set_minor_locator(NullLocator())
    teams.set_title('robots', fontsize=10)
    nodes.legend(frameon=False, fontsize=9, loc='center right', bbox_to_anchor=(1.0, 0.72))
    teams.legend(frameon=False, fontsize=9, loc='lower right')
    for axis in (nodes, parameters, teams):
        axis.grid(alpha=0.3)
    return picture


def _line(
    axis: Axes, rows: Sequence[Mapping[str, Any]], solver: str, x: str, y: str, label: str
) -> None:
    points = [(r[x], r[y]) for r in rows if r['solver'] == solver and r[y] is not None]
    if points:
        colour = {'tdm_planner': '#0b5394', 'collocation': '#cc0000'}.get(label)
        axis.plot(*zip(*points, strict=True), marker='o', label=label, color=colour)
