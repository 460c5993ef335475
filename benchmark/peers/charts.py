# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Chart of the peers' figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
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
}
_NEAR = {'3 robots': 1.06}  # of the best known cost; elsewhere 1.02


def draw(figures: Mapping[str, Any], folder: Path) -> Path:
    """Write the chart; returns its file."""
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / 'benchmark_success.png'
    success(figures).savefig(picture, dpi=110)
    return picture


def success(figures: Mapping[str, Any]) -> Figure:
    """Share of the cases solved near the best known cost within a time."""
    problems = figures['problems']
    picture = Figure(figsize=(13, 5.2), layout='constrained')
    FigureCanvasAgg(picture)
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
